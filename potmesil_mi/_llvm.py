"""Gives Dr.Jit an LLVM that works, and says what to install where there is none.

Dr.Jit loads the LLVM library once, when it is imported. The x86 back end of LLVM 16 and older
cannot compile Dr.Jit's kernels: it ends the process with SIGABRT, at the first kernel and not
before. So the newest library is offered before Dr.Jit is imported, and the version that was
loaded is looked at before anything is compiled.

Run as a script, this file exits with 0 if a usable LLVM is installed, and else says what to do.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import site
import sys
from collections.abc import Iterable
from pathlib import Path

MINIMUM_LLVM = 17
"""The oldest major version whose x86 back end compiles Dr.Jit's kernels."""

TESTED_LLVM = 19
"""The version the install commands name."""

LIBLLVM = re.compile(
    r"libLLVM(?:[-.](?P<name>\d+)[\d.]*)?\.(?:so|dylib)(?:\.(?P<suffix>\d+)[\d.]*)?|LLVM-C\.dll"
)
LLVM_FOLDER = re.compile(r"llvm[-@/]?(\d+)", re.IGNORECASE)


class LLVMError(ImportError):
    """No LLVM that Dr.Jit can use; the message says what was found and how to install one."""


# ---------------------------------------------------------------- finding libraries


def version_of(library: Path) -> int | None:
    """LLVM's major version by the names of the file, its symlink target and their folders."""
    for path in (library, library.resolve()):
        match = LIBLLVM.fullmatch(path.name)
        number = int((match and (match["name"] or match["suffix"])) or 0)
        if number > 1:  # libLLVM.so.1 counts interfaces, not versions
            return number
    for path in (library, library.resolve()):
        if folders := LLVM_FOLDER.findall(path.parent.as_posix()):
            return int(folders[-1])
    return None


def library_folders() -> list[Path]:
    """Where LLVM may be installed: with this Python (pip, conda), in the system, by Homebrew."""
    prefixes = dict.fromkeys([sys.prefix, sys.base_prefix])
    if site.ENABLE_USER_SITE:  # pip install --user
        prefixes[site.getuserbase()] = None
    folders = [Path(prefix, sub) for prefix in prefixes for sub in ("lib", "Library/bin")]
    if sys.platform == "win32":
        return [*folders, Path(os.environ.get("PROGRAMFILES", "C:/Program Files"), "LLVM", "bin")]
    # As the loader: the user's own path first, then the system's folders.
    folders += [Path(p) for p in os.environ.get("LD_LIBRARY_PATH", "").split(":") if p]
    folders += [Path(f"/usr/lib/{platform.machine()}-linux-gnu")]
    folders += [*Path("/usr/lib").glob("llvm*/lib"), *Path("/usr/lib64").glob("llvm*/lib")]
    folders += [Path("/usr/lib64"), Path("/usr/local/lib")]
    for homebrew in ("/opt/homebrew/opt", "/usr/local/opt"):
        folders += Path(homebrew).glob("llvm*/lib")
    return folders


def installed_llvms(folders: Iterable[Path]) -> list[tuple[int, Path]]:
    """(version, library) of the LLVMs in `folders`, newest first; version 0: its name is silent."""
    found = [
        (version_of(path) or 0, path)
        for folder in folders
        for pattern in ("libLLVM*.so*", "libLLVM*.dylib", "LLVM-C.dll")
        for path in sorted(folder.glob(pattern))
        if LIBLLVM.fullmatch(path.name) and path.is_file()
    ]
    return sorted(found, key=lambda llvm: -llvm[0])


def newest_usable_llvm() -> Path | None:
    """The newest library that is new enough; one whose name is silent only for want of others."""
    installed = installed_llvms(library_folders())
    if conda := os.environ.get("CONDA_PREFIX"):
        # Last: another Python's library may need a newer libstdc++ than this process has loaded.
        installed += installed_llvms([Path(conda, "lib"), Path(conda, "Library", "bin")])
    usable = [path for version, path in installed if version >= MINIMUM_LLVM]
    return next(iter(usable + [path for version, path in installed if version == 0]), None)


def use_newest_llvm() -> None:
    """Point Dr.Jit at the newest usable LLVM, unless the user chose one or it is already loaded."""
    if os.environ.get("DRJIT_LIBLLVM_PATH") or "drjit" in sys.modules:
        return
    if path := newest_usable_llvm():
        os.environ["DRJIT_LIBLLVM_PATH"] = str(path)


# ---------------------------------------------------------------- checking the loaded one


def loaded_llvm() -> int:
    """Major version of the LLVM that Dr.Jit has loaded; -1 if it has none."""
    import drjit as dr

    # Dr.Jit still loads its libraries in a thread of its own, which needs Python's lock to warn of
    # one. Asking for the version waits for it and keeps that lock, for ever; this lets it go.
    dr.sync_thread()
    return int(dr.detail.llvm_version()[0])


def require_usable(variant: str | None = None) -> None:
    """Raise `LLVMError` where no variant could work, or `variant`, Mitsuba's, if one is set.

    A usable CUDA device, or a scalar or CUDA variant set beforehand, need no LLVM; `check_llvm`
    then watches over a later change of the variant. Mitsuba is not imported for it.
    """
    use_newest_llvm()
    import drjit as dr

    if loaded_llvm() >= MINIMUM_LLVM:
        return
    if variant is None and dr.has_backend(dr.JitBackend.CUDA):
        return
    if variant is None or variant.startswith("llvm"):
        raise LLVMError(describe_problem())


def check_llvm(variant: str, previous: str | None = None) -> None:
    """Called when the variant has changed from `previous`: raises `LLVMError` if it cannot work.

    Puts the previous variant back first: Mitsuba would take a second `set_variant` for done.
    """
    if not variant.startswith("llvm") or loaded_llvm() >= MINIMUM_LLVM:
        return
    import mitsuba as mi

    mi.set_variant(previous if previous and not previous.startswith("llvm") else "scalar_rgb")
    raise LLVMError(describe_problem())


# ---------------------------------------------------------------- saying what is wrong


def describe_problem() -> str:
    """What to do, in the first line; then what was found and what is needed."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH")
    loaded = loaded_llvm()
    installed = installed_llvms(library_folders())
    usable = newest_usable_llvm()
    if loaded > 0:
        found = f"Dr.Jit has loaded LLVM {loaded}"
        found += f" from DRJIT_LIBLLVM_PATH={chosen}" if chosen else ""
    elif chosen:
        version = version_of(Path(chosen))
        found = f"Dr.Jit cannot load DRJIT_LIBLLVM_PATH={chosen}"
        found += f" (LLVM {version} by its name)" if version else ""
        found += "" if Path(chosen).exists() else ": there is no such file"
    elif usable:
        found = "Dr.Jit has found none by itself"
    elif installed:
        found = f"the newest one found is LLVM {installed[0][0]} ({installed[0][1]})"
    else:
        found = "none was found"
    if usable and str(usable) != chosen:
        remedy = "Unset DRJIT_LIBLLVM_PATH" if chosen else "Import potmesil_mi before mitsuba"
        remedy += f", in a new process: it then takes {usable}."
    else:
        remedy = f"Install an LLVM:  {install_command()}"
    lines = [remedy, f"Mitsuba's llvm_* variants need LLVM {MINIMUM_LLVM} or newer, but {found}."]
    if "apt-get" in remedy:
        lines.append(
            "(Before Debian 12 and Ubuntu 24.04, add the packages of https://apt.llvm.org.)"
        )
    lines.append("The scalar_* and cuda_* variants need no LLVM: set one, then import potmesil_mi.")
    return "\n".join(lines)


def install_command() -> str:
    """The command that installs a usable LLVM on this machine; without root where it can."""
    windows = sys.platform == "win32"
    if any(Path(prefix, "conda-meta").is_dir() for prefix in (sys.prefix, sys.base_prefix)):
        return f"conda install -c conda-forge libllvm{'-c' if windows else ''}{TESTED_LLVM}"
    if windows:
        return "the LLVM installer from https://github.com/llvm/llvm-project/releases"
    if sys.platform == "darwin":
        return "brew install llvm"
    if platform.machine() == "x86_64":
        return "pip install 'potmesil_mi[llvm]'"
    sudo = "sudo " if os.geteuid() else ""
    if shutil.which("dnf") and not shutil.which("apt-get"):
        return f"{sudo}dnf install llvm-libs"
    return f"{sudo}apt-get install libllvm{TESTED_LLVM}"


if __name__ == "__main__":
    use_newest_llvm()
    sys.exit(None if loaded_llvm() >= MINIMUM_LLVM else describe_problem())
