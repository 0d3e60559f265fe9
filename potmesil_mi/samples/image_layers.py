"""What a picture lacks to be samples: parts of pixels, and what near edges hide.

A pixel of a picture has one colour and one depth. Where a silhouette is in it, it becomes two
samples (``silhouettes.py``); behind near edges what is farther goes on (``uncovered.py``).
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

import numpy as np

Hidden = Literal["farther", "none"]
"""What is behind near edges: what is farther beside them goes on, or there is nothing."""

BRIGHTEST = float(np.finfo(np.float32).max)
"""The most radiance that a sample can have."""

HIDDEN: tuple[Hidden, ...] = get_args(Hidden)


class LayeredImage(NamedTuple):
    """The columns of N samples of a picture, and the pixels whose depth and light they copy, (N,).

    ``light_of`` is ``None`` where pixels were parted: their parts have colours of their own.
    """

    columns: dict[str, Any]
    depth_of: np.ndarray
    light_of: np.ndarray | None


def with_layers(
    columns: dict[str, np.ndarray],
    z: np.ndarray,
    radius_per_vergence: float,
    antialiased: bool,
    hidden: Hidden,
) -> LayeredImage:
    """The columns of one sample a pixel, row by row, with those of its parts and of what is hidden.

    ``z``, (H, W), are their depths; a lens of that ``radius_per_vergence``, in pixels, is to see
    them. Of both parts of a pixel together, and of the picture of the pinhole, everything stays as
    it is.
    """
    # These need SciPy, which takes a while to import, and few samples are of pictures.
    from .bright_edges import bright_edges_of
    from .silhouettes import near_silhouettes, parts_of
    from .uncovered import uncovered_by

    if radius_per_vergence <= 0:
        pixels = np.arange(z.size)
        return LayeredImage(columns, pixels, pixels)
    count = z.size
    light = np.column_stack([columns["rgb"], columns["alpha"]]).astype(np.float64)
    weight, weight_behind, of_farther = np.ones(count), np.ones(count), light.copy()
    middle = np.zeros((count, 2))
    added, light_of = [], [np.arange(count)]
    if antialiased:
        positive = np.maximum(light, 0).reshape(*z.shape, light.shape[1])
        parallax = radius_per_vergence / z
        parts = parts_of(positive, parallax)
        at, share = parts.pixel, parts.share
        nearer = z.ravel()[parts.source] < z.ravel()[at]
        # What is negative stays with the surface whose depth the pixel has.
        own = parts.own + np.minimum(light[at], 0) / (1 - share)[:, None]
        light[at], weight[at] = own, 1 - share
        of_farther[at] = np.where(nearer[:, None], own, parts.other)
        added.append(_Added(at, parts.source, parts.other, share, 0))
        if hidden == "farther":
            # Behind the part of the nearer one the farther goes on.
            behind = at[nearer], at[nearer], own[nearer], share[nearer]
            added.append(_Added(*behind, 1))
            weight_behind[at[~nearer]] = 1 - share[~nearer]
        edges = bright_edges_of(positive, near_silhouettes(parallax))
        at, share, negative = edges.pixel, edges.share, np.minimum(light[edges.pixel], 0)
        light[at], weight[at] = edges.bright + negative, share
        middle[at] = edges.toward * (1 - share)[:, None] / 2
        middle_of_dark = -edges.toward * share[:, None] / 2
        added.append(_Added(at, at, edges.dark + negative, 1 - share, 0, middle_of_dark))
    if hidden == "farther":
        found = uncovered_by(z, radius_per_vergence)
        pixel, colour = found.pixel, of_farther[found.colour_of]
        added.append(_Added(pixel, found.depth_of, colour, weight_behind[pixel], 1))
        light_of.append(found.colour_of)
    layers = _joined(columns, light, weight, middle, added)
    return layers if antialiased else layers._replace(light_of=np.concatenate(light_of))


class _Added:
    """Samples in the pixels ``at``, with the depth and the surface of other pixels.

    ``light`` is RGB and alpha, (n, 4), ``weight`` (n,), ``layer`` that of all, ``middle`` where
    they are from the middles of the pixels, right and down, (n, 2).
    """

    def __init__(
        self,
        at: np.ndarray,
        source: np.ndarray,
        light: np.ndarray,
        weight: np.ndarray,
        layer: int,
        middle: np.ndarray | float = 0.0,
    ) -> None:
        self.at, self.source, self.light, self.weight = at, source, light, weight
        self.middle = np.broadcast_to(middle, (len(at), 2))
        self.layer = np.full(len(at), layer, np.uint8)


def _joined(
    columns: dict[str, np.ndarray],
    light: np.ndarray,
    weight: np.ndarray,
    middle: np.ndarray,
    added: list[_Added],
) -> LayeredImage:
    """The columns with what is ``added``, and with the other ones of their own."""
    at = np.concatenate([np.arange(len(weight)), *(of.at for of in added)])
    source = np.concatenate([np.arange(len(weight)), *(of.source for of in added)])
    light = np.concatenate([light, *(of.light for of in added)])
    middle = np.concatenate([middle, *(of.middle for of in added)])
    light = np.clip(light, -BRIGHTEST, BRIGHTEST)
    joined = {
        "x": columns["x"][at] + middle[:, 0],
        "y": columns["y"][at] + middle[:, 1],
        "rgb": light[:, :3],
        "alpha": light[:, 3],
        "z": columns["z"][source],
        "surface": columns["surface"][source],
        "weight": np.concatenate([weight, *(of.weight for of in added)]),
        "layer": np.concatenate([np.zeros(len(weight), np.uint8), *(of.layer for of in added)]),
    }
    return LayeredImage(joined, source, None)
