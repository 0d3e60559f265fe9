"""Apertures whose parameters may have gradients: Dr.Jit arrays beside the plain numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, TypeVar

from .. import _backend as jit
from .._validation import shown
from .aperture import Aperture
from .arithmetic import is_drjit, on_host, single

A = TypeVar("A", bound="DifferentiableAperture")


class Attached(NamedTuple):
    """The Dr.Jit array of a parameter, and the plain one that the aperture has of it."""

    values: Any
    plain: Any


@dataclasses.dataclass(frozen=True)
class DifferentiableAperture(Aperture):
    """An aperture in whose parameters pictures have derivatives.

    It has plain numbers, by which it is equal to others and is described, whatever was given.
    """

    _attached: Mapping[str, Attached] | None = dataclasses.field(
        default=None, repr=False, compare=False, kw_only=True, metadata={"spec": False}
    )

    steps: ClassVar[Mapping[str, float]] = {}
    """Parameters that are numbers, and a step of each: so small that what is made of the aperture
    changes linearly, and so large that it changes by much more than it is rounded in float64."""

    def smooth(self) -> DifferentiableAperture:
        """The same aperture without gradients, of a shape that is smooth in what has some."""
        return self.without_gradients()

    @property
    def attached(self) -> dict[str, Any]:
        """See :attr:`Aperture.attached`."""
        # What dataclasses.replace has put in the place of a parameter has no gradients.
        return {
            name: of.values
            for name, of in (self._attached or {}).items()
            if of.plain is getattr(self, name)
        }

    def without_gradients(self: A) -> A:
        """See :meth:`Aperture.without_gradients`."""
        return dataclasses.replace(self, _attached=None) if self._attached else self

    def _take_numbers(self, *names: str) -> None:
        """Have plain numbers in the place of Dr.Jit arrays, and beside them what has gradients.

        Raises ``ValueError`` for several numbers, ``TypeError`` for a type without gradients.
        """
        for name in names:
            value = getattr(self, name)
            if is_drjit(value):
                self._attach(name, value, single(name, value))

    def _attach(self, name: str, given: Any, plain: Any) -> None:
        """Have ``plain`` as a parameter, and what is ``given`` beside it if it has gradients."""
        object.__setattr__(self, name, plain)
        known = self._attached or {}
        if has_gradient(given):
            found = Attached(array_of(name, given), plain)
        elif name in known and known[name].plain is given:
            found = known[name]._replace(plain=plain)
        else:
            return
        object.__setattr__(self, "_attached", {**known, name: found})


def has_gradient(value: Any) -> bool:
    """Whether ``value`` is a Dr.Jit array that has gradients enabled."""
    if not is_drjit(value):
        return False
    import drjit as dr

    return bool(dr.grad_enabled(value))


def array_of(name: str, value: Any) -> Any:
    """The array of single-precision numbers that ``value``, also a tensor or vectors, has.

    Raises ``TypeError`` for a type without gradients.
    """
    import drjit as dr

    array = value.array if dr.is_tensor_v(value) else dr.ravel(value)
    if not isinstance(array, jit.Float):
        raise TypeError(
            f"{name}={shown(on_host(value))}: must be an array of {jit.Float.__module__}, which "
            "mi.variant() has, to have gradients"
        )
    return array
