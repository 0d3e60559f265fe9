"""Random cameras in this package and in three.js itself: the largest differences of their matrices.

    python benchmarks/threejs_cameras.py --cameras 100

It needs node and npm, and installs three.js into output/threejs once; git ignores that folder.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from potmesil_mi.optics import camera as cam

REPOSITORY = Path(__file__).parents[1]
FOLDER = REPOSITORY / "output" / "threejs"
PROGRAM = Path(__file__).with_suffix(".mjs")
ALLOWED = 1e-6

NAMES = {
    "perspective": "PerspectiveCamera.projectionMatrix, with zoom",
    "askew": "Matrix4.makePerspective, off the axis",
    "orthographic": "OrthographicCamera.projectionMatrix",
    "look_at": "PerspectiveCamera.lookAt: camera.matrix",
    "inverse": "camera.matrixWorldInverse",
    "object_look_at": "Object3D.lookAt: matrix",
    "projected": "Vector3.project: NDC of a point",
}


def installed() -> bool:
    """Whether node is there, and three.js in its folder."""
    return shutil.which("node") is not None and (FOLDER / "node_modules" / "three").is_dir()


def install() -> None:
    if shutil.which("node") is None or shutil.which("npm") is None:
        sys.exit("node and npm are needed, and at least one of them is not there")
    FOLDER.mkdir(parents=True, exist_ok=True)
    (FOLDER / "package.json").write_text('{"private": true}\n', encoding="utf-8")
    subprocess.run(["npm", "install", "--no-audit", "--no-fund", "three"], cwd=FOLDER, check=True)


def random_cameras(count: int, seed: int = 1) -> list[dict[str, Any]]:
    """Parameters of cameras, as JSON has them; the point is in front of each."""
    random = np.random.default_rng(seed)
    cameras = []
    for _ in range(count):
        eye, target, up = random.normal(0, 4, (3, 3))
        near = float(random.uniform(0.05, 2))
        cameras.append(
            {
                "eye": eye.tolist(),
                "target": target.tolist(),
                "up": up.tolist(),
                "y_fov": float(random.uniform(5, 150)),
                "aspect": float(random.uniform(0.3, 3)),
                "near": near,
                "far": near + float(random.uniform(0.5, 500)),
                "zoom": float(random.uniform(0.5, 3)),
                "left": float(random.uniform(-3, -0.1)),
                "right": float(random.uniform(0.1, 3)),
                "bottom": float(random.uniform(-3, -0.1)),
                "top": float(random.uniform(0.1, 3)),
                "point": (
                    eye + (target - eye) * random.uniform(0.5, 3) + random.normal(0, 0.05, 3)
                ).tolist(),
            }
        )
    return cameras


def ours(c: dict[str, Any]) -> dict[str, np.ndarray]:
    view = cam.Frustum(c["y_fov"], c["aspect"], c["near"], c["far"]).zoom(c["zoom"])
    window = [c[name] for name in ("left", "right", "bottom", "top", "near", "far")]
    place = cam.look_at(c["eye"], c["target"], c["up"])
    there = cam.rigid_inverse(place)
    clip = cam.multiply(view.clip_from_camera() @ there, (*c["point"], 1.0))
    return {
        "perspective": view.clip_from_camera(),
        "askew": cam.perspective_clip_from_camera(*window),
        "orthographic": cam.orthographic_clip_from_camera(*window),
        "look_at": place,
        "inverse": there,
        "object_look_at": cam.look_at(c["eye"], c["target"], c["up"], axes="mitsuba"),
        "projected": cam.perspective_divide(clip),
    }


def differences(cameras: list[dict[str, Any]]) -> tuple[str, dict[str, float]]:
    """Three.js' revision, and the largest difference of every matrix.

    A difference is relative to the largest entry of its matrix where that is over 1.
    """
    program = FOLDER / PROGRAM.name  # Modules are looked for beside the program.
    shutil.copyfile(PROGRAM, program)
    run = subprocess.run(
        ["node", program], input=json.dumps(cameras), capture_output=True, text=True, check=True
    )
    answer = json.loads(run.stdout)
    worst = dict.fromkeys(NAMES, 0.0)
    for camera, theirs in zip(cameras, answer["found"], strict=True):
        for name, matrix in ours(camera).items():
            expected = np.reshape(theirs[name], matrix.shape)
            size = max(1.0, np.abs(expected).max())
            worst[name] = max(worst[name], float(np.abs(matrix - expected).max() / size))
    return answer["revision"], worst


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--cameras", type=int, default=100)
    count = options.parse_args().cameras
    if not installed():
        install()
    revision, worst = differences(random_cameras(count))
    print(f"three.js r{revision}, {count} random cameras")
    print(f"{'':46}{'largest difference':>20}")
    for name, value in worst.items():
        print(f"{NAMES[name]:46}{value:20.1e}{'' if value < ALLOWED else '  too much'}")
    if max(worst.values()) >= ALLOWED:
        sys.exit(1)


if __name__ == "__main__":
    main()
