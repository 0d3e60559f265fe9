"""Lenses and depths are found from pictures, by descent from a start that is far off."""

import warnings

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.optimize import least_squares

import potmesil_mi as pm

LENS = pm.ThinLens(50.0, 0.3, 2.0, millimeters_per_unit=1000.0)
AGAIN = dr.ADFlag.ClearInterior | dr.ADFlag.ClearInput


@pytest.fixture(autouse=True)
def nothing_is_where_the_focus_is_on_the_way():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pm.FocusWarning)
        yield


def plane(rgb, depth):
    return pm.PointSamples.from_image(
        rgb,
        np.broadcast_to(depth, rgb.shape[:2]),
        depth_kind="z",
        camera=30.0,
        lens=LENS,
        hidden="none",
        antialiased=False,
    )


@pytest.mark.parametrize("start", [(3.0, 0.45), (3.0, 0.15)])
def test_focus_and_f_number_are_found_from_half_off(variant_llvm, start):
    depth = np.full((32, 32), 3.5)
    depth[8:, :16] = 1.4
    samples = plane(np.random.default_rng(0).uniform(0.1, 1, (32, 32, 3)), depth)
    given = np.array(pm.focus(samples, LENS, method="lightfield"))
    session = pm.FocusSession(samples)
    known = {}

    def look(ab):
        """What the picture is off by, and both derivatives."""
        if tuple(ab) not in known:
            a, b = (dr.opaque(mi.Float, value) for value in ab)
            dr.enable_grad(a, b)
            lens = LENS.replace(focus_distance=start[0] / (1 + a), f_number=start[1] * dr.exp(b))
            picture, columns = session.focus(lens), []
            for unknown in (a, b):
                dr.set_grad(unknown, 1)
                columns.append(np.array(dr.forward_to(picture, flags=AGAIN)).ravel())
                dr.set_grad(picture, 0)
            known[tuple(ab)] = (np.array(picture) - given).ravel(), np.stack(columns, axis=1)
        return known[tuple(ab)]

    found = least_squares(
        lambda ab: look(ab)[0],
        (0, 0),
        lambda ab: look(ab)[1],
        bounds=([-0.7, -1.5], [2, 1.5]),
        x_scale=0.3,
        xtol=1e-3,
        max_nfev=15,
    ).x
    assert start[0] / (1 + found[0]) == pytest.approx(2.0, rel=0.01)
    assert start[1] * np.exp(found[1]) == pytest.approx(0.3, rel=0.01)


def test_the_depth_of_a_plane_is_found_from_five_pictures(variant_llvm):
    """Its colours are not known, either: the mean of the five is where they start."""
    rgb = np.random.default_rng(0).uniform(0.1, 1, (24, 24, 3))
    lenses = [LENS.replace(focus_distance=1 / of) for of in np.linspace(0.3, 0.9, 5)]
    given = [np.array(pm.focus(plane(rgb, 2.2), lens, method="lightfield")) for lens in lenses]
    base = plane(np.mean(given, axis=0), 3.3)
    unknown = {"vergence": mi.Float(1 / 3.3), "rgb": mi.TensorXf(base.rgb)}
    optimizer = mi.ad.Adam(lr=0.03, params=unknown)
    steps = 50
    for step in range(steps):
        optimizer.set_learning_rate(0.015 * (1 + np.cos(np.pi * step / steps)))
        depth = dr.full(mi.Float, 1, len(base)) / optimizer["vergence"]
        session = pm.FocusSession(base.replace(z=depth, rgb=optimizer["rgb"]))
        loss = mi.Float(0)
        for lens, picture in zip(lenses, given, strict=True):
            loss += dr.mean(dr.square(session.focus(lens) - picture), axis=None).array
        dr.backward(loss)
        optimizer.step()
    assert 1 / optimizer["vergence"][0] == pytest.approx(2.2, rel=0.02)
    error = np.std(np.array(optimizer["rgb"]) - rgb.reshape(-1, 3))
    assert error < np.std(np.mean(given, axis=0) - rgb) / 3
