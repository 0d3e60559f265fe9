"""Groups of samples: those that have the same key."""

from __future__ import annotations

import numpy as np

from .columns import parts_of

DENSE = 4
"""Keys whose range is up to so many times their number are counted, and not sorted."""


def grouped(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The number of the group of each of ``keys``, int (N,), and the first sample of each group.

    Groups are numbered from 0 in the order of their keys, as ``np.unique`` numbers them. Keys that
    are close together, as those of pixels are, take a tenth of its time. Both results are int64:
    (N,), and one element for each group.
    """
    if len(keys) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    least = keys.min()
    apart = int(keys.max()) - int(least)
    if apart >= DENSE * len(keys):
        _, first, number = np.unique(keys, return_index=True, return_inverse=True)
        return number.astype(np.int64, copy=False), first
    place = (keys - least).astype(np.int64)
    present = np.zeros(apart + 1, bool)
    present[place] = True
    number = (np.cumsum(present) - 1)[place]
    first = np.empty(np.count_nonzero(present), np.int64)
    first[number[::-1]] = np.arange(len(keys) - 1, -1, -1)  # The last that is written stays.
    return number, first


def in_rows(y: np.ndarray, first: int, every: int) -> np.ndarray:
    """Index, int64 (n,), of positions ``y``, (N,), in row ``first`` and ``every`` so many rows."""
    found = [np.empty(0, np.int64)]
    for part in parts_of(len(y)):
        rows = y[part].astype(np.int32)
        rows -= first
        # Remainders take longer.
        found.append(part.start + np.flatnonzero(rows // every * every == rows))
    return np.concatenate(found)
