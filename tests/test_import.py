"""`import potmesil_mi` is light, and Mitsuba finds the plugins in whatever order things come."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import potmesil_mi as pm

REPOSITORY = Path(__file__).parents[1]
STUB = ast.parse(Path(pm.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))


def run(code, *arguments):
    """What a new Python prints; warnings are errors."""
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


# ---------------------------------------------------------------- public names


def test_the_stub_lists_what_it_imports_and_nothing_else():
    imported = [
        alias.name for node in STUB.body if isinstance(node, ast.ImportFrom) for alias in node.names
    ]
    (listed,) = (ast.literal_eval(node.value) for node in STUB.body if isinstance(node, ast.Assign))
    assert sorted(imported) == listed
    assert sorted(pm.__all__) == listed


def test_every_public_name_is_there_and_documented():
    assert set(pm.__all__) <= set(dir(pm))
    for name in pm.__all__:
        assert getattr(pm, name).__doc__, name


def test_a_star_import_brings_the_public_names():
    names = {}
    exec("from potmesil_mi import *", names)
    assert names.keys() - {"__builtins__"} == set(pm.__all__)


def test_a_name_that_is_not_there_is_an_error_that_names_it():
    with pytest.raises(AttributeError, match="focuss"):
        _ = pm.focuss
    with pytest.raises(ImportError, match="focuss"):
        from potmesil_mi import focuss  # noqa: F401


def test_the_package_tells_type_checkers_that_it_is_typed():
    assert (Path(pm.__file__).parent / "py.typed").is_file()


# ---------------------------------------------------------------- light

LIBRARIES = ("mitsuba", "drjit", "scipy", "numpy", "OpenEXR", "numcodecs", "rich")
OF_EXTRAS = ("anywidget", "aiohttp", "torch")
HEAVY = str((*LIBRARIES, *OF_EXTRAS))
LOADED = f"import sys; print([m for m in {HEAVY} if m in sys.modules])"


def test_importing_the_package_imports_nothing_heavy():
    assert run("import potmesil_mi;" + LOADED) == "[]\n"


@pytest.mark.parametrize("arguments", [["--help"], ["--version"]])
def test_help_and_version_import_nothing_heavy(arguments):
    code = f"""
import sys
from potmesil_mi.cli import main
try:
    main({arguments})
except SystemExit:
    pass
{LOADED}"""
    assert run(code).endswith("\n[]\n")


def test_the_options_of_focus_are_known_without_drjit_and_scipy():
    code = f"""
from potmesil_mi.cli import main
try:
    main(["focus", "--help"])
except SystemExit:
    pass
{LOADED}"""
    assert run(code).endswith("\n['numpy']\n")


def test_dof_needs_no_mitsuba_and_no_scipy():
    code = "from potmesil_mi.cli import main; main(['dof']);" + LOADED
    assert run(code).endswith("['numpy', 'rich']\n")


def test_setting_a_variant_does_not_wait_for_scipy():
    code = "import potmesil_mi, mitsuba as mi; mi.set_variant('scalar_rgb');"
    assert "scipy" not in run(code + LOADED)


@pytest.mark.parametrize(
    ("ending", "needed", "other"),
    [(".exr", "OpenEXR", "numcodecs"), (".samples", "numcodecs", "OpenEXR")],
)
def test_a_file_of_samples_needs_no_library_of_the_other_format(tmp_path, ending, needed, other):
    code = f"""
import sys; sys.path.insert(0, "tests")
from scenes import synthetic
synthetic(5).save(sys.argv[1])
assert "{needed}" in sys.modules
assert "{other}" not in sys.modules"""
    run(code, str(tmp_path / f"a{ending}"))


def test_a_focus_waits_for_no_optimizer():
    """A tenth of a second of every ``potmesil focus``."""
    code = "import sys, potmesil_mi.focusing.api; print('scipy.optimize' in sys.modules)"
    assert run(code) == "False\n"


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["dof"]])
def test_what_computes_no_picture_needs_no_llvm(arguments, tmp_path):
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": str(tmp_path / "absent")}
    result = subprocess.run(
        [sys.executable, "-m", "potmesil_mi", *arguments],
        cwd=REPOSITORY,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (result.returncode, result.stderr) == (0, "")


# ---------------------------------------------------------------- plugins

USE = """
print(mi.load_dict({"type": "potmesil", "f_number": 5.6}).lens().f_number)
"""
ORDERS = {
    "package, mitsuba, variant": """
import potmesil_mi, mitsuba as mi
assert mi.variant() is None
mi.set_variant("scalar_rgb")""",
    "mitsuba, package, variant": """
import mitsuba as mi, potmesil_mi
mi.set_variant("scalar_rgb")""",
    "mitsuba, variant, package": """
import mitsuba as mi
mi.set_variant("scalar_rgb")
import potmesil_mi""",
    "a wing, mitsuba, variant": """
import potmesil_mi.plugins, potmesil_mi.tracing.sampling, mitsuba as mi
mi.set_variant("scalar_rgb")""",
    "twice": """
import potmesil_mi, mitsuba as mi, importlib
importlib.reload(potmesil_mi)
mi.set_variant("scalar_rgb")""",
}


@pytest.mark.parametrize("code", ORDERS.values(), ids=ORDERS)
def test_the_plugins_are_there_in_every_order_of_imports(code):
    assert run(code + USE) == "5.6\n"
