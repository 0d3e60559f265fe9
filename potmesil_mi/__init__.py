"""potmesil_mi: Potmesil & Chakravarty's lens and aperture camera (SIGGRAPH 1981) for Mitsuba 3.

Render a scene once with a pinhole, keep point samples with depth and surface identity, then
form the picture through a lens as often as you like::

    import potmesil_mi as pm, mitsuba as mi        # in this order, before mi.set_variant or after
    samples = pm.render_samples(scene, spp=16)     # once
    image = pm.focus(samples, samples.lens.replace(focus_distance=550, f_number=11))

Importing it offers Dr.Jit an LLVM that works, and registers the plugins ``potmesil`` (sensor),
``point_samples`` and ``focus`` (integrators) for the variant that is set, and again whenever
another is set. Mitsuba itself is not imported: what is to be done follows when it is. Public
names, which ``__init__.pyi`` lists with the modules that define them, are imported at first use.
"""

from __future__ import annotations

from typing import Any

import lazy_loader

from ._hook import watch_import

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from ._version import package_version

        return package_version()
    return _public(name)


def _choose_llvm() -> None:
    from . import _llvm

    _llvm.use_newest_llvm()


def _require_llvm() -> None:
    from . import _backend, _llvm

    _llvm.require_usable(_backend.variant())


def _register_plugins() -> None:
    from . import plugins

    plugins.follow_variants()


watch_import("drjit", before=_choose_llvm)
watch_import("mitsuba", before=_require_llvm, after=_register_plugins)
