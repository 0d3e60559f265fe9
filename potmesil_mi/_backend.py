"""Dr.Jit's array types of the backend in use, without Mitsuba.

``from .. import _backend as jit`` and then ``jit.Float``, ``jit.UInt32``, ``jit.Array4f``: the
types of Mitsuba's variant where one is set, and else those of the first backend that works.
They are asked for at each use, since a user may change the variant at any time.
"""

from __future__ import annotations

import _thread
import contextlib
import contextvars
import functools
import importlib
import sys
import threading
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from . import _llvm
from ._threads import HostThread

T = TypeVar("T")

if TYPE_CHECKING:
    from drjit.llvm.ad import (
        Array2f,
        Array3f,
        Array4f,
        Bool,
        Float,
        Int32,
        TensorXf,
        UInt8,
        UInt32,
    )

__all__ = [
    "Array2f",
    "Array3f",
    "Array4f",
    "Bool",
    "Float",
    "Int32",
    "TensorXf",
    "UInt8",
    "UInt32",
    "alone",
    "evaluates_alone",
    "from_numpy",
    "name",
    "require_vectorised_variant",
]


def __getattr__(attribute: str) -> Any:
    if attribute not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {attribute!r}")
    return getattr(_arrays(variant()), attribute)


def from_numpy(kind: Callable[..., T], column: np.ndarray) -> T:
    """``column``, (N,) of any number type, as a Dr.Jit array of type ``kind``, in its own memory.

    Dr.Jit would use NumPy's memory, and compile each kernel for how that happens to be aligned:
    seconds, again and again, for the same work.
    """
    import drjit as dr

    if dr.backend_v(kind) != dr.JitBackend.LLVM or len(column) == 0:
        return kind(column.astype(np.asarray(dr.zeros(kind, 1)).dtype))
    result = dr.empty(kind, len(column))
    np.asarray(result)[:] = column
    return result


IDLE_LIBRARIES = ("ipykernel", "IPython", "rich", "tqdm")
"""Libraries whose threads evaluate no arrays; a notebook has several of them."""

USERS_THREADS = "ipykernel.subshell"
"""The module among them whose threads do: they run what the user types."""


_alone = contextvars.ContextVar("potmesil_mi_alone", default=False)


@contextlib.contextmanager
def alone() -> Iterator[None]:
    """Within the block no thread but this one evaluates arrays, as the caller knows."""
    token = _alone.set(True)
    try:
        yield
    finally:
        _alone.reset(token)


def evaluates_alone() -> bool:
    """Whether no other Python thread may be evaluating arrays now.

    Frames of the threads would tell more, but to ask for them while arrays are freed may wait
    for ever.
    """
    if _alone.get():
        return True
    known = threading.enumerate()
    unknown = _thread._count() + 1 - len(known)
    own = threading.current_thread()
    return unknown <= 0 and all(_is_idle(thread) for thread in known if thread is not own)


def _is_idle(thread: threading.Thread) -> bool:
    """Whether a thread is one that evaluates nothing, our own or that of a library."""
    if isinstance(thread, HostThread):
        return True
    runs = getattr(thread, "_target", None)
    modules = type(thread).__module__, getattr(runs, "__module__", None) or ""
    return USERS_THREADS not in modules and any(
        module.split(".")[0] in IDLE_LIBRARIES for module in modules
    )


def variant() -> str | None:
    """Mitsuba's variant; ``None`` where none is set, or Mitsuba has not been imported."""
    mitsuba = sys.modules.get("mitsuba")
    return None if mitsuba is None else mitsuba.variant()


def name() -> str:
    """The module of Dr.Jit whose types are in use, such as ``drjit.llvm.ad``.

    Raises ``RuntimeError`` while a scalar variant is set, ``LLVMError`` where no variant is set
    and there is neither a GPU nor an LLVM that can be used.
    """
    return _arrays(variant()).__name__


def require_vectorised_variant(what: str) -> None:
    """Raise ``RuntimeError`` that names ``what`` unless an LLVM or CUDA variant is set."""
    set_ = variant()
    if set_ is None or set_.startswith("scalar"):
        raise RuntimeError(
            f"{what}: needs a vectorised variant, but mi.variant() is {set_}; call "
            "mi.set_variant('cuda_ad_rgb', 'llvm_ad_rgb') before the scene is loaded"
        )


@functools.cache
def _arrays(set_: str | None) -> ModuleType:
    """The module of Dr.Jit whose types go with a variant, or with none."""
    if set_ is None:
        _llvm.require_usable()
        import drjit as dr

        backend = "cuda" if dr.has_backend(dr.JitBackend.CUDA) else "llvm"
        return importlib.import_module(f"drjit.{backend}.ad")
    if set_.startswith("scalar"):
        require_vectorised_variant("potmesil_mi")
    backend = set_.split("_", 1)[0]
    return importlib.import_module(f"drjit.{backend}" + (".ad" if "_ad_" in set_ else ""))
