"""Does something when a module of another package is imported, and does not import it itself."""

from __future__ import annotations

import sys
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
    both are called again at the next attempt, and no more after one that succeeds.
    """
    if name in sys.modules:
        before()
        after()
    else:
        sys.meta_path.insert(0, _Finder(name, before, after))


class _Finder:
    """Finds one module as the other finders do, with a loader that calls two functions."""

    def __init__(self, name: str, before: Callable[[], None], after: Callable[[], None]) -> None:
        self.name, self.before, self.after = name, before, after

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification by the other finders; ``None`` for all other modules."""
        if name != self.name:
            return None
        for finder in sys.meta_path:
            if finder is not self and (spec := finder.find_spec(name, path, target)):
                if spec.loader is not None:
                    spec.loader = _Loader(spec.loader, self)  # type: ignore[assignment]
                return spec
        return None


class _Loader:
    """Stands before a module's own loader and steps aside when the module is executed."""

    def __init__(self, loader: Any, finder: _Finder) -> None:
        self.loader, self.finder = loader, finder

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
        sys.meta_path.remove(self.finder)
