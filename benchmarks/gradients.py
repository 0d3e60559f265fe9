"""How good gradients of pictures are, and what they take: python gradients.py

Derivatives are compared with central differences of pictures of the same samples, without gradients
and with them, in the loss of autofocus: the mean square difference to a picture whose parameter is
4/5, and 5/4, as large. Then forwards, backwards and plain pictures are timed in turn.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import potmesil_mi as pm

import drjit as dr  # isort: skip
import mitsuba as mi
import numpy as np

PARAMETERS = ("focus_distance", "f_number", "focal_length", "depth", "colour")
TARGETS = (0.8, 1.25)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", default=["figure11", "thicket"])
    parser.add_argument("--surfaces", nargs="+", default=["cube", "Mesh_9"], help="that move")
    parser.add_argument("--f-numbers", type=float, nargs="+", default=[5.6, 2.87])
    parser.add_argument("--steps", type=float, nargs="+", default=[0.002, 0.005, 0.02])
    parser.add_argument("--method", default="layered")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--no-quality", action="store_true")
    parser.add_argument("--memory-of", choices=["plain", "gradients"], help=argparse.SUPPRESS)
    return parser.parse_args()


def forming(
    samples: pm.PointSamples, lens: pm.ThinLens, surface: str, method: str
) -> Callable[..., mi.TensorXf]:
    """A function of a parameter's name and by how much it is larger: the picture."""
    ids = {name: id_ for id_, name in samples.surfaces.items()}
    which = (samples.surface == ids[surface]).astype(np.float32)
    mask, of_colours = mi.Float(which), mi.Float(np.repeat(which, 3))

    def form(name: str, value: mi.Float | float) -> mi.TensorXf:
        if name == "depth":
            z = samples.z * (1 + which * (value - 1)) if isinstance(value, float) else None
            moved = mi.Float(samples.z) * (1 + mask * (value - 1)) if z is None else z
            return pm.focus(samples.replace(z=moved), lens, method=method)
        if name == "colour":
            rgb = mi.Float(samples.rgb.ravel()) * (1 + of_colours * (value - 1))
            colours = mi.TensorXf(rgb, samples.rgb.shape)
            return pm.focus(samples.replace(rgb=colours), lens, method=method)
        changed = lens.replace(**{name: value * float(getattr(lens, name))})
        return pm.focus(samples, changed, method=method)

    return form


def attached(value: float) -> mi.Float:
    number = dr.opaque(mi.Float, value)
    dr.enable_grad(number)
    return number


def picture(image: mi.TensorXf) -> np.ndarray:
    return np.array(dr.detach(image), dtype=np.float64)


def quality(form: Callable[..., mi.TensorXf], steps: list[float]) -> None:
    for name in PARAMETERS:
        targets = [picture(form(name, factor)) for factor in TARGETS]
        plain = picture(form(name, 1.0))
        value = attached(1.0)
        image = form(name, value)
        dr.set_grad(value, dr.opaque(mi.Float, 1.0))
        dr.enqueue(dr.ADMode.Forward, value)
        dr.traverse(dr.ADMode.Forward)
        exact, smooth = np.array(dr.grad(image), dtype=np.float64), picture(image)
        apart = 10 * np.log10(plain.max() ** 2 / ((smooth - plain) ** 2).mean())
        print(f"  {name}: with and without gradients {apart:.1f} dB apart")
        for step in steps:
            found = [
                (form_of(1 + step) - form_of(1 - step)) / (2 * step)
                for form_of in (
                    lambda factor, name=name: picture(form(name, float(factor))),
                    lambda factor, name=name: picture(form(name, attached(factor))),
                )
            ]
            off = [
                [
                    100 * (np.vdot(of, smooth - at) / np.vdot(exact, smooth - at) - 1)
                    for at in targets
                ]
                for of in found
            ]
            print(
                f"    step {100 * step:4.1f} %: plain pictures {off[0][0]:+6.2f} "
                f"{off[0][1]:+6.2f} %, with gradients {off[1][0]:+6.2f} {off[1][1]:+6.2f} %"
            )


def speed(samples: pm.PointSamples, lens: pm.ThinLens, method: str, repeats: int) -> None:
    session = pm.FocusSession(samples, method)
    target = mi.TensorXf(picture(session.focus(lens)).astype(np.float32))
    base = float(lens.plain().focus_distance)
    times: dict[str, list[float]] = {"plain": [], "forwards": [], "backwards": []}
    for repeat in range(repeats + 1):
        focus = base * (1 + 0.01 * (repeat % 5))
        start = time.perf_counter()
        dr.eval(session.focus(lens.replace(focus_distance=focus)))
        dr.sync_thread()
        plain = time.perf_counter()
        numbers = attached(focus), attached(float(lens.f_number))
        image = session.focus(lens.replace(focus_distance=numbers[0], f_number=numbers[1]))
        dr.eval(image)
        dr.sync_thread()
        formed = time.perf_counter()
        dr.backward(dr.mean(dr.square(image - target), axis=None))
        dr.eval([dr.grad(number) for number in numbers])
        dr.sync_thread()
        end = time.perf_counter()
        if repeat > 0:
            times["plain"].append(plain - start)
            times["forwards"].append(formed - plain)
            times["backwards"].append(end - formed)
    plain, forwards, backwards = (statistics.median(of) for of in times.values())
    print(
        f"  {plain:.3f} s without gradients; with them {forwards:.3f} s forwards and "
        f"{backwards:.3f} s backwards: {(forwards + backwards) / plain:.1f} times a plain picture, "
        f"{(forwards + backwards) / forwards:.1f} times forwards"
    )


def peak_of(kind: str, scene: str) -> float:
    """Memory in GB, at the peak, that a picture takes beside its samples."""
    command = [sys.executable, __file__, "--memory-of", kind, "--scenes", scene]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def memory(of: str) -> float:
    """Memory of this process in GB: VmRSS, what it has now, or VmHWM, at its peak."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1e6 for line in lines if line.startswith(of))


def measure_memory(kind: str, scene: str) -> None:
    samples = pm.PointSamples.load(f"{scene}.samples")
    lens = samples.lens
    before = memory("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # The peak is counted from here on.
    if kind == "plain":
        dr.eval(pm.focus(samples, lens))
    else:
        number = attached(float(lens.plain().focus_distance))
        rgb = mi.TensorXf(samples.rgb)
        dr.enable_grad(rgb)
        image = pm.focus(samples.replace(rgb=rgb), lens.replace(focus_distance=number))
        dr.backward(dr.mean(dr.square(image), axis=None))
        dr.eval(dr.grad(rgb), dr.grad(number))
    dr.sync_thread()
    print(memory("VmHWM") - before)


def main() -> None:
    given = arguments()
    mi.set_variant("cuda_ad_rgb", "llvm_ad_rgb")
    warnings.simplefilter("ignore", pm.FocusWarning)
    if given.memory_of:
        return measure_memory(given.memory_of, given.scenes[0])
    for scene, surface, f_number in zip(given.scenes, given.surfaces, given.f_numbers, strict=True):
        samples = pm.render_samples(mi.load_file(str(pm.example(scene))))
        samples.save(f"{scene}.samples")
        lens = samples.lens.replace(f_number=f_number)
        size = samples.camera.crop_size
        print(f"{scene}, {size[0]}x{size[1]}, {len(samples)} samples, f/{f_number}, {given.method}")
        if not given.no_quality:
            quality(forming(samples, lens, surface, given.method), given.steps)
        speed(samples, lens, given.method, given.repeats)
        plain, gradients = (peak_of(kind, scene) for kind in ("plain", "gradients"))
        print(
            f"  memory {plain:.2f} GB without gradients, {gradients:.2f} GB with those of "
            f"colours and focus: {gradients / plain:.1f} times"
        )
    return None


if __name__ == "__main__":
    main()
