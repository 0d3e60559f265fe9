"""The focused picture beside those of other programs that blur a picture by its depth.

All start from the same scene in one run. potmesil_mi focuses its point samples, and then what the
peers are given by itself, as it does pictures of other programs; GEGL's `lens-blur`
and Blender's Defocus node are given the pinhole picture that the same samples make, and its depth,
and then a pinhole picture of many more samples; Mitsuba's `thinlens` is given the time that
potmesil_mi takes. The reference is a converged `thinlens`.

    python benchmarks/peers.py --install            # GEGL through apt, Blender (bpy) through pip
    python benchmarks/peers.py                      # 1920x1080, the largest circle 100 pixels
    python benchmarks/peers.py --res 384 216 --circle 20 --floor 38      # a quick try

Times are of the blur alone, with neither reading nor writing of files on any side: GEGL's are what
it measures for the operation itself, Blender's what the compositor takes more with the node than
without. Reference, pinhole picture and the pictures made of them are kept in `output/peers/` and
used again; delete them to start anew. At full size the first run may take an hour.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import common
import mitsuba as mi
import numpy as np
from common import console, first_and_steady, timed
from references import LampLight, Reference, scene_version
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

import potmesil_mi as pm
from potmesil_mi.evaluation import metrics, thinlens_sensor
from potmesil_mi.focusing.methods import MethodName

FOLDER = common.OUTPUT / "peers"
VENV = FOLDER / "venv"
BLENDER_PYTHONS = ("python3.11", "python3.13", "python3.12", "python3.14")
LONG = 60.0
"""Seconds from which on a peer is run just once."""
PASS = 32
"""Samples a pixel of each rendering that the reference and the pinhole picture are the mean of."""
GIVEN = ("same", "clean")
FAR = 1e6
"""Depth in scene units, for the peers, of what is infinitely far away."""


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--install", action="store_true", help="install the peers, then stop")
    options.add_argument("--scene", type=Path, default=common.ROOT / "scenes" / "terrace.xml")
    options.add_argument(
        "--res", type=int, nargs=2, default=(1920, 1080), metavar=("WIDTH", "HEIGHT")
    )
    options.add_argument(
        "--circle",
        type=float,
        default=100,
        metavar="PIXELS",
        help="diameter of the largest circle of confusion, for which the f-number is chosen",
    )
    options.add_argument(
        "--focus-distance", type=float, metavar="U", help="in scene units; None is the scene's"
    )
    options.add_argument(
        "--methods",
        nargs="+",
        choices=get_args(MethodName),
        default=["layered"],
        help="of potmesil_mi; the time of the first is what thinlens is given",
    )
    options.add_argument("--spp", type=int, default=16, help="point samples a pixel")
    options.add_argument(
        "--pinhole-spp", type=int, default=256, help="of the peers' other, cleaner picture"
    )
    options.add_argument(
        "--given",
        nargs="+",
        choices=GIVEN,
        default=list(GIVEN),
        help="pictures that the peers blur: of our samples, or a cleaner one",
    )
    options.add_argument(
        "--floor",
        type=float,
        default=42,
        metavar="DB",
        help="PSNR of the reference's own noise at which it is done",
    )
    options.add_argument(
        "--reference-spp", type=int, default=2048, help="most samples a pixel of the reference"
    )
    options.add_argument(
        "--lamps",
        metavar="PREFIX",
        help="names of small lamps, left to benchmarks/references.py in the reference",
    )
    options.add_argument("--repeats", type=int, default=3, help="after a warm-up")
    options.add_argument("--skip", nargs="*", default=[], choices=("gegl", "blender"))
    arguments = options.parse_args()
    if arguments.install:
        install()
        return
    common.start(arguments)
    inputs = Inputs(arguments)
    console.print(
        f"{arguments.scene.name}, {inputs.width}x{inputs.height}, focused at "
        f"{inputs.lens.focus_distance:g}, f/{inputs.lens.f_number:.3g}: largest circle "
        f"{2 * np.abs(inputs.radius).max():.1f} pixels"
    )

    same, rows = ours(inputs, arguments)
    rows += [
        thinlens_in(row.seconds, what, inputs, arguments)
        for row, what in zip(rows[:2], ("refocusing", "samples and focus"), strict=True)
    ]
    given = {
        "same": Given("of the same samples", same, inputs.write("same", same)),
        "clean": Given(
            f"of {arguments.pinhole_spp} samples",
            inputs.pinhole,
            inputs.write("clean", inputs.pinhole),
        ),
    }
    peers: dict[str, Callable[[Inputs, Given, argparse.Namespace], Row]] = {
        "gegl": gegl,
        "blender": blender,
    }
    for picture in (given[name] for name in arguments.given):
        rows.append(Row(f"pinhole picture {picture.name}", picture.picture))
        rows.append(of_picture(inputs, picture, arguments))
        for name, run in peers.items():
            if name in arguments.skip:
                continue
            try:
                rows.append(run(inputs, picture, arguments))
            except (OSError, RuntimeError, subprocess.SubprocessError) as error:
                console.print(f"[red]{name} is left out:[/red] {error}")
    show(rows, inputs, arguments)


@dataclasses.dataclass
class Row:
    """A picture in linear RGB, the seconds it took, and those of a whole command with files."""

    name: str
    picture: np.ndarray
    seconds: float = math.nan
    command: float = math.nan


@dataclasses.dataclass
class Given:
    """A picture through a pinhole that the peers blur, and its file."""

    name: str
    picture: np.ndarray
    file: Path


def show(rows: list[Row], inputs: Inputs, arguments: argparse.Namespace) -> None:
    columns = ["picture", "seconds", "command s", "PSNR", "PSNR sRGB", "SSIM", "FLIP"]
    table = common.table(
        f"Against a converged thinlens; {inputs.width}x{inputs.height}, largest circle "
        f"{arguments.circle:g} pixels",
        columns,
    )
    reference = inputs.reference.mean
    for row in rows:
        times = ["" if math.isnan(s) else f"{s:.2f}" for s in (row.seconds, row.command)]
        table.add_row(
            row.name,
            *times,
            f"{metrics.psnr(row.picture, reference):.2f}",
            f"{common.srgb_psnr(row.picture, reference):.2f}",
            f"{metrics.ssim(row.picture, reference):.4f}",
            f"{metrics.flip(row.picture, reference):.4f}",
        )
        slug = re.sub(r"[^a-z0-9]+", "_", row.name.lower()).strip("_")
        common.write_png(inputs.folder / f"{slug}.png", row.picture)
    common.write_png(inputs.folder / "reference.png", reference)
    table.add_section()
    table.add_row("noise floor of the reference", "", "", f"{inputs.reference.floor:.2f}")
    console.print(table)
    console.print(
        f"seconds: median of {arguments.repeats} after a warm-up, without files on any side (one "
        f"run where it takes more than {LONG:g} s). command s: the whole program, with start, "
        "reading and writing. PSNR: linear RGB, and sRGB, clipped to [0, 1]. SSIM, FLIP: sRGB, "
        f"FLIP at {metrics.PIXELS_PER_DEGREE:g} pixels a degree. Reference of "
        f"{inputs.reference.count * PASS} samples a pixel. Pictures: {inputs.folder}"
    )
    if inputs.reference.floor < arguments.floor:
        console.print(f"[red]below the {arguments.floor:g} dB asked for: more --reference-spp")


# ---------------------------------------------------------------- what all are given


class Inputs:
    """The scene, its lens, and what the peers are given; made once and kept."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.width, self.height = arguments.res
        defines = {"width": self.width, "height": self.height, "spp": arguments.spp}
        self.scene = mi.load_file(str(arguments.scene), optimize=False, **defines)
        integrator = self.scene.integrator()
        self.integrator = getattr(integrator, "nested", integrator)
        sensor = self.scene.sensors()[0]
        changes = {"f_number": 1.0}
        if arguments.focus_distance is not None:
            changes["focus_distance"] = arguments.focus_distance
        sensor = pm.potmesil_sensor(sensor, **changes)
        self.depth = depth_of(self, sensor)
        pixels = self.width / sensor.lens().frame_width
        widest = np.abs(sensor.lens().circle_of_confusion(self.depth)).max() * pixels
        # The circle is inversely proportional to the f-number.
        self.sensor = pm.potmesil_sensor(sensor, f_number=float(widest / arguments.circle))
        self.lens = self.sensor.lens()
        self.radius = self.lens.circle_of_confusion(self.depth) * pixels / 2
        """Signed radius of the circle of confusion in pixels, positive before the focus."""

        self.folder = FOLDER / (
            f"{arguments.scene.stem}_{scene_version(arguments.scene)}_{self.width}x{self.height}"
            f"_f{self.lens.f_number:.5g}_{self.lens.focus_distance:g}"
        )
        self.folder.mkdir(parents=True, exist_ok=True)
        closed = self.lens.replace(f_number=math.inf)
        self.pinhole = converge(
            self.mean("pinhole"),
            "pinhole picture",
            math.inf,
            arguments.pinhole_spp,
            lambda seed: self.render(closed, PASS, seed),
        ).mean.astype(np.float32)
        with LampLight(self.scene, arguments.lamps) as light:
            self.reference = converge(
                self.mean("reference"),
                "reference",
                arguments.floor,
                arguments.reference_spp,
                lambda seed: self.render(self.lens, PASS, seed) + light.through(self.lens, seed),
            )

    def mean(self, name: str) -> Reference:
        """What is kept of the mean of pictures of ``PASS`` samples a pixel."""
        return Reference.open(self.folder / f"{name}.npz", (self.width, self.height), PASS)

    def render(self, lens: pm.ThinLens, spp: int, seed: int) -> np.ndarray:
        """The built-in sensor's picture through ``lens``."""
        sensor = thinlens_sensor(self.sensor, lens, spp=spp)
        spp = sensor.sampler().sample_count()
        return np.array(
            mi.render(self.scene, sensor=sensor, integrator=self.integrator, spp=spp, seed=seed)
        )

    def write(self, name: str, values: np.ndarray) -> Path:
        """A picture (H, W, 1 or 3) in single precision."""
        path = self.folder / f"{name}.exr"
        mi.Bitmap(np.ascontiguousarray(values, dtype=np.float32)).write(str(path))
        return path


def depth_of(inputs: Inputs, sensor: mi.Sensor) -> np.ndarray:
    """Depth of one sample in each pixel, not blended: what a renderer's depth pass has."""
    integrator = mi.load_dict({"type": "point_samples", "nested": inputs.integrator})
    picture = np.array(mi.render(inputs.scene, sensor=sensor, integrator=integrator, spp=1, seed=1))
    names = integrator.aov_names()
    channel = picture.shape[2] - len(names) + names.index("z")
    return np.minimum(picture[..., channel].astype(np.float64), FAR)


def converge(
    mean: Reference, name: str, floor: float, most_spp: int, render: Callable[[int], np.ndarray]
) -> Reference:
    """Add pictures until the noise is at ``floor`` dB or there are ``most_spp`` samples."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(name, total=most_spp)
        while mean.count == 0 or (mean.floor < floor and mean.count * PASS < most_spp):
            mean.add_pair(render)
            progress.update(
                task,
                completed=mean.count * PASS,
                description=f"{name}: {mean.count * PASS} samples a pixel, "
                f"noise {mean.floor:.1f} dB",
            )
        progress.update(task, completed=mean.count * PASS, total=mean.count * PASS)
    return mean


# ---------------------------------------------------------------- Mitsuba


def ours(inputs: Inputs, arguments: argparse.Namespace) -> tuple[np.ndarray, list[Row]]:
    """By each method: refocusing, and the first picture, for which the samples are taken.

    And the samples' picture through a pinhole.
    """
    made: list[pm.PointSamples] = []

    def take() -> int:
        made[:] = [
            pm.render_samples(
                inputs.scene, inputs.sensor, inputs.integrator, spp=arguments.spp, seed=1
            )
        ]
        return 0

    timed(take)
    _, taking = timed(take)
    console.print(f"{len(made[0]):,} point samples in {taking:.2f} s")
    rfilter = inputs.sensor.film().rfilter()
    # Refocusing is to another distance, so that nothing of the lens can be used again.
    others = [
        inputs.lens.replace(focus_distance=inputs.lens.focus_distance * (1 + number / 100))
        for number in range(1, arguments.repeats + 1)
    ]
    rows = []
    for method in arguments.methods:

        def form(lens: pm.ThinLens, method: str = method) -> mi.TensorXf:
            return pm.focus(made[0], lens, method=method, rfilter=rfilter)

        picture, _ = timed(lambda form=form: form(inputs.lens))
        made[0] = dataclasses.replace(made[0])  # as if just taken
        _, first = timed(lambda form=form: form(inputs.lens))
        steady = statistics.median(
            timed(lambda form=form, lens=lens: form(lens))[1] for lens in others
        )
        console.print(f"{method}: {first:.2f} s for the first picture of new samples")
        name = f"potmesil_mi {method}"
        rows.append(Row(f"{name}, refocused", picture, steady))
        rows.append(Row(f"{name}, {arguments.spp} spp and focus", picture, taking + first))
    closed = inputs.lens.replace(f_number=math.inf)
    return np.array(pm.focus(made[0], closed, rfilter=rfilter)), rows


def of_picture(inputs: Inputs, given: Given, arguments: argparse.Namespace) -> Row:
    """What the peers are given, refocused: the picture and one depth a pixel, no samples."""
    camera = inputs.sensor.camera()
    samples = pm.PointSamples.from_image(
        given.picture, inputs.depth, camera=camera, lens=inputs.lens, depth_kind="z"
    )
    session = pm.FocusSession(samples)
    picture, _ = timed(lambda: session.focus(inputs.lens))
    others = [
        inputs.lens.replace(focus_distance=inputs.lens.focus_distance * (1 + number / 100))
        for number in range(1, arguments.repeats + 1)
    ]
    steady = statistics.median(timed(lambda lens=lens: session.focus(lens))[1] for lens in others)
    return Row(f"potmesil_mi of the pinhole picture {given.name}, refocused", picture, steady)


def thinlens_in(seconds: float, what: str, inputs: Inputs, arguments: argparse.Namespace) -> Row:
    """`thinlens` with as many samples as it can take in ``seconds``, one at least."""
    spp = 4
    for again in (False, True, True):  # the first time compiles
        _, took = timed(lambda spp=spp: inputs.render(inputs.lens, spp, 1))
        spp = max(1, round(spp * seconds / took)) if again else spp
    repeats = arguments.repeats if seconds < LONG else 1
    picture, _, steady = first_and_steady(lambda: inputs.render(inputs.lens, spp, 1), repeats)
    return Row(f"thinlens in the time of {what}, {spp} spp", picture, steady)


# ---------------------------------------------------------------- GEGL


def gegl(inputs: Inputs, given: Given, arguments: argparse.Namespace) -> Row:
    """`lens-blur`: every pixel is spread over its disc; near and far are not told apart.

    Its disc is half a pixel wider than asked for, which is taken off here. Its time is what it
    prints itself of the operation; as a check, the whole is also timed with and without it.
    """
    if shutil.which("gegl") is None:
        raise RuntimeError("there is no command gegl: --install, or apt-get install gegl")
    radius = np.maximum(np.abs(inputs.radius) - 0.5, 0)
    mask = inputs.write("gegl_mask", (radius / radius.max())[..., None])
    output = inputs.folder / "gegl.exr"
    blur = ["lens-blur", f"radius={radius.max():.6f}", "linear-mask=true"]
    command = ["gegl", str(given.file), "-o", str(output), "--"]
    aux = ["aux=[", "load", f"path={mask}", "]"]
    environment = {**os.environ, "GEGL_DEBUG_TIME": "1", "GEGL_USE_OPENCL": "no"}
    inner, whole, reading = [], [], []
    for _ in range(1 + arguments.repeats):
        # Both pictures are read where they are added, too.
        _, seconds = timed(lambda: run([*command, "add", *aux], environment))
        reading.append(seconds)
        began = time.perf_counter()
        log = run([*command, *blur, *aux], environment)
        whole.append(time.perf_counter() - began)
        inner.append(gegl_seconds(log, "gegl:lens-blur"))
    picture = read_rgb(output)
    version = ""
    if shutil.which("dpkg-query"):
        version = run(["dpkg-query", "-W", "-f", "${Version}", "gegl"]).strip() + " "
    inner, whole, reading = (statistics.median(times[1:]) for times in (inner, whole, reading))
    console.print(
        f"GEGL: {inner:.2f} s in lens-blur by its own count; its command takes {whole:.2f} s, "
        f"{whole - reading:.2f} s more than one that adds the two pictures in its place"
    )
    return Row(f"GEGL {version}lens-blur, {given.name}", picture, inner, whole)


def gegl_seconds(log: str, operation: str) -> float:
    """Seconds in an operation, from GEGL's own table of nested percentages."""
    total = re.search(r"Total time: ([\d.]+)s", log)
    if total is None:
        raise RuntimeError(f"gegl printed no times:\n{log}")
    shares: list[tuple[int, float]] = []
    for line in log.splitlines():
        entry = re.match(r"( *)(\S.*?) +([\d.]+)% ", line)
        if entry is None:
            continue
        indent = len(entry[1])
        while shares and shares[-1][0] >= indent:
            shares.pop()
        shares.append((indent, float(entry[3]) / 100))
        if entry[2] == operation:
            return float(total[1]) * math.prod(share for _, share in shares)
    raise RuntimeError(f"gegl printed no time of {operation}:\n{log}")


# ---------------------------------------------------------------- Blender

BLENDER = """
import json, sys, time
import bpy

given = json.loads(sys.argv[1])
scene = bpy.context.scene
render = scene.render
render.resolution_x, render.resolution_y = given["size"]
render.resolution_percentage = 100
render.compositor_device, render.compositor_precision = "CPU", "FULL"
render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
camera = bpy.data.cameras.new("camera")
scene.camera = bpy.data.objects.new("camera", camera)
scene.collection.objects.link(scene.camera)
camera.lens, camera.sensor_width, camera.sensor_fit = given["focal"], given["frame"], "HORIZONTAL"
camera.dof.focus_distance = given["focus"]

if hasattr(scene, "compositing_node_group"):
    tree = bpy.data.node_groups.new("tree", "CompositorNodeTree")
    scene.compositing_node_group = tree
    tree.interface.new_socket(name="Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    output = tree.nodes.new("NodeGroupOutput")
else:
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("CompositorNodeComposite")


def image(path):
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(path)
    node.image.colorspace_settings.name = "Linear Rec.709"
    return node.outputs[0]


picture, depth = image(given["picture"]), image(given["depth"])
node = tree.nodes.new("CompositorNodeDefocus")
node.use_zbuffer, node.f_stop, node.blur_max = True, given["f_stop"], given["blur_max"]
node.bokeh, node.scene = "CIRCLE", scene
tree.links.new(picture, node.inputs["Image"])
tree.links.new(depth, node.inputs["Z"])


def seconds():
    began = time.perf_counter()
    bpy.ops.render.render()
    return time.perf_counter() - began


# The depth is read too where nothing is blurred: the limit of the blur is 0.
tree.links.new(node.outputs[0], output.inputs[0])
node.blur_max = 0
without = [seconds() for _ in range(3)][1:]
node.blur_max = given["blur_max"]
times = [seconds()]
while len(times) <= given["repeats"] and times[0] < given["long"]:
    times.append(seconds())
bpy.data.images["Render Result"].save_render(given["output"])
print("RESULT", json.dumps({"version": bpy.app.version_string, "with": times, "without": without}))
"""


def blender(inputs: Inputs, given: Given, arguments: argparse.Namespace) -> Row:
    """The Defocus node, with the lens of the scene: it uses equation 8 of the paper."""
    python = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    if not python.exists():
        raise RuntimeError(f"there is no {python}: --install")
    output = inputs.folder / "blender.exr"
    # Blender's lengths are in metres.
    unit = inputs.lens.millimeters_per_unit / 1000
    job = {
        "size": [inputs.width, inputs.height],
        "focal": inputs.lens.focal_length,
        "frame": inputs.lens.frame_width,
        "focus": inputs.lens.focus_distance * unit,
        "f_stop": inputs.lens.f_number,
        "blur_max": math.ceil(np.abs(inputs.radius).max()) + 1,
        "picture": str(given.file),
        "depth": str(inputs.write("depth", inputs.depth[..., None] * unit)),
        "output": str(output),
        "repeats": arguments.repeats,
        "long": LONG,
    }
    began = time.perf_counter()
    log = run([str(python), "-c", BLENDER, json.dumps(job)])
    whole = time.perf_counter() - began
    result = re.search(r"^RESULT (.*)$", log, re.MULTILINE)
    if result is None:
        raise RuntimeError(f"bpy ended without a result:\n{log[-2000:]}")
    report = json.loads(result[1])
    times = report["with"][1:] or report["with"]
    seconds = statistics.median(times) - statistics.median(report["without"])
    if len(report["with"]) == 1:
        console.print("Blender: one run, without a warm-up")
    else:
        whole -= sum(report["with"][1:]) + sum(report["without"])
    return Row(
        f"Blender {report['version']} Defocus, {given.name}", read_rgb(output), seconds, whole
    )


# ---------------------------------------------------------------- programs


def run(command: list[str], environment: dict[str, str] | None = None) -> str:
    """Standard output of a program; ``RuntimeError`` with its messages where it fails."""
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[:3])} ended with {done.returncode}: {done.stderr}")
    return done.stdout


def read_rgb(path: Path) -> np.ndarray:
    bitmap = mi.Bitmap(str(path))
    return np.array(bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))


def install() -> None:
    """GEGL through apt, Blender's module in an environment of its own; says what went wrong."""
    for name, action in (("gegl", install_gegl), ("bpy", install_blender)):
        try:
            console.print(f"{name}: {action()}")
        except (OSError, RuntimeError) as error:
            console.print(f"[red]{name} is not installed:[/red] {error}")


def install_gegl() -> str:
    if shutil.which("gegl") is None:
        if shutil.which("apt-get") is None:
            raise RuntimeError("there is no apt-get: install gegl by other means")
        apt = [] if os.geteuid() == 0 else ["sudo"]
        apt += ["apt-get", "install", "-y", "--no-install-recommends", "gegl"]
        run(apt)
    return shutil.which("gegl") or "no command gegl"


def install_blender() -> str:
    """Wheels of bpy are for one version of Python each: the first that has one is taken."""
    pythons = [sys.executable, *filter(None, map(shutil.which, BLENDER_PYTHONS))]
    python = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    problems = []
    for base in dict.fromkeys(pythons):
        try:
            run([base, "-m", "venv", "--clear", str(VENV)])
            run([str(python), "-m", "pip", "install", "--quiet", "bpy"])
            return run([str(python), "-c", "import bpy; print(bpy.app.version_string)"]).strip()
        except RuntimeError as error:
            problems.append(f"{base}: {str(error).strip().splitlines()[-1]}")
    shutil.rmtree(VENV, ignore_errors=True)
    raise RuntimeError(
        f"no Python here (this one is {platform.python_version()}) has a wheel of bpy: "
        + "; ".join(problems)
    )


if __name__ == "__main__":
    main()
