"""Equation 20 by tables, against a sum over all samples without any.

The paper's scene is focused by `potmesil_mi.focus(method="paper")` with ever more tables, and a
random part of the pixels is evaluated again sample by sample, in double precision, each sample
with its own circle and place. Further checks: a uniform picture stays uniform, tables sum to 1,
and a lens stopped down gives the pinhole picture.

    python benchmarks/equation20.py              # 512x512, some minutes
    python benchmarks/equation20.py --res 128 --pixels 500
"""

from __future__ import annotations

import argparse
import itertools
import sys

import common
import mitsuba as mi
import numpy as np
from common import console, timed
from rich.progress import track

import potmesil_mi as pm

sys.path.insert(0, str(common.ROOT / "tests"))

from brute_force import equation_20

SEED = 1981
TILES = 8


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--res", type=int, default=512, help="pixels each way")
    options.add_argument("--spp", type=int, default=16, help="jittered samples a pixel")
    options.add_argument(
        "--pixels",
        type=int,
        default=2000,
        help="pixels to compare, one in each cell of a grid over the frame (rounded to a square)",
    )
    options.add_argument("--tables", type=int, nargs="+", default=[37, 73, 146, 292])
    options.add_argument(
        "--focus-distances", type=float, nargs="+", default=common.FOCUS_DISTANCES, metavar="MM"
    )
    options.add_argument(
        "--patterns", nargs="+", choices=("uniform", "sampler"), default=["uniform", "sampler"]
    )
    options.add_argument("--f-number", type=float, default=5.6)
    options.add_argument(
        "--no-inverse-square", action="store_true", help="leave 1/z² out of equation 20"
    )
    arguments = options.parse_args()
    common.start(arguments)

    scene = common.load_paper_scene(arguments.res, arguments.spp)
    sets = {
        "uniform": pm.render_samples(
            scene, spp=1, sampling=pm.Sampling(pattern="uniform", layers=1, overscan=0)
        ),
        "sampler": pm.render_samples(scene, seed=0, sampling=pm.Sampling(layers=1, overscan=0)),
    }
    for pattern in arguments.patterns:
        console.print(against_brute_force(pattern, sets[pattern], arguments))
    console.print(uniform_pictures(sets, arguments))
    console.print(table_sums(sets["sampler"].lens))
    console.print(stopped_down(scene, sets))


def against_brute_force(pattern: str, samples: pm.PointSamples, arguments: argparse.Namespace):
    """Errors for each focus distance and number of tables."""
    pixels = choose_pixels(arguments.res, arguments.pixels)
    inverse_square = not arguments.no_inverse_square
    result = common.table(
        f"Equation 20{'' if inverse_square else ' without 1/z²'}, "
        f"{'uniform grid' if pattern == 'uniform' else f'{arguments.spp} jittered samples a pixel'}"
        f", {len(samples):,} samples, {arguments.res}x{arguments.res}, {len(pixels)} pixels: "
        "relative RMS error / largest absolute error",
        ["focus distance", *(f"{tables} tables" for tables in arguments.tables), "rms of Q"],
    )
    for distance in arguments.focus_distances:
        lens = samples.lens.replace(f_number=arguments.f_number, focus_distance=distance)
        exact = brute_force(samples, lens, pixels, inverse_square)
        cells = []
        for tables in arguments.tables:
            picture = np.array(
                pm.focus(
                    samples, lens, method="paper", tables=tables, inverse_square=inverse_square
                )
            )
            error = picture[pixels[:, 1], pixels[:, 0]] - exact
            cells.append(f"{rms(error) / rms(exact):.2e} / {np.abs(error).max():.1e}")
        result.add_row(f"{distance:g} mm", *cells, f"{rms(exact):.3f}")
    shares = {
        samples.surfaces[surface]: np.mean(surface_at(samples, pixels) == surface)
        for surface in samples.surfaces
    }
    whole = {
        samples.surfaces[surface]: np.mean(samples.surface == surface)
        for surface in samples.surfaces
    }
    console.print(
        "pixels by surface: "
        + ", ".join(
            f"{name} {share:.1%} (frame {whole[name]:.1%})" for name, share in shares.items()
        )
    )
    return result


def choose_pixels(res: int, count: int) -> np.ndarray:
    """Columns and rows of a random pixel in each cell of a grid, so that each surface is there."""
    side = min(res, max(1, round(count**0.5)))
    edges = np.linspace(0, res, side + 1).round().astype(int)
    rng = np.random.default_rng(SEED)
    first, size = edges[:-1], np.diff(edges)
    row, column = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    pick = rng.random((2, side, side))
    columns = first[column] + np.floor(pick[0] * size[column]).astype(int)
    rows = first[row] + np.floor(pick[1] * size[row]).astype(int)
    return np.stack([columns.ravel(), rows.ravel()], axis=1)


def surface_at(samples: pm.PointSamples, pixels: np.ndarray) -> np.ndarray:
    """Surface of one sample in each of the pixels."""
    width = samples.camera.crop_size[0]
    pixel, first = np.unique(samples.pixel(), return_index=True)
    wanted = pixels[:, 1] * width + pixels[:, 0]
    return samples.surface[first[np.searchsorted(pixel, wanted)]]


def brute_force(
    samples: pm.PointSamples, lens: pm.ThinLens, pixels: np.ndarray, inverse_square: bool
) -> np.ndarray:
    """Q of the pixels, float64 (P, 3), sample by sample.

    For speed each tile of the frame is given only the samples whose circles can reach it.
    """
    camera = samples.camera
    pixels_per_mm = camera.focal_length_pixels / lens.film_distance
    reach = np.abs(lens.circle_of_confusion(samples.z.astype(np.float64))) / 2 * pixels_per_mm + 2
    finite = np.flatnonzero(np.isfinite(samples.z))
    # 1/z² of a sample at infinity is that of the farthest, which must then be there.
    farthest = finite[np.argmax(samples.z[finite])]
    columns = ("x", "y", "rgb", "alpha", "z", "surface", "weight", "layer")
    result = np.empty((len(pixels), 3))
    size = max(camera.crop_size) / TILES
    tile = (pixels // size).astype(int) @ [1, TILES]
    for number in track(
        np.unique(tile),
        f"Sample by sample, {lens.focus_distance:g} mm",
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ):
        here = tile == number
        left, top = pixels[here].min(axis=0)
        right, bottom = pixels[here].max(axis=0) + 1
        keep = (
            (samples.x + reach >= left)
            & (samples.x - reach <= right)
            & (samples.y + reach >= top)
            & (samples.y - reach <= bottom)
        )
        keep[farthest] = True
        part = samples.replace(**{name: getattr(samples, name)[keep] for name in columns})
        result[here] = equation_20(part, lens, pixels[here], inverse_square=inverse_square)
    return result


def uniform_pictures(sets: dict[str, pm.PointSamples], arguments: argparse.Namespace):
    """How far pictures of one colour depart from it, and of two far from the edge between."""
    result = common.table(
        "Uniform pictures, largest deviation over all pixels and focus distances",
        ["samples", "0.25, 0.5, 0.75", "1e4 throughout", "one half 0.8, the other 0.2"],
    )
    for name, samples in sets.items():
        half = arguments.res / 2
        colours = {
            "three": np.tile(np.float32([0.25, 0.5, 0.75]), (len(samples), 1)),
            "bright": np.full((len(samples), 3), 1e4, np.float32),
            "halves": np.repeat(np.where(samples.x < half, 0.8, 0.2)[:, None], 3, axis=1),
        }
        worst = dict.fromkeys(colours, 0.0)
        for distance, (colour, rgb) in itertools.product(
            arguments.focus_distances, colours.items()
        ):
            lens = samples.lens.replace(f_number=arguments.f_number, focus_distance=distance)
            picture = np.array(pm.focus(samples.replace(rgb=rgb), lens, method="paper"))
            if colour == "halves":
                circle = np.abs(lens.circle_of_confusion(samples.z)).max()
                circle *= samples.camera.focal_length_pixels / lens.film_distance
                margin = int(np.ceil(circle / 2)) + 2
                parts = [(picture[:, : int(half) - margin], np.float32(0.8))]
                parts.append((picture[:, int(half) + margin :], np.float32(0.2)))
            else:
                parts = [(picture, rgb[0])]
            for values, expected in parts:
                if values.size:
                    worst[colour] = max(worst[colour], float(np.abs(values - expected).max()))
        result.add_row(name, *(f"{value:.1e}" for value in worst.values()))
    return result


def table_sums(lens: pm.ThinLens):
    """How far the sums of tables are from 1, over many radii and places in the square."""
    result = common.table(
        "Sums of tables", ["radii in squares", "tables", "max |sum - 1|", "least"]
    )
    rng = np.random.default_rng(SEED)
    depth = 290.0
    radius_mm = abs(lens.circle_of_confusion(depth)) / 2
    corners = list(itertools.product((0.0, 0.25, 0.5, 0.75, 1.0), repeat=2))
    spans = ((1e-7, 1e-3), (1e-3, 0.5), (0.5, 2), (2, 20), (20, 200), (200, 1000))
    for least, most in spans:
        worst, smallest, count = 0.0, 1.0, 0
        for radius in np.geomspace(least, most, 200 if most <= 20 else 20):
            for offset in [*corners, *rng.random((5, 2))]:
                table = pm.Disc().table(lens, depth, radius / radius_mm, tuple(map(float, offset)))
                worst = max(worst, abs(table.sum() - 1))
                smallest = min(smallest, table.min())
                count += 1
        result.add_row(f"{least:g}–{most:g}", f"{count:,}", f"{worst:.1e}", f"{smallest:.1e}")
    return result


def stopped_down(scene: mi.Scene, sets: dict[str, pm.PointSamples]):
    """A lens stopped down against the pinhole picture of the nested integrator."""
    result = common.table(
        "Stopped down, against the pinhole picture (sampler: mi.render with the same seed; "
        "uniform: 1 2 1 means of the grid)",
        ["samples", "f-number", "1/z²", "largest difference", "rms", "largest circle, pixels"],
    )
    pinholes = {
        "sampler": timed(lambda: mi.render(scene, integrator=scene.integrator().nested, seed=0))[0],
        "uniform": grid_means(sets["uniform"]),
    }
    for name, pinhole in pinholes.items():
        samples = sets[name]
        for f_number, inverse_square in itertools.product((1e3, 1e9), (True, False)):
            lens = samples.lens.replace(f_number=f_number)
            picture = np.array(
                pm.focus(samples, lens, method="paper", inverse_square=inverse_square)
            )
            difference = picture - pinhole
            circle = np.abs(lens.circle_of_confusion(samples.z)).max()
            circle *= samples.camera.focal_length_pixels / lens.film_distance
            result.add_row(
                name,
                f"{f_number:g}",
                "yes" if inverse_square else "no",
                f"{np.abs(difference).max():.1e}",
                f"{rms(difference):.1e}",
                f"{circle:.1e}",
            )
    return result


def grid_means(samples: pm.PointSamples) -> np.ndarray:
    """Pixels as the means of the four squares between the points of the uniform grid."""
    width, height = samples.camera.crop_size
    rgb = samples.rgb.astype(np.float64).reshape(2 * height + 1, 2 * width + 1, 3)
    for _ in range(2):
        rgb = (rgb[:-2:2] + 2 * rgb[1:-1:2] + rgb[2::2]) / 4
        rgb = rgb.swapaxes(0, 1)
    return rgb


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


if __name__ == "__main__":
    main()
