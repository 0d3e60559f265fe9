"""Motion vectors of other programs: their units and signs, and what point samples have of them."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np

from .._validation import require_choice, require_number, require_numbers, shown

Convention = Literal["pixels", "blender", "forward"]
"""Whose vectors they are; see :func:`motion_vectors`."""

CONVENTIONS: tuple[Convention, ...] = get_args(Convention)
"""The conventions by their names, the default first."""

CHANNELS: dict[Convention, int] = {"pixels": 2, "blender": 4, "forward": 2}
"""How many channels the vectors of each convention have."""


def motion_vectors(
    channels: Any, convention: Convention = "pixels", *, exposure: float = 1.0
) -> np.ndarray:
    """The column ``motion`` of samples, float32 (N, 3), of motion vectors of another program.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``channels``                  numbers (..., C), a vector for each sample, as in the file
    ``convention``                ``pixels`` (default): two channels, pixels to the right and
                                  downwards from this frame to the next. ``blender``: the four
                                  of Cycles' pass Vector, X Y Z W, pixels to the right and
                                  *upwards*; X and Y are the place before less this one, Z and
                                  W this one less the next, so that it moves by -(Z, W).
                                  ``forward``: ``forward.u`` and ``forward.v`` of Nuke and
                                  Fusion, pixels to the right and *upwards* to the next frame
    ``exposure``                  part of the time to the next frame that the shutter is open,
                                  0 to 1000; half a frame is a shutter of 180 degrees
    ============================  ==========================================================

    Samples of one instant that have it are blurred by it, half before and half after where they
    are; their depth does not change. Where vectors are not finite it is 0. Raises ``ValueError``
    or ``TypeError`` that names the parameter.
    """
    require_choice("convention", convention, CONVENTIONS)
    require_number("exposure", exposure, 0, 1000)
    vectors = require_numbers("channels", channels).astype(np.float64)
    count = CHANNELS[convention]
    if vectors.ndim < 1 or vectors.shape[-1] != count:
        raise ValueError(
            f"channels={shown(channels)}: have shape {vectors.shape}, must be (..., {count}) for "
            f"{convention}"
        )
    vectors = vectors.reshape(-1, count)
    if convention == "blender":
        vectors = vectors[:, 2:] * [-1, 1]
    elif convention == "forward":
        vectors = vectors * [1, -1]
    there = np.isfinite(vectors).all(axis=1, keepdims=True)
    vectors = np.where(there, vectors, 0) * exposure
    return np.column_stack([vectors, np.zeros(len(vectors))]).astype(np.float32)
