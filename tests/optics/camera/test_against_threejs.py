"""The matrices of three.js itself, where `benchmarks/threejs_cameras.py` has installed it."""

import importlib.util
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[3] / "benchmarks" / "threejs_cameras.py"


def load(path):
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


threejs = load(SOURCE)


@pytest.mark.slow
@pytest.mark.skipif(not threejs.installed(), reason="needs node, and three.js in output/threejs")
def test_a_hundred_random_cameras_have_the_matrices_of_threejs():
    """Both compute in double precision: 1e-10 is a long way within the 1e-6 that is asked for."""
    _, worst = threejs.differences(threejs.random_cameras(100))
    assert set(worst) == set(threejs.NAMES)
    assert {name: value for name, value in worst.items() if value > 1e-10} == {}


def test_our_side_of_the_comparison_needs_no_node():
    for camera in threejs.random_cameras(3):
        assert set(threejs.ours(camera)) == set(threejs.NAMES)
