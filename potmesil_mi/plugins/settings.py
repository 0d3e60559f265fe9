"""What a scene says of the focus stage, read without the plugins' classes.

These are made anew for each variant; what is here is the same for all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import mitsuba as mi

from .._files import require_path
from .._validation import shown

if TYPE_CHECKING:
    from ..filters.base import FilterFunction
    from ..focusing.methods import Method
    from ..motion.motion import Motion

METHOD_PARAMETERS = ("method", "lens_points", "tables", "inverse_square", "squares")
"""Parameters of the integrator ``focus`` that say how the picture is formed."""


@runtime_checkable
class FocusSettings(Protocol):
    """An integrator that says how a picture is focused, as ``focus`` does."""

    method: Method
    filters: tuple[FilterFunction, ...]
    denoise: bool
    focus_aovs: bool


def method_from(props: mi.Properties) -> Method:
    """The method that the parameters of an integrator describe.

    Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """
    from ..focusing.methods import method_of

    given = {name: props[name] for name in METHOD_PARAMETERS if name in props}
    return method_of(given.pop("method", "layered"), **given)


def flag_from(props: mi.Properties, name: str) -> bool:
    """A parameter that is false by default. Raises ``TypeError`` for other than true or false."""
    value = props.get(name, False)
    if not isinstance(value, bool):
        raise TypeError(f"{name}={shown(value)}: must be true or false")
    return value


def motion_from(props: mi.Properties) -> Motion | None:
    """What moves, of the file that a parameter names, which is sought where Mitsuba seeks files.

    Raises ``TypeError`` for other than text, and what ``Motion.load`` raises.
    """
    from ..motion.motion import Motion

    if "motion" not in props:
        return None
    require_path(props["motion"], "motion")
    return Motion.load(str(mi.file_resolver().resolve(props["motion"])))


def has_alpha(film: mi.Film) -> bool:
    """Whether the film shows coverage in a fourth channel."""
    return mi.has_flag(film.flags(), mi.FilmFlags.Alpha)
