"""A lens that learns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch.nn.utils import parametrize

from .._validation import require_choice, require_kind, require_number, shown
from ..optics.lens import FULL_FRAME_WIDTH, ThinLens
from .api import focus

LEARNED = ("focus_distance", "f_number")
"""The parameters of a lens that may be learned."""


class Above(torch.nn.Module):
    """Numbers above a bound, as the bound and the exponential of any number."""

    def __init__(self, name: str, bound: float) -> None:
        super().__init__()
        self.name, self.bound = name, bound

    def forward(self, unbounded: torch.Tensor) -> torch.Tensor:
        """The number above the bound."""
        return self.bound + unbounded.exp()

    def right_inverse(self, value: torch.Tensor) -> torch.Tensor:
        """The number of which it is made. Raises ``ValueError`` for one not above the bound."""
        if not bool(((value > self.bound) & value.isfinite()).all()):
            raise ValueError(
                f"{self.name}={shown(value.tolist())}: must be > {self.bound:g} and finite"
            )
        return (value - self.bound).log()


class LearnedLens(torch.nn.Module):
    """A thin lens that learns where it is focused, and its f-number.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``focus_distance``            to begin with, in scene units, finite, beyond the focal length
    ``f_number``                  to begin with, > 0 and finite
    ``focal_length``              in millimetres, > 0; it is not learned
    ``frame_width``               width of the film in millimetres, > 0 (default 36)
    ``millimeters_per_unit``      size of a scene unit, > 0 (default 1: distances in
                                  millimetres; 1000 for depth in metres)
    ``learn``                     which of ``focus_distance`` and ``f_number`` are learned
                                  (default: both); the others have no ``requires_grad``
    ``options``                   all else that the function has, such as ``aperture``
    ============================  ==========================================================

    ``lens(rgb, depth)`` is :func:`potmesil_mi.torch.focus`. What it learns are log(U - F) and
    log(n), of the focus distance U beyond the focal length F and the f-number n, by
    ``torch.nn.utils.parametrize``: no step of an optimiser leaves what is allowed, and one of 0.01
    changes them by about 1 %. ``lens.focus_distance`` and ``lens.f_number`` are U and n, and can be
    set. Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """

    focus_distance: torch.Tensor
    f_number: torch.Tensor

    def __init__(
        self,
        focus_distance: float,
        f_number: float,
        *,
        focal_length: float,
        frame_width: float = FULL_FRAME_WIDTH,
        millimeters_per_unit: float = 1.0,
        learn: Sequence[str] = LEARNED,
        **options: Any,
    ) -> None:
        super().__init__()
        for name, value in (("focus_distance", focus_distance), ("f_number", f_number)):
            require_number(name, value)
        require_kind("learn", learn, (list, tuple), f"a list of names, of {', '.join(LEARNED)}")
        for name in learn:
            require_choice("learn", name, LEARNED)
        lens = ThinLens(
            focal_length,
            f_number,
            focus_distance,
            frame_width=frame_width,
            millimeters_per_unit=millimeters_per_unit,
        )
        self.options = {
            "focal_length": lens.focal_length,
            "frame_width": lens.frame_width,
            "millimeters_per_unit": lens.millimeters_per_unit,
            **options,
        }
        bounds = {"focus_distance": lens.focal_length / lens.millimeters_per_unit, "f_number": 0.0}
        for name, bound in bounds.items():
            number = torch.tensor(float(getattr(lens, name)))
            self.register_parameter(name, torch.nn.Parameter(number, requires_grad=name in learn))
            parametrize.register_parametrization(self, name, Above(name, bound))

    def forward(self, rgb: torch.Tensor, depth: torch.Tensor) -> torch.Tensor:
        """The pictures (B, 3, H, W): see :func:`potmesil_mi.torch.focus`."""
        return focus(rgb, depth, self.focus_distance, self.f_number, **self.options)

    def extra_repr(self) -> str:
        """What the lens is now, and what does not change."""
        now = {name: f"{getattr(self, name).item():g}" for name in LEARNED}
        return ", ".join(f"{name}={value}" for name, value in {**now, **self.options}.items())
