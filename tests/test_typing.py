"""A misspelt option is found by mypy in a user's script, before it runs."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]

RIGHT = """
import potmesil_mi as pm
from potmesil_mi import FocusSession, ThinLens
from potmesil_mi.evaluation import compare


def picture(path: str) -> object:
    samples = pm.PointSamples.load(path)
    lens = samples.lens.replace(focus_distance=1.0, f_number=2.0)
    lens = lens.replace(film="focused", aperture=pm.Polygon(blades=5))
    session = FocusSession(samples, pm.Layered(lens_points=64))
    session.focus(lens, alpha=True, filters=["star:points=6", pm.Fade(amount=0.5)])
    return pm.focus(samples, lens, method="lightfield", squares=2)


LENS = ThinLens(50.0, 2.8, 2.0, millimeters_per_unit=1000.0, film="focal", aperture="disc")
SAMPLING = pm.Sampling(pattern="adaptive", threshold=0.1, overscan=4)


def report(text: str, share: float | None) -> None:
    print(text, share)


def job(scene: object) -> None:
    with pm.progress(report):
        samples = pm.render_samples(scene, spp=4, sampling=SAMPLING)
        print(compare(scene, method="paper", tables=20).summary(), len(samples))
"""
WRONG = {
    "lens.replace(focus_distnace=1)": "focus_distnace",
    'lens.replace(film="foccal")': "foccal|film",
    'pm.ThinLens(50.0, 2.0, film="foccal")': "film",
    "pm.ThinLens(50.0, f_numbr=2.0)": "f_numbr",
    'pm.Sampling(patern="adaptive")': "patern",
    'pm.Sampling(pattern="adaptiv")': "pattern",
    'pm.focus(samples, method="layred")': "method",
    "pm.focus(samples, squars=2)": "squars",
    "pm.focus(samples, rfilter=3)": "rfilter",
    'pm.FocusSession(samples, "layred")': "FocusSession",
    "pm.FocusSession(samples).focus(alhpa=True)": "alhpa",
    "pm.Layered(lens_point=64)": "lens_point",
    "pm.Equation20(table=64)": "table",
    "pm.Polygon(blade=6)": "blade",
    "pm.Star(point=6)": "point",
    "pm.render_samples(scene, sp=4)": "sp",
    "pm.potmesil_sensor(sensor, f_numbr=2)": "f_numbr",
    'pm.evaluation.compare(scene, method="papr")': "method",
    "pm.evaluation.compare(scene, tabels=3)": "tabels",
    "pm.progress(lambda text: None)": "progress",
    "pm.focuss(samples)": "focuss",
}
PREAMBLE = """
import potmesil_mi as pm
from potmesil_mi import evaluation


def script(samples: pm.PointSamples, lens: pm.ThinLens, scene: object, sensor: object) -> None:
"""


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """Errors that mypy finds in the two scripts: (name of the script, number of the line, text)."""
    folder = tmp_path_factory.mktemp("scripts")
    (folder / "right.py").write_text(RIGHT)
    (folder / "wrong.py").write_text(PREAMBLE + "".join(f"    {line}\n" for line in WRONG))
    result = subprocess.run(
        [
            *(sys.executable, "-m", "mypy", "--config-file", str(REPOSITORY / "pyproject.toml")),
            *("--follow-imports", "silent", "--no-error-summary", "--hide-error-context"),
            *(str(folder / "right.py"), str(folder / "wrong.py")),
        ],
        cwd=REPOSITORY,
        env=os.environ | {"MYPYPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
    )
    assert result.returncode in (0, 1), result.stdout + result.stderr
    found = re.findall(r"(\w+)\.py:(\d+): error: (.*)", result.stdout)
    return [(script, int(line), text) for script, line, text in found]


def test_a_right_script_has_no_errors(errors):
    assert [error for error in errors if error[0] == "right"] == []


@pytest.mark.parametrize(("line", "text"), WRONG.items(), ids=WRONG)
def test_a_misspelt_option_is_an_error(errors, line, text):
    number = PREAMBLE.count("\n") + 1 + [*WRONG].index(line)
    here = [error for script, at, error in errors if (script, at) == ("wrong", number)]
    assert here, "mypy finds nothing"
    assert any(re.search(text, error) for error in here), here
