"""An unusable LLVM must end in a Python exception that says what to install, never in an abort."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from potmesil_mi import _llvm as llvm

REPOSITORY = Path(__file__).parents[1]


def run(*arguments, library):
    """Run Python in a process of its own, with `library` as LLVM and without CUDA."""
    environment = os.environ | {
        "DRJIT_LIBLLVM_PATH": str(library),
        "DRJIT_LIBCUDA_PATH": str(REPOSITORY / "no-such-libcuda.so"),
    }
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=REPOSITORY,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )


REMEDIES = "Install an LLVM:  |Unset DRJIT_LIBLLVM_PATH, in a new process: "
"""How a message begins: it says what to do before it says why."""


def assert_llvm_error(result, found):
    assert result.returncode == 1, f"{result.returncode}: {result.stderr}"  # negative: a signal
    assert re.search(rf"LLVMError: ({REMEDIES})", result.stderr), result.stderr
    for said in (found, f"LLVM {llvm.MINIMUM_LLVM} or newer"):
        assert said in result.stderr


def fake_library(folder, name="libLLVM-15.so.1"):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.touch()
    return path


@pytest.fixture
def old_library():
    """A real LLVM that Dr.Jit loads and that would end the process at the first kernel."""
    for version, path in llvm.installed_llvms(llvm.library_folders()):
        if 15 <= version < llvm.MINIMUM_LLVM:
            return version, path
    pytest.skip("no LLVM 15 or 16 is installed here")


# ---------------------------------------------------------------- the package in a new process

WAYS_IN = {
    "import": ["-c", "import potmesil_mi, mitsuba"],
    "mitsuba_first": ["-c", "import mitsuba, potmesil_mi"],
    "then_set_variant": [
        "-c",
        "import potmesil_mi, mitsuba as mi; mi.set_variant('llvm_ad_rgb')",
    ],
    "public_name": ["-c", "from potmesil_mi import render_samples"],
    "without_mitsuba": ["-c", "from potmesil_mi import _backend; _backend.Float"],
}


@pytest.mark.parametrize("arguments", WAYS_IN.values(), ids=WAYS_IN)
def test_an_absent_library_raises_and_is_named(arguments, tmp_path):
    absent = tmp_path / "libLLVM.so"
    assert_llvm_error(run(*arguments, library=absent), f"{absent}: there is no such file")


@pytest.mark.parametrize(
    "command", [["render", "scene.xml"], ["compare", "scene.xml"]], ids=" ".join
)
def test_a_command_that_renders_ends_in_one_line_that_says_what_to_install(command, tmp_path):
    output = ["-o", str(tmp_path / "a.png")]
    result = run("-m", "potmesil_mi", *command, *output, library=tmp_path / "absent")
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert re.search(rf"potmesil: error: ({REMEDIES})", result.stderr)
    assert f"LLVM {llvm.MINIMUM_LLVM} or newer" in result.stderr


def test_the_error_comes_again_at_the_next_attempt_and_leaves_no_half_of_mitsuba(tmp_path):
    code = """
import sys, potmesil_mi
for _ in range(2):
    try:
        import mitsuba
    except potmesil_mi._llvm.LLVMError:
        print("LLVMError", "mitsuba" in sys.modules)
"""
    result = run("-c", code, library=tmp_path / "absent")
    assert result.stdout == 2 * "LLVMError False\n", result.stderr


@pytest.mark.parametrize("arguments", WAYS_IN.values(), ids=WAYS_IN)
def test_a_file_named_as_an_old_llvm_raises_with_its_version(arguments, tmp_path):
    assert_llvm_error(run(*arguments, library=fake_library(tmp_path)), "LLVM 15")


SET_FIRST = ["-c", "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); import potmesil_mi"]


@pytest.mark.parametrize(
    "arguments", [*WAYS_IN.values(), SET_FIRST], ids=[*WAYS_IN, "after_set_variant"]
)
def test_an_old_llvm_raises_before_it_can_abort(arguments, old_library):
    version, path = old_library
    assert_llvm_error(run(*arguments, library=path), f"Dr.Jit has loaded LLVM {version}")


SCALAR_FIRST = """
import mitsuba as mi
mi.set_variant("scalar_rgb")
import potmesil_mi
print("imported")
"""

TRY_LLVM_TWICE = """
from potmesil_mi import _llvm as llvm
for _ in range(2):
    try:
        mi.set_variant("llvm_ad_rgb")
    except llvm.LLVMError:
        print("LLVMError", mi.variant())
mi.set_variant("llvm_ad_rgb")
"""


def test_scalar_variants_need_no_llvm(tmp_path):
    result = run("-c", SCALAR_FIRST, library=tmp_path / "absent")
    assert (result.returncode, result.stdout) == (0, "imported\n"), result.stderr


def test_a_cuda_device_needs_no_llvm(tmp_path):
    code = "import drjit; drjit.has_backend = lambda backend: True; import potmesil_mi, mitsuba"
    result = run("-c", code, library=tmp_path / "absent")
    assert result.returncode == 0, result.stderr


def test_llvm_variants_without_any_llvm_end_in_an_import_error(tmp_path):
    code = SCALAR_FIRST + "mi.set_variant('llvm_ad_rgb')"
    result = run("-c", code, library=tmp_path / "absent")
    assert result.returncode == 1
    assert "ImportError: " in result.stderr
    assert "DRJIT_LIBLLVM_PATH" in result.stderr


def test_a_later_change_to_an_old_llvm_raises_each_time_and_keeps_the_variant(old_library):
    version, path = old_library
    result = run("-c", SCALAR_FIRST + TRY_LLVM_TWICE, library=path)
    assert result.stdout == "imported\n" + 2 * "LLVMError scalar_rgb\n", result.stderr
    assert_llvm_error(result, f"LLVM {version}")


def test_every_change_of_the_variant_is_checked():
    """As above where no old LLVM is installed: the one in use says that it is version 15."""
    pretend = "from potmesil_mi import _llvm as llvm\nllvm.loaded_llvm = lambda: 15\n"
    code = SCALAR_FIRST + pretend + TRY_LLVM_TWICE
    result = run("-c", code, library=os.environ.get("DRJIT_LIBLLVM_PATH", ""))
    assert result.stdout == "imported\n" + 2 * "LLVMError scalar_rgb\n", result.stderr
    assert_llvm_error(result, "LLVM 15")


def test_mitsuba_before_the_package_is_told_to_come_after_it(old_library):
    """Dr.Jit took the old library by itself, and a newer one is installed."""
    _, path = old_library
    code = """
import mitsuba, os
del os.environ["DRJIT_LIBLLVM_PATH"]
import potmesil_mi"""
    result = run("-c", code, library=path)
    assert result.returncode == 1
    expected = "Import potmesil_mi before mitsuba" if llvm.newest_usable_llvm() else "Install"
    assert f"LLVMError: {expected}" in result.stderr


# ---------------------------------------------------------------- finding libraries


@pytest.mark.parametrize("enabled", [True, False])
def test_what_pip_installed_for_the_user_is_looked_for(enabled, monkeypatch, tmp_path):
    monkeypatch.setattr(llvm.site, "ENABLE_USER_SITE", enabled)
    monkeypatch.setattr(llvm.site, "getuserbase", lambda: str(tmp_path))
    assert (tmp_path / "lib" in llvm.library_folders()) is enabled


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("usr/lib/x86_64-linux-gnu/libLLVM-15.so.1", 15),
        ("usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14),
        ("usr/lib/x86_64-linux-gnu/libLLVM-19.so", 19),
        ("usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", 19),
        ("usr/lib64/libLLVM.so.20.1-rc1", None),
        ("usr/lib/llvm-18/lib/libLLVM.so.1", 18),
        ("usr/lib/llvm-18/lib/libLLVM.so", 18),
        ("usr/lib64/llvm17/lib/libLLVM.so", 17),
        ("conda/lib/libLLVM.19.1.dylib", 19),
        ("conda/lib/libLLVM-19.dylib", 19),
        ("opt/homebrew/opt/llvm@18/lib/libLLVM.dylib", 18),
        ("opt/homebrew/Cellar/llvm/21.1.8/lib/libLLVM.dylib", 21),
        ("somewhere/llvm/lib/libLLVM.dylib", None),
        ("Program Files/LLVM/bin/LLVM-C.dll", None),
        ("somewhere/library.so", None),
    ],
)
def test_version_is_read_from_the_names(path, version):
    assert llvm.version_of(Path("/", path)) == version


def test_version_is_read_from_what_a_link_points_to(tmp_path):
    (tmp_path / "libLLVM.so").symlink_to(fake_library(tmp_path, "libLLVM.so.19.1"))
    (tmp_path / "opt").mkdir()
    (tmp_path / "opt/llvm").symlink_to(tmp_path / "Cellar/llvm/21.1.8")
    fake_library(tmp_path / "Cellar/llvm/21.1.8/lib", "libLLVM.dylib")
    assert llvm.version_of(tmp_path / "libLLVM.so") == 19
    assert llvm.version_of(tmp_path / "opt/llvm/lib/libLLVM.dylib") == 21


@pytest.fixture
def offered(monkeypatch, tmp_path):
    """A process in which Dr.Jit is not loaded yet and `tmp_path / "lib"` is searched."""
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "")
    monkeypatch.delenv("CONDA_PREFIX", raising=False)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    monkeypatch.setattr(llvm, "library_folders", lambda: [tmp_path / "lib"])

    def offer():
        llvm.use_newest_llvm()
        return os.environ["DRJIT_LIBLLVM_PATH"]

    return offer


def test_the_newest_usable_llvm_is_taken(offered, tmp_path):
    for name in ("libLLVM-15.so.1", "libLLVM.so.9.0", "libLLVM.so.19.1", "libLLVM-17.so"):
        fake_library(tmp_path / "lib", name)
    newest = fake_library(tmp_path / "lib", "libLLVM.so.22.1")
    assert offered() == str(newest)


def test_files_that_are_not_the_whole_llvm_are_not_taken(offered, tmp_path):
    for name in ("libLLVMCore.so.20", "libLLVM-21-rust-1.91.0.so", "libLLVM-21.so.txt"):
        fake_library(tmp_path / "lib", name)
    (tmp_path / "lib/libLLVM-23.so").symlink_to("removed")
    assert offered() == ""


def test_an_old_llvm_is_not_taken(offered, tmp_path):
    fake_library(tmp_path / "lib", "libLLVM-16.so.1")
    assert offered() == ""


def test_a_library_that_hides_its_version_is_taken_for_want_of_others(offered, tmp_path):
    silent = fake_library(tmp_path / "lib", "LLVM-C.dll")
    assert offered() == str(silent)
    os.environ["DRJIT_LIBLLVM_PATH"] = ""
    known = fake_library(tmp_path / "lib", "libLLVM-17.so")
    assert offered() == str(known)


def test_an_active_conda_environment_comes_after_the_pythons_own_llvm(
    offered, monkeypatch, tmp_path
):
    monkeypatch.setenv("CONDA_PREFIX", str(tmp_path / "conda"))
    conda = fake_library(tmp_path / "conda/lib", "libLLVM.so.22.1")
    assert offered() == str(conda)
    os.environ["DRJIT_LIBLLVM_PATH"] = ""
    own = fake_library(tmp_path / "lib", "libLLVM.so.19.1")
    assert offered() == str(own)


def test_a_library_the_user_chose_is_kept(offered, monkeypatch, tmp_path):
    fake_library(tmp_path / "lib", "libLLVM.so.22.1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/chosen/libLLVM.so")
    assert offered() == "/chosen/libLLVM.so"


def test_nothing_is_changed_once_dr_jit_is_loaded(offered, monkeypatch, tmp_path):
    fake_library(tmp_path / "lib", "libLLVM.so.22.1")
    monkeypatch.setitem(sys.modules, "drjit", sys)
    assert offered() == ""


# ---------------------------------------------------------------- what the message says


@pytest.mark.skipif(sys.platform != "linux", reason="names Debian's command")
@pytest.mark.parametrize(("user", "sudo"), [(0, ""), (1000, "sudo ")])
def test_debians_command_uses_sudo_only_when_needed(user, sudo, monkeypatch, tmp_path):
    monkeypatch.setattr(llvm.platform, "machine", lambda: "aarch64")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "base_prefix", str(tmp_path))
    monkeypatch.setattr(llvm.shutil, "which", lambda name: f"/usr/bin/{name}")
    monkeypatch.setattr(os, "geteuid", lambda: user)
    assert llvm.install_command() == f"{sudo}apt-get install libllvm19"


@pytest.mark.skipif(sys.platform != "linux", reason="names Linux's package")
def test_a_conda_python_is_told_condas_command(monkeypatch, tmp_path):
    (tmp_path / "conda-meta").mkdir()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert llvm.install_command() == "conda install -c conda-forge libllvm19"


@pytest.mark.skipif(sys.platform != "linux", reason="names Linux's package")
def test_where_pip_has_an_llvm_no_root_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "base_prefix", str(tmp_path))
    monkeypatch.setattr(llvm.platform, "machine", lambda: "x86_64")
    assert llvm.install_command() == "pip install 'potmesil_mi[llvm]'"


def first_line():
    return llvm.describe_problem().splitlines()[0]


@pytest.mark.parametrize("loaded", [15, -1])
def test_the_first_line_tells_what_to_do(loaded, offered, monkeypatch, tmp_path):
    monkeypatch.setattr(llvm, "loaded_llvm", lambda: loaded)
    assert first_line() == f"Install an LLVM:  {llvm.install_command()}"
    usable = fake_library(tmp_path / "lib", "libLLVM.so.19.1")
    assert first_line().startswith("Import potmesil_mi before mitsuba, in a new process")
    assert str(usable) in first_line()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/chosen/libLLVM-15.so")
    assert first_line().startswith("Unset DRJIT_LIBLLVM_PATH, in a new process")


def test_the_docs_have_what_mitsuba_says_before_this_package_is_imported(tmp_path):
    """So that whoever searches for it finds what to do."""
    code = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb')"
    said = run("-c", code, library=tmp_path / "absent.so").stderr.splitlines()[-1]
    page = (REPOSITORY / "docs" / "install.md").read_text(encoding="utf-8")
    assert said.startswith("ImportError: ")
    assert f"`{said}`" in page
