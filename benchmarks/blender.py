"""A picture of Blender, refocused by one command, beside Blender's own depth of field.

    python benchmarks/peers.py --install     # Blender (bpy) through pip, in a place of its own
    python benchmarks/blender.py             # 320x240; --images writes pictures and errors

Cycles renders a scene that is built here: the pinhole's picture with its pass of depth, a
multi-part EXR as Blender writes it, and a reference with its camera's depth of field, of two seeds.
From the first `potmesil focus` and Blender's Defocus node form the same picture. `potmesil focus`
is given the f-number, the focus distance and the width of the sensor, which the header lacks.

PSNR and SSIM are of sRGB; the noise of the reference is that of its halves. `--sample FILE` keeps
the EXR with stamps, small, for a test.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import common
import mitsuba as mi
import numpy as np
from common import OUTPUT, console, srgb_psnr
from peers import BLENDER, VENV, read_rgb, run

from potmesil_mi.evaluation import metrics
from potmesil_mi.pictures.channels import colours_of, depth_of
from potmesil_mi.pictures.reading import PictureFile

FOLDER = OUTPUT / "blender"
SENSOR = 36.0
"""Width of the sensor in millimetres."""

FOCAL_LENGTH = 35.0
"""In millimetres, as the scene has it."""

SCENE = """
import json, math, sys
import bpy

given = json.loads(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
render = scene.render
render.engine = "CYCLES"
scene.cycles.device = "CPU"
scene.cycles.use_denoising = False
scene.cycles.use_adaptive_sampling = False
scene.view_settings.view_transform = "Standard"
render.resolution_x, render.resolution_y = given["size"]
render.resolution_percentage = 100
render.use_compositing = False


def material(name, colour, strength=0.0, checker=0.0):
    new = bpy.data.materials.new(name)
    new.use_nodes = True
    nodes, links = new.node_tree.nodes, new.node_tree.links
    shader = nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1)
    shader.inputs["Roughness"].default_value = 0.9
    shader.inputs["Emission Color"].default_value = (*colour, 1)
    shader.inputs["Emission Strength"].default_value = strength
    if checker:
        texture = nodes.new("ShaderNodeTexChecker")
        texture.inputs["Scale"].default_value = checker
        texture.inputs["Color1"].default_value = (*colour, 1)
        texture.inputs["Color2"].default_value = (*(0.3 * part for part in colour), 1)
        where = nodes.new("ShaderNodeTexCoord")
        links.new(where.outputs["Object"], texture.inputs["Vector"])
        links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return new


def put(new):
    bpy.context.object.data.materials.append(new)


bpy.ops.mesh.primitive_plane_add(size=40, location=(0, 10, 0))
put(material("floor", (0.6, 0.55, 0.5), checker=1.5))
bpy.ops.mesh.primitive_plane_add(size=40, location=(0, 16, 10), rotation=(math.pi / 2, 0, 0))
put(material("wall", (0.3, 0.45, 0.7), checker=0.8))
for i in range(7):
    bpy.ops.mesh.primitive_uv_sphere_add(
        segments=64, ring_count=32, radius=0.35, location=(-1.1 + 0.35 * i, 2.2 + 1.4 * i, 0.35)
    )
    bpy.ops.object.shade_smooth()
    put(material(f"ball{i}", (0.8, 0.15 + 0.1 * i, 0.1)))
for i in range(5):
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(1.6 - 0.1 * i, 2.6 + 2 * i, 0.25 + 0.2 * i))
    put(material(f"box{i}", (0.2, 0.6, 0.3), checker=6))
for i in range(12):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.08, location=(-5 + 0.9 * i, 14, 1 + i * 5 % 4))
    put(material(f"lamp{i}", (1, 0.8, 0.5), strength=20))
bpy.ops.object.light_add(type="AREA", location=(-3, -1, 6))
light = bpy.context.object
light.data.energy, light.data.size = 600, 4
light.rotation_euler = (0.5, -0.4, 0)
world = bpy.data.worlds.new("world")
world.use_nodes = True
world.node_tree.nodes["Background"].inputs[0].default_value = (0.4, 0.45, 0.5, 1)
scene.world = world

data = bpy.data.cameras.new("camera")
camera = bpy.data.objects.new("camera", data)
scene.collection.objects.link(camera)
scene.camera = camera
camera.location, camera.rotation_euler = (0, 0, 1.0), (math.radians(84), 0, 0)
data.lens, data.sensor_width = 35.0, given["sensor"]
data.dof.focus_distance, data.dof.aperture_fstop = given["focus"], given["f_stop"]

layer = scene.view_layers[0]
layer.use_pass_z = True
settings = render.image_settings
if hasattr(settings, "media_type"):
    settings.media_type = "MULTI_LAYER_IMAGE"
settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
render.use_stamp_lens = render.use_stamp_camera = True
render.use_stamp = False
render.use_stamp_note = False
scene.cycles.samples = given["samples"]
render.filepath = given["pinhole"]
bpy.ops.render.render(write_still=True)

if given["references"]:
    data.dof.use_dof = True
    scene.cycles.samples = given["reference_samples"]
    for seed, path in enumerate(given["references"]):
        scene.cycles.seed, render.filepath = seed + 1, path
        bpy.ops.render.render(write_still=True)
print("RESULT", json.dumps({"version": bpy.app.version_string}))
"""


def main() -> None:
    options = common.parser(__doc__.splitlines()[0])
    options.add_argument("--size", type=int, nargs=2, default=[320, 240])
    options.add_argument("--samples", type=int, default=128, help="of the pinhole's picture")
    options.add_argument("--reference-samples", type=int, default=1024, help="of each half")
    options.add_argument("--f-number", type=float, default=0.4)
    options.add_argument("--focus", type=float, nargs="+", default=[2.2, 5.0, 14.0], metavar="M")
    options.add_argument("--python", type=Path, default=VENV / "bin" / "python", help="with bpy")
    options.add_argument("--images", action="store_true", help="write pictures and errors")
    options.add_argument("--sample", type=Path, metavar="FILE", help="keep the EXR")
    arguments = options.parse_args()
    common.start(arguments)
    FOLDER.mkdir(parents=True, exist_ok=True)
    table = common.table(
        f"{arguments.size[0]}x{arguments.size[1]}, f/{arguments.f_number:g}, against Cycles",
        ("focus m", "reference dB", "potmesil dB", "SSIM", "Defocus dB", "SSIM", "pinhole dB"),
    )
    for focus in arguments.focus:
        table.add_row(f"{focus:g}", *compared(focus, arguments))
    console.print(table)
    if arguments.sample:
        shutil.copy(pinhole_of(arguments), arguments.sample)


def pinhole_of(arguments: argparse.Namespace) -> Path:
    width, height = arguments.size
    return FOLDER / f"pinhole_{width}x{height}_{arguments.samples}.exr"


def compared(focus: float, arguments: argparse.Namespace) -> list[str]:
    """The row of a focus distance."""
    name = f"{arguments.size[0]}x{arguments.size[1]}_{arguments.f_number:g}_{focus:g}"
    pinhole = pinhole_of(arguments)
    halves = [FOLDER / f"{name}_{arguments.reference_samples}_{half}.exr" for half in "ab"]
    job = {
        "size": arguments.size,
        "sensor": SENSOR,
        "focus": focus,
        "f_stop": arguments.f_number,
        "samples": arguments.samples,
        "reference_samples": arguments.reference_samples,
        "pinhole": str(pinhole),
        "references": [str(half) for half in halves if not half.exists()],
        "output": str(FOLDER / f"{name}_defocus.exr"),
    }
    if job["references"] or not pinhole.exists():
        with_bpy(SCENE, job, arguments)
    picture, depth = combined(pinhole), z_of(pinhole)
    for values, what in ((picture, "picture"), (depth[..., None], "depth")):
        job[what] = str(FOLDER / f"{name}_{what}.exr")
        mi.Bitmap(np.ascontiguousarray(values, np.float32)).write(str(job[what]))
    job |= {"focal": FOCAL_LENGTH, "frame": SENSOR, "blur_max": 200, "repeats": 0, "long": 60}
    with_bpy(BLENDER, job, arguments)
    formed = FOLDER / f"{name}_potmesil.exr"
    command = [sys.executable, "-m", "potmesil_mi", "focus", str(pinhole), "-o", str(formed)]
    lens = {"f-number": arguments.f_number, "focus-distance": focus, "frame-width": SENSOR}
    for option, value in lens.items():
        command += [f"--{option}", f"{value:g}"]
    subprocess.run(command, check=True)
    first, second = (combined(half) for half in halves)
    reference = (first + second) / 2
    pictures = {
        "potmesil": read_rgb(formed),
        "defocus": read_rgb(Path(job["output"])),
        "pinhole": picture,
    }
    if arguments.images:
        for what, formed in pictures.items():
            common.write_png(FOLDER / f"{name}_{what}.png", formed)
        common.write_png(FOLDER / f"{name}_reference.png", reference)
    noise = srgb_psnr(first, second) + 10 * np.log10(4)
    row = [f"{noise:.1f}"]
    for what in ("potmesil", "defocus"):
        row += [
            f"{srgb_psnr(pictures[what], reference):.2f}",
            f"{metrics.ssim(pictures[what], reference):.4f}",
        ]
    return [*row, f"{srgb_psnr(pictures['pinhole'], reference):.2f}"]


def combined(path: Path) -> np.ndarray:
    """The picture in a multi-part EXR of Blender."""
    file = PictureFile(path)
    channels = colours_of(file, None)
    return file.channels(channels[0].part, [of.name for of in channels[:3]])


def z_of(path: Path) -> np.ndarray:
    """Its depth."""
    channel = depth_of(PictureFile(path), None, need=True)
    return PictureFile(path).channels(channel.part, [channel.name])[..., 0]


def with_bpy(script: str, job: dict[str, object], arguments: argparse.Namespace) -> None:
    """Run a script in a process with Blender's module."""
    if not arguments.python.exists():
        raise SystemExit(f"there is no {arguments.python}: python benchmarks/peers.py --install")
    log = run([str(arguments.python), "-c", script, json.dumps(job)])
    if re.search(r"^RESULT", log, re.MULTILINE) is None:
        raise SystemExit(f"bpy ended without a result:\n{log[-2000:]}")


if __name__ == "__main__":
    main()
