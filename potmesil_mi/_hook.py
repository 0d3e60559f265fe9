"""Does something when a module of another package is imported, and does not import it itself."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any


def nothing() -> None:
    """Do nothing."""


def watch_import(
    name: str, *, before: Callable[[], None] = nothing, after: Callable[[], None] = nothing
) -> None:
    """Call ``before`` and ``after`` when the module ``name`` is imported, at once if it has been.

    ``before`` is called when the module has been found and is not in ``sys.modules`` yet,
    ``after`` when it has been executed. What either raises comes out of the import statement;
    both are called again at the next attempt, and no more after one that succeeds. What was to be
    called for that module until now is not: this package has been loaded anew.
    """
    if name in sys.modules:
        before()
        after()
    else:
        sys.meta_path[:] = [
            _Finder(name, before, after),
            *(finder for finder in sys.meta_path if not _watches(finder, name)),
        ]


def _watches(finder: Any, name: str) -> bool:
    """Whether it is a :class:`_Finder` for ``name``, of this module or of it before a reload."""
    kind = type(finder)
    place = kind.__module__, kind.__qualname__
    return place == (__name__, _Finder.__qualname__) and finder.name == name


class _Finder:
    """Finds one module as the other finders do, with a loader that calls two functions."""

    def __init__(self, name: str, before: Callable[[], None], after: Callable[[], None]) -> None:
        self.name, self.before, self.after = name, before, after
        self._now = threading.local()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification by the other finders; ``None`` for all other modules."""
        # Another finder may ask all finders as this one does, and so this one again.
        if name != self.name or getattr(self._now, "looking", False):
            return None
        self._now.looking = True
        try:
            spec = self._by_others(name, path, target)
        finally:
            self._now.looking = False
        if spec is not None and spec.loader is not None:
            spec.loader = _Loader(spec.loader, self)  # type: ignore[assignment]
        return spec

    def _by_others(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None
    ) -> ModuleSpec | None:
        for finder in list(sys.meta_path):
            # Finders of old kinds have no `find_spec`, and Python passes them over, too.
            find: Any = None if finder is self else getattr(finder, "find_spec", None)
            if find is not None and (spec := find(name, path, target)) is not None:
                return spec
        return None


class _Loader:
    """Stands before a module's own loader and steps aside when the module is executed.

    All else, such as ``get_data``, is the loader's own.
    """

    def __init__(self, loader: Any, finder: _Finder) -> None:
        self.loader, self.finder = loader, finder

    def __getattr__(self, name: str) -> Any:
        if name == "loader":  # not there yet, as in a copy that is being made
            raise AttributeError(name)
        return getattr(self.loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """The module, not executed."""
        self.finder.before()
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module as its own loader does."""
        module.__loader__ = self.loader
        if module.__spec__ is not None:
            module.__spec__.loader = self.loader
        self.loader.exec_module(module)
        self.finder.after()
        with contextlib.suppress(ValueError):  # somebody may have removed it
            sys.meta_path.remove(self.finder)
