"""Lommel's diffraction pattern: how exact it is and how long it takes.

Intensities are compared with the integral over the aperture by Gauss and Legendre, the light
within a circle with the integral of the intensity, and both with their closed forms on the edge
of the geometric shadow, v = u. Times are for many radii v, from 0 to 2u + 20, at one u.

    python benchmarks/diffraction.py
    python benchmarks/diffraction.py --defocus 1 100 --radii 5000
"""

from __future__ import annotations

import argparse
import platform
import tracemalloc

import common
import numpy as np
import scipy
from common import console, first_and_steady
from scipy.special import j0, j1

from potmesil_mi.optics.diffraction import encircled_energy, lommel_intensity

NODES, WEIGHTS = np.polynomial.legendre.leggauss(32)
SEED = 1981


def main() -> None:
    options = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    options.add_argument(
        "--defocus",
        type=float,
        nargs="+",
        default=[1e-8, 0.01, 1, 12.566370614359172, 50, 200, 2000, 1e4],
        metavar="U",
    )
    options.add_argument("--radii", type=int, default=20_000, help="radii to take the time of")
    options.add_argument("--places", type=int, default=300, help="radii to compare")
    arguments = options.parse_args()
    console.print(
        f"NumPy {np.__version__}, SciPy {scipy.__version__}, Python {platform.python_version()}"
    )
    console.print(accuracy(arguments))
    console.print(times(arguments))


def accuracy(arguments: argparse.Namespace):
    """Largest differences over the places, half of them near the edge of the shadow."""
    result = common.table(
        f"Largest errors at {arguments.places} radii",
        ["u", "I / max I", "I(u, u), relative", "energy", "energy(u, u)", "least step of energy"],
    )
    rng = np.random.default_rng(SEED)
    for u in arguments.defocus:
        half = arguments.places // 2
        v = np.concatenate(
            [rng.random(half) * max(2 * u, 20), np.abs(u + np.sqrt(u) * rng.normal(size=half))]
        )
        v = np.sort(v)
        radii = np.linspace(0, 2 * u + 20, arguments.radii)
        peak = lommel_intensity(u, radii).max()
        closed = (1 - 2 * j0(u) * np.cos(u) + j0(u) ** 2) / u**2
        share = 1 - j0(u) * np.cos(u) - j1(u) * np.sin(u)
        result.add_row(
            f"{u:g}",
            f"{np.abs(lommel_intensity(u, v) - intensity(u, v)).max() / peak:.1e}",
            # What is printed here subtracts nearly equal numbers where u is small.
            f"{abs(lommel_intensity(u, u) / closed - 1):.1e}" if u >= 0.01 else "",
            f"{np.abs(encircled_energy(u, v) - light(u, v)).max():.1e}",
            f"{abs(encircled_energy(u, u) - share):.1e}",
            f"{np.diff(encircled_energy(u, radii)).min():.1e}",
        )
    return result


def times(arguments: argparse.Namespace):
    """Medians of three runs, and the most memory that one takes."""
    result = common.table(
        f"{arguments.radii:,} radii at one u: milliseconds / most MiB",
        ["u", "lommel_intensity", "encircled_energy", "both for one v = u, ms"],
    )
    for u in arguments.defocus:
        v = np.linspace(0, 2 * u + 20, arguments.radii)
        cells = []
        for function in (lommel_intensity, encircled_energy):
            _, _, seconds = first_and_steady(lambda f=function, u=u, v=v: f(u, v))
            tracemalloc.start()
            function(u, v)
            most = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            cells.append(f"{1e3 * seconds:.1f} / {most / 2**20:.1f}")
        _, _, seconds = first_and_steady(
            lambda u=u: [lommel_intensity(u, u), encircled_energy(u, u)]
        )
        result.add_row(f"{u:g}", *cells, f"{1e3 * seconds:.1f}")
    return result


def panels(first: float, last: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss and Legendre in so many equal parts of an interval."""
    edges, step = np.linspace(first, last, count, endpoint=False, retstep=True)
    nodes = edges[:, None] + step * (NODES + 1) / 2
    return nodes.ravel(), np.tile(WEIGHTS * step / 2, count)


def intensity(u: float, v: np.ndarray) -> np.ndarray:
    """The integral over the aperture, with at most 15 radians of phase to 32 nodes."""
    rho, weights = panels(0, 1, int((u + v.max()) / 15) + 2)
    ring = 2 * weights * rho * np.exp(-0.5j * u * rho**2)
    return np.array([abs(j0(one * rho) @ ring) ** 2 for one in v])


def light(u: float, v: np.ndarray) -> np.ndarray:
    """Light within each of the circles ``v``, sorted: the sum over the rings between them."""
    rings = []
    for inner, outer in zip([0, *v[:-1]], v, strict=True):
        x, weights = panels(inner, outer, int((outer - inner) / 4) + 1)
        rings.append(weights @ (lommel_intensity(u, x) * x / 2))
    return np.cumsum(rings)


if __name__ == "__main__":
    main()
