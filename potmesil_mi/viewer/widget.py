"""``pm.interactive``: the viewer as a widget of notebooks."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ..filters.base import FilterFunction
from ..focusing.methods import Method, MethodName
from ..samples.point_samples import PointSamples
from ..stacks.foci import Lens
from .extra import STATIC, require_extra
from .opening import view_of
from .view import Viewer

if TYPE_CHECKING:
    import anywidget
    import mitsuba as mi

    from ..tracing.sampling import Sampling


def interactive(
    source: PointSamples | mi.Scene,
    lens: Lens | None = None,
    *,
    method: Method | MethodName = "layered",
    filters: Sequence[FilterFunction | str] = (),
    sensor: int | mi.Sensor = 0,
    spp: int = 0,
    seed: int = 0,
    sampling: Sampling | None = None,
) -> anywidget.AnyWidget:
    """A widget for notebooks: the picture, which a click focuses on what is there.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``source``                    point samples; or a scene, which is sampled first, and whose
                                  ``thinlens`` the picture can be compared with then
    ``lens``                      the lens to begin with; by default that of the samples or of
                                  the scene's sensor, which must be open
    ``method``                    the method to begin with, as for :func:`potmesil_mi.focus`
    ``filters``                   special effects, as for :func:`potmesil_mi.focus`
    ``sensor``, ``spp``,          of a scene, as for :func:`potmesil_mi.render_samples`
    ``seed``, ``sampling``
    ============================  ==========================================================

    It has sliders for the focus, in equal steps of the circle of confusion, for the aperture, which
    ends where the samples serve no wider one, its shape, method, exposure, maps in the place of the
    picture, and a loupe. While one drags the picture is smaller. Its attribute ``lens`` is the lens
    that is shown, for :func:`potmesil_mi.focus`.

    In Jupyter, JupyterLab, VS Code, Colab and marimo. Raises ``ImportError`` without the extra
    ``interactive``, and ``ValueError`` or ``TypeError`` that names the parameter.
    """
    require_extra("anywidget")
    of_scene = {"sensor": sensor, "spp": spp, "seed": seed, "sampling": sampling}
    return _widget_class()(view_of(source, lens, method, filters, of_scene))


@functools.cache
def _widget_class() -> Any:
    """The widget's class, which is made when its library is needed."""
    import anywidget
    import traitlets

    class ViewerWidget(anywidget.AnyWidget):
        """Answers what its pages ask. Each asks again when it has the answer to the last."""

        _esm = STATIC / "viewer.js"
        _css = STATIC / "viewer.css"
        about = traitlets.Dict().tag(sync=True)

        def __init__(self, view: Viewer) -> None:
            super().__init__(about=view.about)
            self._view = view
            self.on_msg(self._asked)

        @property
        def lens(self) -> Lens:
            """The lens whose picture is shown."""
            return self._view.lens

        def _asked(self, _: Any, message: Any, __: Any) -> None:
            answer = self._view.answer(message)
            self.send(answer.message, [answer.picture] if answer.picture else None)

    return ViewerWidget
