"""Apertures: how good their pictures are, and what their tables cost.

A bright point behind `lommel` is compared with Fourier optics (prysm), other apertures with the
mean of pictures through many pinholes on the aperture, and diffraction in the geometric limit with
the disc. Tables are timed as the paper's scene needs them.

    python benchmarks/apertures.py                  # some minutes
    python benchmarks/apertures.py --res 128 --pinholes 128
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time

import common
import numpy as np
from common import console, timed

import potmesil_mi as pm
from potmesil_mi.evaluation.metrics import psnr
from potmesil_mi.focusing.kernels import KernelFactory
from potmesil_mi.optics import diffraction_kernel

sys.path.insert(0, str(common.ROOT / "tests"))

from optics.wave_optics import bright_point, fourier_optics, through_pinholes

HEART = np.add.outer(np.linspace(0.2, 1, 17), np.linspace(0, 0.5, 13)) * (np.arange(13) % 4 > 0)
APERTURES = {
    "disc": {},
    "triangle": {"aperture": pm.Polygon(3)},
    "hexagon": {"aperture": pm.Polygon(6)},
    "five curved blades": {"aperture": pm.Polygon(5, 10.0, 0.3)},
    "image": {"aperture": pm.ImageAperture(HEART)},
    "squeeze 1.6": {"squeeze": 1.6},
    "vignetting 0.5": {"vignetting": 0.5},
}
METHODS = ("layered", "lightfield")


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=256, help="pixels each way of the pictures")
    options.add_argument("--pinholes", type=int, default=256, help="on each aperture")
    options.add_argument("--f-number", type=float, default=2.8)
    arguments = options.parse_args()
    common.start(arguments)
    console.print(against_fourier_optics())
    console.print(against_pinholes(arguments))
    console.print(geometric_limit())
    console.print(tables())


def against_fourier_optics():
    """A bright point at f/22, 550 nm, in focus at 1000 mm and out of focus."""
    size, lens = 97, pm.ThinLens(50, 22, 1000, aperture=pm.Lommel((550,)), film="focused")
    result = common.table(
        "A bright point at f/22 against Fourier optics: largest error, as a share of the peak",
        ["pixel", "distance", "place in pixel", *METHODS],
    )
    for pixel in (1e-3, 4e-3):
        for depth in (1000.0, 1040.0, 1200.0, 700.0):
            for offset in (0.0, 0.4):
                samples = bright_point(size, pixel, depth, lens, offset)
                expected = fourier_optics(size, pixel, depth, samples.lens, 550.0, offset)
                errors = []
                for method in METHODS:
                    picture = np.array(pm.focus(samples, method=method), np.float64)[..., 1]
                    difference = picture / picture.max() - expected / expected.max()
                    errors.append(f"{np.abs(difference).max():.4f}")
                result.add_row(
                    f"{pixel * 1000:g} µm", f"{depth:g} mm", f"{offset:+g}, {offset:+g}", *errors
                )
    return result


def against_pinholes(arguments: argparse.Namespace):
    """Each aperture, on the paper's scene."""
    scene = common.load_paper_scene(arguments.res)
    samples = pm.render_samples(
        scene, spp=16, sampling=pm.Sampling(min_f_number=arguments.f_number)
    )
    result = common.table(
        f"figure11, {arguments.res}x{arguments.res}, f/{arguments.f_number:g}, 16 samples a pixel: "
        f"dB against {arguments.pinholes} pinholes on the aperture",
        ["aperture", "focus", *METHODS],
    )
    for name, changes in APERTURES.items():
        for distance in (550.0, 2000.0):
            lens = samples.lens.replace(
                f_number=arguments.f_number, focus_distance=distance, **changes
            )
            expected = through_pinholes(scene, lens, arguments.pinholes)
            quality = [
                f"{psnr(np.array(pm.focus(samples, lens, method=method)), expected):.1f}"
                for method in METHODS
            ]
            result.add_row(name, f"{distance:g}", *quality)
    return result


def geometric_limit():
    """The paper's scene with diffraction, at f/5.6, beside the same without."""
    samples = pm.render_samples(common.load_paper_scene(512), spp=16)
    result = common.table(
        "figure11, 512x512, f/5.6: lommel against disc",
        ["focus", "method", "dB", "light - 1", "first s", "again s"],
    )
    for distance in common.FOCUS_DISTANCES:
        lens = samples.lens.replace(focus_distance=distance)
        for method in (*METHODS, "paper"):
            disc = np.array(pm.focus(samples, lens, method=method, squares=2))
            lens_with = lens.replace(aperture=pm.Lommel())
            times = []
            for _ in range(2):
                picture, seconds = timed(
                    lambda lens=lens_with, method=method: pm.focus(samples, lens, method=method)
                )
                times.append(f"{seconds:.2f}")
            light = picture.mean(dtype=np.float64) / disc.mean(dtype=np.float64) - 1
            result.add_row(
                f"{distance:g}", method, f"{psnr(picture, disc):.1f}", f"{light:.1e}", *times
            )
    return result


def tables():
    """Seconds of all tables that a picture of the paper's scene needs."""
    samples = pm.render_samples(common.load_paper_scene(512), spp=16)
    result = common.table(
        "Tables of figure11, 512x512, f/5.6, layered: seconds in all",
        ["aperture", "focus", "tables", "first", "again"],
    )
    table, spent = KernelFactory._exact, []

    def watched(*arguments):
        began = time.perf_counter()
        result = table(*arguments)
        spent.append(time.perf_counter() - began)
        return result

    KernelFactory._exact = watched
    for aperture in (pm.Disc(), pm.Polygon(6), pm.Polygon(5, 10, 0.3), pm.Lommel()):
        for distance in (550.0, 2000.0):
            lens = samples.lens.replace(focus_distance=distance, aperture=aperture)
            seconds = []
            diffraction_kernel._one_kernel.cache_clear()
            for _ in range(3):
                spent.clear()
                pm.focus(samples, lens)
                seconds.append(sum(spent))
            result.add_row(
                str(aperture), f"{distance:g}", str(len(spent)), f"{seconds[0]:.2f}",
                f"{statistics.median(seconds[1:]):.2f}",
            )  # fmt: skip
    KernelFactory._exact = table
    return result


if __name__ == "__main__":
    main()
