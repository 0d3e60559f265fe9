"""Pictures through an aperture by other means: Fourier optics, and many pinholes."""

import dataclasses
import math

import mitsuba as mi
import numpy as np
from prysm.propagation import Wavefront

from potmesil_mi.optics.diffraction import optical_coordinates
from scenes import synthetic


def bright_point(size, pixel, depth, lens, offset=0.0, light=1.0, background=0.0):
    """A bright point in the middle of a dark plane, off the centre of its pixel."""
    y, x = np.divmod(np.arange(size * size), size)
    middle = (x == size // 2) & (y == size // 2)
    lens = lens.replace(frame_width=size * pixel)
    camera = dataclasses.replace(synthetic(1, size=(size, size)).camera, x_fov=lens.fov)
    return synthetic(
        size * size,
        size=(size, size),
        x=x + 0.5 + offset,
        y=y + 0.5 + offset,
        z=np.full(size * size, depth),
        rgb=background + (light * middle)[:, None] * np.ones(3),
        weight=np.ones(size * size),
        layer=np.zeros(size * size),
        camera=camera,
        lens=lens,
    )


def fourier_optics(size, pixel, depth, lens, wavelength, offset, fine=5):
    """The same by Fourier optics: prysm's transform of a defocused pupil, in pixels."""
    diameter, film = lens.lens_diameter, lens.film_distance
    u, _ = optical_coordinates(lens, depth, 0.0, wavelength)
    n = 768
    step = 1.02 * diameter / n
    place = (np.arange(n) - n // 2) * step
    radius = np.hypot(place[None, :], place[:, None])
    pupil = np.clip((diameter / 2 - radius) / step + 0.5, 0, 1)
    phase = np.exp(-0.5j * u * np.square(radius / (diameter / 2)))
    wave = Wavefront(pupil * phase, wavelength * 1e-3, step)
    field = wave.focus_fixed_sampling(film, pixel * 1e3 / fine, size * fine).data
    light = np.abs(field) ** 2
    # prysm has the middle at n // 2, which is in the middle of a pixel where both are odd.
    light = np.roll(light, round(offset * fine), (0, 1))
    return light.reshape(size, fine, size, fine).sum(axis=(1, 3))


def through_pinholes(scene, lens, count, spp=4):
    """The mean of pictures through pinholes all over the aperture of ``lens``.

    Each is shifted so that the focused plane stays where it is; the rim of the lens hides some
    of them from a part of the picture.
    """
    sensor, nested = scene.sensors()[0], scene.integrator().nested
    camera = sensor.camera()
    radius, distance = lens.plain().aperture_radius, lens.focus_distance
    across = 2 * math.tan(math.radians(camera.x_fov) / 2) * distance
    to_world = np.array(camera.to_world)
    width, height = camera.film_size
    far = np.hypot(width, height) / 2
    h = [(np.arange(n) + 0.5 - n / 2) / far * 2 * lens.vignetting for n in (width, height)]
    total = np.zeros((height, width, 3))
    open_ = np.zeros((height, width, 1))
    for number, (x, y) in enumerate(lens.aperture.points(count)):
        matrix = to_world.copy()
        matrix[:, 3] = to_world @ [-x * radius / lens.squeeze, -y * radius, 0, 1]
        pinhole = mi.load_dict(
            {
                "type": "perspective",
                "fov": camera.x_fov,
                "fov_axis": "x",
                "to_world": mi.ScalarTransform4f(matrix),
                "near_clip": camera.near_clip,
                "far_clip": camera.far_clip,
                "principal_point_offset_x": -x * radius / lens.squeeze / across,
                "principal_point_offset_y": -y * radius / across,
                "film": sensor.film(),
                "sampler": {"type": "multijitter", "sample_count": spp},
            }
        )
        seen = (x + h[0][None, :]) ** 2 + (y + h[1][:, None]) ** 2 <= 1
        picture = mi.render(scene, sensor=pinhole, integrator=nested, spp=spp, seed=number)
        total += seen[..., None] * np.array(picture)
        open_ += seen[..., None]
    return total / open_
