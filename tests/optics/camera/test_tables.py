"""The page of camera models: its program runs, and what its tables name is there."""

import re
from pathlib import Path

import numpy as np

import potmesil_mi as pm
from potmesil_mi.optics import camera as cam

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "camera-models.md").read_text(encoding="utf-8")


def test_the_program_of_the_page_runs():
    program = re.search(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    names = {"print": lambda *values: None}
    exec(program, names)
    np.testing.assert_allclose(names["steps"].pixels[0], [320, 160], atol=1e-12)


NO_FUNCTIONS = {"axes", "dataclasses", "lens_center", "eye", "potmesil_mi"}
"""First words of code in the tables that is no function of the package."""


def test_functions_and_tests_that_the_tables_name_are_there():
    tests = "".join(path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("*.py"))
    places = (cam, cam.Frustum, pm, pm.Camera, pm.ThinLens)
    rows = [line for line in PAGE.partition("## *Camera")[2].splitlines() if line[:2] == "| "]
    assert len(rows) > 50
    missing = []
    for row in rows:
        for code in re.findall(r"`([^`]+)`", row.rstrip(" |").rpartition(" | ")[2]):
            words = re.match(r"[\w.]+", code)[0].removeprefix("pm.").split(".")
            known = any(hasattr(place, words[-1]) for place in places)
            if not known and f"def {words[-1]}(" not in tests and words[0] not in NO_FUNCTIONS:
                missing.append(code)
    assert missing == []


def test_every_function_of_the_package_is_on_the_page_or_explains_itself():
    helpers = {"homogeneous", "multiply", "transform_directions", "horizontal_fov"}
    functions = {name for name in cam.__all__ if name[0].islower()} - helpers
    assert {name for name in functions if name not in PAGE} == set()
