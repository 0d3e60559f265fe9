"""Lenses and depths that are found from pictures, from a start that is 50 % off.

Focus and f-number of figure 11 are found by least squares from a picture that `lightfield` formed
of the same samples, and from one that Mitsuba's `thinlens` traced. Then the depth of a plane is
found, with its colours, from five pictures that are focused elsewhere.

    python benchmarks/recover.py                          # 256x256, minutes
    python benchmarks/recover.py --res 96 --rays 64       # a quick try
"""

from __future__ import annotations

import time
import warnings

import common
import drjit as dr
import mitsuba as mi
import numpy as np
from common import console
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares

import potmesil_mi as pm

STARTS = ((825.0, 8.4), (275.0, 2.8), (825.0, 2.8), (275.0, 8.4))
FOCUS_DISTANCE, F_NUMBER = 550.0, 5.6
AGAIN = dr.ADFlag.ClearInterior | dr.ADFlag.ClearInput

PLANE, PLANE_START, PLANE_SIZE, PLANE_STEPS = 2.2, 3.3, 64, 60


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=256, help="pixels each way of figure 11")
    options.add_argument("--spp", type=int, default=16, help="point samples a pixel")
    options.add_argument("--rays", type=int, default=256, help="rays a pixel of thinlens")
    arguments = options.parse_args()
    common.start(arguments)
    # On the way the focus is where nothing is.
    warnings.simplefilter("ignore", pm.FocusWarning)
    scene = common.load_paper_scene(arguments.res, arguments.spp)
    samples = pm.render_samples(scene, sampling=pm.Sampling(min_f_number=min(n for _, n in STARTS)))
    given = {
        "lightfield": np.array(pm.focus(samples, method="lightfield")),
        "thinlens": traced(scene, samples, arguments.rays),
    }
    result = common.table(
        f"Figure 11, {arguments.res}x{arguments.res}: errors of what was found, in %",
        ("picture", "from", "focus", "f-number", "loss", "pictures", "seconds"),
    )
    session = pm.FocusSession(samples, method=pm.Layered(squares=2))
    for name, picture in given.items():
        for start in STARTS:
            began = time.perf_counter()
            distance, f_number, loss, count = found_lens(session, samples.lens, picture, start)
            result.add_row(
                name,
                f"{start[0]:g} mm, f/{start[1]:g}",
                f"{100 * (distance / FOCUS_DISTANCE - 1):+.2f}",
                f"{100 * (f_number / F_NUMBER - 1):+.2f}",
                f"{loss:.1e}",
                str(count),
                f"{time.perf_counter() - began:.1f}",
            )
    console.print(result)
    began = time.perf_counter()
    depth, left = found_plane()
    console.print(
        f"A plane at {PLANE} m, from {PLANE_START} m: {depth:.3f} m, "
        f"{100 * (depth / PLANE - 1):+.2f} %; "
        f"error of its colours {left:.0%} of that of the mean picture; "
        f"{time.perf_counter() - began:.0f} s"
    )


def traced(scene: mi.Scene, samples: pm.PointSamples, rays: int) -> np.ndarray:
    """The picture of Mitsuba's thin lens at the samples' place."""
    sensor = {
        **samples.lens.to_thinlens(),
        "to_world": mi.ScalarTransform4f(np.array(samples.camera.to_world)),
        "near_clip": samples.camera.near_clip,
        "film": scene.sensors()[0].film(),
        "sampler": {"type": "multijitter", "sample_count": rays},
    }
    integrator = scene.integrator().nested
    return np.array(mi.render(scene, sensor=mi.load_dict(sensor), integrator=integrator))


def found_lens(
    session: pm.FocusSession, lens: pm.ThinLens, given: np.ndarray, start: tuple[float, float]
) -> tuple[float, float, float, int]:
    """Focus and f-number of the picture most like a given one, its loss, and pictures formed.

    The vergence of the focus and the logarithm of the f-number are sought.
    """
    known: dict[tuple[float, ...], tuple[np.ndarray, np.ndarray]] = {}

    def look(ab: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = tuple(ab)
        if key not in known:
            a, b = (dr.opaque(mi.Float, value) for value in ab)
            dr.enable_grad(a, b)
            picture = session.focus(
                lens.replace(focus_distance=start[0] / (1 + a), f_number=start[1] * dr.exp(b))
            )
            columns = []
            for unknown in (a, b):
                dr.set_grad(unknown, 1)
                columns.append(np.array(dr.forward_to(picture, flags=AGAIN)).ravel())
                dr.set_grad(picture, 0)
            known[key] = (np.array(picture) - given).ravel(), np.stack(columns, axis=1)
        return known[key]

    found = least_squares(
        lambda ab: look(ab)[0],
        (0, 0),
        lambda ab: look(ab)[1],
        bounds=([-0.7, -1.5], [2, 1.5]),
        x_scale=0.3,
        xtol=1e-3,
        max_nfev=20,
    )
    loss = 2 * found.cost / given.size
    return start[0] / (1 + found.x[0]), start[1] * np.exp(found.x[1]), loss, len(known)


def found_plane() -> tuple[float, float]:
    """The depth of a plane, and what part of the error of its colours is left, from five pictures.

    One vergence and all colours are sought; where those begin is the mean of the pictures.
    """
    noise = np.random.default_rng(0).normal(size=(3, PLANE_SIZE, PLANE_SIZE))
    grain = np.stack([gaussian_filter(of, 1, mode="wrap") for of in noise], axis=-1)
    colors = np.clip(0.4 + 0.25 * grain / grain.std(), 0.02, 1)
    lens = pm.ThinLens(85.0, 0.85, 2.0, millimeters_per_unit=1000.0)

    def plane(rgb: np.ndarray, depth: float) -> pm.PointSamples:
        z = np.full(rgb.shape[:2], depth)
        how = {"depth_kind": "z", "hidden": "none", "antialiased": False}
        return pm.PointSamples.from_image(rgb, z, camera=30.0, lens=lens, **how)

    lenses = [lens.replace(focus_distance=1 / of) for of in np.linspace(0.3, 0.9, 5)]
    pictures = [np.array(pm.focus(plane(colors, PLANE), of, method="lightfield")) for of in lenses]
    mean = np.mean(pictures, axis=0)
    base = plane(mean, PLANE_START)
    unknown = {"vergence": mi.Float(1 / PLANE_START), "rgb": mi.TensorXf(base.rgb)}
    optimizer = mi.ad.Adam(lr=1, params=unknown)
    for step in range(PLANE_STEPS):
        optimizer.set_learning_rate(0.01 * (1 + np.cos(np.pi * step / PLANE_STEPS)))
        depth = dr.full(mi.Float, 1, len(base)) / optimizer["vergence"]
        session = pm.FocusSession(base.replace(z=depth, rgb=optimizer["rgb"]))
        loss = mi.Float(0)
        for of, picture in zip(lenses, pictures, strict=True):
            loss += dr.mean(dr.square(session.focus(of) - picture), axis=None).array
        dr.backward(loss)
        optimizer.step()
    left = np.std(np.array(optimizer["rgb"]).reshape(mean.shape) - colors) / np.std(mean - colors)
    return 1 / optimizer["vergence"][0], float(left)


if __name__ == "__main__":
    main()
