"""Are pictures the same, bit for bit, before and after a change to the stages?

    git worktree add ../before HEAD~3
    python benchmarks/same_pictures.py take before.npz --package ../before
    python benchmarks/same_pictures.py take after.npz
    python benchmarks/same_pictures.py compare before.npz after.npz

Samples and pictures of seven scenes and of the paper's patterns, by all methods, with several
apertures, filters and films. One thread of Dr.Jit makes them, since the order in which several add
up their sums changes from run to run.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = ("x", "y", "rgb", "alpha", "z", "surface", "weight", "layer")

# Scene, its parameters, parameters of the sampling, samples a pixel, f-number, focus distances.
CASES: tuple[tuple[str, dict[str, Any], dict[str, Any], int, float, tuple[float, float]], ...] = (
    ("figure11", {"res": 128}, {}, 16, 5.6, (550, 980)),
    ("thicket", {"res": 96}, {"layers": 4}, 16, 2.8, (500, 1200)),
    ("room", {"res": 64}, {}, 16, 2.8, (3.2, 2.0)),
    ("mirror", {"res": 64}, {}, 16, 2, (2.4, 1.2)),
    ("lamps", {"res": 96}, {}, 16, 2, (1.1, 3.0)),
    ("terrace", {"width": 96, "height": 64}, {}, 16, 2, (1.2, 4)),
    ("lights", {}, {}, 4, 2, (1.2, 4)),
)
EVERY_APERTURE = ("figure11", "lamps")
FILTERS = ["star:points=6", "diffraction:scale=20", "defocus:radius=0.01", "fade:amount=0.2"]


def main() -> int:
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = options.add_subparsers(required=True, metavar="COMMAND")
    command = commands.add_parser("take", help="form the pictures")
    command.add_argument("output", metavar="FILE.npz")
    command.add_argument("--package", default=str(ROOT), help="checkout whose package forms them")
    command.set_defaults(run=lambda arguments: take(arguments.output, arguments.package))
    command = commands.add_parser("compare", help="compare two sets of pictures")
    command.add_argument("before", metavar="BEFORE.npz")
    command.add_argument("after", metavar="AFTER.npz")
    command.set_defaults(run=lambda arguments: compare(arguments.before, arguments.after))
    arguments = options.parse_args()
    return arguments.run(arguments)


def take(output: str, package: str) -> int:
    """Form the pictures with the package of a checkout, and write them."""
    sys.path.insert(0, str(Path(package).resolve()))
    import drjit as dr
    import mitsuba as mi

    import potmesil_mi as pm

    mi.set_variant("llvm_ad_rgb")
    warnings.simplefilter("ignore")  # Mitsuba's samplers say that they round counts up.
    image_aperture = getattr(pm, "ImageAperture", None) or pm.Image
    y, x = np.mgrid[-1:1:24j, -1:1:24j]
    heart = image_aperture(
        ((x**2 + (1.2 * y) ** 2 - 0.5) ** 3 + x**2 * (1.2 * y) ** 3 < 0).astype(float)
    )
    pictures: dict[str, np.ndarray] = {}

    def keep(name: str, values: Any) -> None:
        pictures[name] = np.array(values)
        print(name, pictures[name].shape, flush=True)

    def keep_samples(name: str, samples: Any) -> None:
        for column in COLUMNS:
            keep(f"{name}/{column}", getattr(samples, column))

    def load(name: str, **parameters: Any) -> Any:
        dr.set_thread_count(2)  # Scenes with textures are not loaded by one alone.
        scene = mi.load_file(str(ROOT / "scenes" / f"{name}.xml"), optimize=False, **parameters)
        dr.sync_thread()
        dr.set_thread_count(1)
        return scene

    for name, parameters, sampling, spp, f_number, distances in CASES:
        scene = load(name, **parameters)
        samples = pm.render_samples(
            scene, spp=spp, sampling=pm.Sampling(**sampling, min_f_number=f_number)
        )
        keep_samples(name, samples)
        keep_samples(f"{name}/merged", samples.merge())
        for distance in distances:
            lens = samples.lens.replace(f_number=f_number, focus_distance=distance)
            for method in ("layered", "lightfield", "paper"):
                if method == "lightfield" and spp < 16 and distance != distances[0]:
                    continue
                tables = {"tables": 21} if method == "paper" else {}
                keep(
                    f"{name}/{method}/{distance}", pm.focus(samples, lens, method=method, **tables)
                )
        lens = samples.lens.replace(f_number=f_number, focus_distance=distances[0])
        keep(f"{name}/alpha", pm.focus(samples, lens, alpha=True))
        keep(f"{name}/closed", pm.focus(samples, lens.replace(f_number=np.inf)))
        keep(f"{name}/squeeze", pm.focus(samples, lens.replace(squeeze=1.6)))
        keep(f"{name}/polygon", pm.focus(samples, lens.replace(aperture=pm.Polygon(6, 10, 0.3))))
        if name in EVERY_APERTURE:
            keep(f"{name}/vignetting", pm.focus(samples, lens.replace(vignetting=0.5)))
            of_heart = lens.replace(aperture=heart)
            keep(f"{name}/heart", pm.focus(samples, of_heart))
            keep(f"{name}/heart/paper", pm.focus(samples, of_heart, method="paper", tables=9))
            keep(f"{name}/lommel", pm.focus(samples, lens.replace(aperture=pm.Lommel())))
            keep(f"{name}/filters", pm.focus(samples, lens, filters=FILTERS))
            gaussian = mi.load_dict({"type": "gaussian"})
            keep(f"{name}/gaussian", pm.focus(samples, lens, rfilter=gaussian, squares=2))
    scene = load("figure11", res=48)
    for pattern in ("uniform", "adaptive"):
        samples = pm.render_samples(scene, spp=1, sampling=pm.Sampling(pattern=pattern))
        keep_samples(pattern, samples)
        for method in ("layered", "lightfield", "paper"):
            keep(f"{pattern}/{method}", pm.focus(samples, method=method))
    keep("focus integrator", mi.render(scene))
    point_samples = mi.load_dict({"type": "point_samples", "nested": {"type": "path"}})
    keep("point_samples integrator", mi.render(scene, integrator=point_samples))
    np.savez(output, **pictures)
    return 0


def compare(before: str, after: str) -> int:
    """Print what differs, and return 1 if anything does."""
    first, second = np.load(before), np.load(after)
    missing = sorted(set(first.files) ^ set(second.files))
    for name in missing:
        print(f"{name}: only in one of the two")
    common = [name for name in first.files if name in second.files]
    different = [
        name for name in common if not np.array_equal(first[name], second[name], equal_nan=True)
    ]
    for name in different:
        a, b = first[name].astype(float), second[name].astype(float)
        if a.shape != b.shape:
            print(f"{name}: {a.shape} and {b.shape}")
        else:
            print(f"{name}: largest difference {np.nanmax(np.abs(a - b)):.3g}")
    print(f"{len(common)} compared, {len(different)} differ, {len(missing)} in one only")
    return int(bool(different or missing))


if __name__ == "__main__":
    sys.exit(main())
