"""Depth buffers: the bits that other renderers keep depth in, and the resolution that is left.

Stored depth, 0 to 1, and what it has to do with depth are those of :mod:`potmesil_mi.optics.depth`.
Here it becomes whole numbers of 16, 24 or 32 bits, a float32, or the four bytes of a picture's
pixel, and :class:`DepthBuffer` says what a code is worth. Since stored depth is affine in vergence,
and circles of confusion are, too, a code of a buffer of whole numbers is worth the same number of
pixels of blur at every depth.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal, get_args

import numpy as np

from .._validation import require_choice, shown
from .arithmetic import clamp_at_zero, is_drjit, on_host, reciprocal, require_each
from .blur import radius_per_vergence
from .camera import Camera
from .depth import (
    CLIPS,
    Clip,
    depth_from_stored,
    ndc_from_stored,
    require_planes,
    stored_from_depth,
    vergence_from_depth,
)
from .lens import ThinLens

BITS = (16, 24, 32)
"""The sizes of depth buffers."""

First = Literal["red", "alpha"]
"""The channel of packed depth that has its highest bits."""


# ---------------------------------------------------------------- between stored depth and bits


def code_from_stored(stored: Any, bits: int = 24) -> Any:
    """The code, 0 to 2^bits - 1, of a stored depth: the nearest whole number.

    Gives an ``int`` for a number, ``uint16`` (16 bits) or ``uint32`` for a NumPy array, ``UInt32``
    for a Dr.Jit array. Raises ``ValueError`` for a stored depth that is not in 0 to 1.
    """
    _require_bits(bits)
    require_each("stored", stored, "0 to 1", lambda s: (s >= 0) & (s <= 1))
    return _whole(_rounded(_in_double(stored) * _largest(bits)), "u2" if bits == 16 else "u4")


def stored_from_code(code: Any, bits: int = 24) -> Any:
    """The stored depth, code / (2^bits - 1), in double precision, which 32 bits need.

    Raises ``TypeError`` for what is no whole number, ``ValueError`` for a code out of range.
    """
    _require_bits(bits)
    _require_code("code", code, _largest(bits))
    return _in_double(code) / _largest(bits)


def rgba_from_stored(stored: Any, *, first: First = "red") -> Any:
    """The four bytes of a stored depth, as three.js packs it in a picture (``packDepthToRGBA``).

    With ``first="red"``, three.js from r167 on, red, green and blue are the whole part of
    2^24 stored, red highest, and alpha is the rest in 255 parts. With ``first="alpha"``, until
    r166, the four are 2^32 stored, alpha highest. A stored depth of 1 is 255 in all channels.
    (The old shader wrote 255 in alpha alone, which reads as 255/256.)

    Gives ``uint8`` of shape (..., 4) for a number or a NumPy array, and four ``UInt32`` arrays
    for a Dr.Jit array. Raises ``ValueError`` for a stored depth that is not in 0 to 1.
    """
    require_choice("first", first, get_args(First))
    require_each("stored", stored, "0 to 1", lambda s: (s >= 0) & (s <= 1))
    stored = _in_double(stored)
    last = _floor(stored)  # 1 for a stored depth of 1, and else 0
    rest, channels = stored - last, []
    for _ in range(3):
        rest = rest * 256
        channels.append(_floor(rest))
        rest = rest - channels[-1]
    lowest = _rounded(rest * 255) if first == "red" else _floor(rest * 256)
    channels = [_whole(channel + 255 * last, "u1") for channel in [*channels, lowest]]
    if first == "alpha":
        channels.reverse()
    return tuple(channels) if is_drjit(stored) else np.stack(channels, axis=-1).astype("u1")


def stored_from_rgba(rgba: Any, *, first: First = "red") -> Any:
    """The stored depth of four bytes (``unpackRGBAToDepth``), in double precision.

    ``rgba`` is a NumPy array of shape (..., 4), or four Dr.Jit arrays; of whole numbers, 0 to
    255. ``first`` is that of :func:`rgba_from_stored`. Raises ``TypeError`` for what is no whole
    number, ``ValueError`` for another shape or a number out of range.
    """
    require_choice("first", first, get_args(First))
    channels = [*np.moveaxis(rgba, -1, 0)] if isinstance(rgba, np.ndarray) else [*rgba]
    if len(channels) != 4:
        raise ValueError(f"rgba: has {len(channels)} channels, must have 4")
    for channel in channels:
        _require_code("rgba", channel, 255)
    if first == "alpha":
        channels.reverse()
    high, middle, low, lowest = map(_in_double, channels)
    whole = (high * 256 + middle) * 256 + low
    return (whole + lowest / (255 if first == "red" else 256)) / 2**24


# ---------------------------------------------------------------- a depth buffer


@dataclasses.dataclass(frozen=True)
class DepthBuffer:
    """A depth buffer: its planes, its conventions and its bits.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``near``, ``far``             clipping planes in scene units along z, 0 < near < far; the
                                  far plane may be ``inf`` (default)
    ``bits``                      16, 24 (default) or 32
    ``floating``                  the stored depth is a float32, which has 32 bits; else
                                  (default) a whole number, stored depth times 2^bits - 1
    ``clip``                      NDC depth is -1 to 1 (``opengl``, default) or 0 to 1
                                  (``direct3d``)
    ``reverse``                   reversed z: stored depth is 1 at the near plane, 0 at the far
    ============================  ==========================================================

    Raises ``TypeError`` or ``ValueError`` that names the parameter, its value and what is
    allowed.
    """

    near: float
    far: float = math.inf
    bits: int = 24
    floating: bool = False
    clip: Clip = "opengl"
    reverse: bool = False

    def __post_init__(self) -> None:
        require_planes(self.near, self.far)
        _require_bits(self.bits)
        require_choice("clip", self.clip, CLIPS)
        for name in ("floating", "reverse"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"{name}={shown(getattr(self, name))}: must be True or False")
        if self.floating and self.bits != 32:
            raise ValueError(f"bits={self.bits}: must be 32 where floating=True")

    def code_from_depth(self, depth: Any) -> Any:
        """What the buffer keeps of a ``depth`` in near to far: a code, or a float32.

        Empty pixels, whose depth is ``inf``, get the code of the far plane, as after the buffer
        was cleared. Raises ``ValueError`` for other depths that are not between the planes.
        """
        near, far = self.near, self.far
        require_each(
            "depth",
            depth,
            f"in near={near} to far={far}, or inf",
            lambda z: (z >= near) & ((z <= far) | (z == math.inf)),
        )
        depth = _in_double(depth)
        stored = stored_from_depth(depth, near, far, reverse=self.reverse)
        stored = clamp_at_zero(stored)  # Rounding, and empty pixels.
        stored = stored - clamp_at_zero(stored - 1)
        return _in_single(stored) if self.floating else code_from_stored(stored, self.bits)

    def depth_from_code(self, code: Any) -> Any:
        """The depth in scene units, in double precision, that the buffer keeps as ``code``.

        What was never drawn has the depth of the far plane. Raises ``ValueError`` for a code out
        of range, ``TypeError`` for one that is no whole number unless the buffer is ``floating``.
        """
        if self.floating:
            require_each("code", code, "0 to 1", lambda s: (s >= 0) & (s <= 1))
            stored = _in_double(code)
        else:
            stored = stored_from_code(code, self.bits)
        return depth_from_stored(stored, self.near, self.far, reverse=self.reverse)

    def vergence_step(self, depth: Any) -> Any:
        """By how much vergence two neighbouring codes at ``depth`` differ, per scene unit.

        (1/n - 1/f) / (2^bits - 1) for whole numbers, and so a plain number, the same everywhere.
        A ``floating`` buffer has the step of float32 at its stored depth, and no less than what
        float32 leaves of its NDC depth: with ``opengl`` small numbers near -1 are lost, so
        reversed z gains nothing there.
        """
        per_stored = 1 / self.near - 1 / self.far
        if not self.floating:
            return per_stored / _largest(self.bits)
        stored = stored_from_depth(depth, self.near, self.far, reverse=self.reverse)
        step = _float32_step(stored)
        if self.clip == "opengl":
            through_ndc = _float32_step(ndc_from_stored(stored)) / 2
            step = through_ndc + clamp_at_zero(step - through_ndc)
        return per_stored * step

    def depth_step(self, depth: Any) -> Any:
        """How long the interval of depths is that the code at ``depth`` stands for.

        For a code in the middle of which ``depth`` is, that is s / (1/z² - s²/4), with the step s
        of vergence; nearly z² s where it is small, which for a far ``far`` is z² / (n 2^bits): a
        near plane at half the distance has steps of twice the depth (Jünemann, "The graphics
        pipeline": "the smaller n, the worse the depth resolution"). ``inf`` where the interval
        reaches infinity.
        """
        vergence, half = vergence_from_depth(depth), self.vergence_step(depth) / 2
        return 2 * half * reciprocal(clamp_at_zero(vergence - half) * (vergence + half))

    def radius_step(self, depth: Any, lens: ThinLens, camera: Camera) -> Any:
        """What one code is worth in pixels of the radius of the circle of confusion (equation 8).

        The step of vergence times :func:`potmesil_mi.optics.blur.radius_per_vergence`. A depth is
        rounded by up to half a code, so the depth of field of a picture that is formed with this
        buffer is wrong by up to half of this; from about 1 pixel on that is seen as rings.
        """
        return radius_per_vergence(lens, camera) * self.vergence_step(depth)


# ---------------------------------------------------------------- checks and arithmetic


def _require_bits(bits: Any) -> None:
    if isinstance(bits, bool) or bits not in BITS:
        raise ValueError(f"bits={shown(bits)}: must be {', '.join(map(str, BITS))}")


def _require_code(name: str, code: Any, most: int) -> None:
    if on_host(code).dtype.kind not in "iu":
        raise TypeError(f"{name}: must be whole numbers, 0 to {most}")
    require_each(name, code, f"0 to {most}", lambda c: (c >= 0) & (c <= most))


def _largest(bits: int) -> int:
    return (1 << bits) - 1


def _in_double(value: Any) -> Any:
    if is_drjit(value):
        import drjit as dr

        return dr.float64_array_t(type(value))(value)
    return np.asarray(value, np.float64)[()]


def _in_single(value: Any) -> Any:
    if is_drjit(value):
        import drjit as dr

        return dr.float32_array_t(type(value))(value)
    return np.asarray(value, np.float32)[()]


def _floor(value: Any) -> Any:
    if is_drjit(value):
        import drjit as dr

        return dr.floor(value)
    return np.floor(value)


def _rounded(value: Any) -> Any:
    if is_drjit(value):
        import drjit as dr

        return dr.round(value)
    return np.rint(value)


def _whole(value: Any, dtype: str) -> Any:
    """Whole numbers as integers: ``int``, an array of ``dtype``, or Dr.Jit's ``UInt32``."""
    if is_drjit(value):
        import drjit as dr

        return dr.uint32_array_t(type(value))(value)
    return value.astype(dtype) if np.ndim(value) else int(value)


def _float32_step(value: Any) -> Any:
    """From |value| in float32 to the next larger number."""
    if is_drjit(value):
        import drjit as dr

        single = dr.detach(_in_single(abs(value)))
        bits = dr.reinterpret_array(dr.uint32_array_t(type(single)), single)
        return type(value)(dr.reinterpret_array(type(single), bits + 1) - single)
    return np.spacing(np.abs(np.float32(value))).astype(np.float64)
