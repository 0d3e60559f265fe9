"""Point samples: what the hidden-surface stage hands to the focus stage.

Section 3.1 of Potmesil & Chakravarty (1981): image coordinates, intensities, depth and surface
of every sample, with the parameters of the camera.
"""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Iterator, Mapping

import numpy as np

from .._validation import require_whole
from ..optics.camera import Camera
from ..optics.lens import ThinLens
from .raster import Window

_COLUMNS = {
    "x": np.float32,
    "y": np.float32,
    "rgb": np.float32,
    "alpha": np.float32,
    "z": np.float32,
    "surface": np.uint32,
    "weight": np.float32,
    "layer": np.uint8,
}


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class PointSamples:
    """N point samples of a scene, seen through a pinhole.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``x``, ``y``                  float32 (N,), position in pixels of the whole film, from its
                                  top left corner; pixel i covers [i, i + 1]
    ``rgb``                       float32 (N, 3), radiance in linear sRGB, unfiltered
    ``alpha``                     float32 (N,), 1 where the nested integrator saw something
    ``z``                         float32 (N,), depth in scene units along the camera's axis,
                                  > 0; ``inf`` for a ray that hit nothing
    ``surface``                   uint32 (N,), id of the visible surface; 0 for none
    ``weight``                    float32 (N,), share of a pixel's area the sample stands for
    ``layer``                     uint8 (N,), how many surfaces the pinhole sees in front of it:
                                  0 for what it sees (default), 1 and more for what is hidden
    ``camera``, ``lens``          the pinhole that took them, the lens that came with it
    ``surfaces``                  name of every surface id
    ``lattice``                   where positions are multiples of 1/lattice pixels: that
                                  number; 0 where they may be anywhere
    ``window``                    :class:`Window` of what was sampled: the crop window
                                  (default), or more with overscan
    ============================  ==========================================================

    Samples with radiance, alpha or position that is not finite, or with depth or weight that is
    NaN or not positive are dropped, with a ``RuntimeWarning`` that counts them. Raises
    ``ValueError`` for columns of unequal length or wrong shape, for a window of less than one
    pixel, and where no sample is left, ``TypeError`` for a window of other than whole numbers.
    """

    x: np.ndarray
    y: np.ndarray
    rgb: np.ndarray
    alpha: np.ndarray
    z: np.ndarray
    surface: np.ndarray
    weight: np.ndarray
    camera: Camera
    lens: ThinLens
    surfaces: Mapping[int, str] = dataclasses.field(default_factory=dict)
    lattice: int = 0
    layer: np.ndarray = None  # type: ignore[assignment]
    window: Window = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        require_whole("lattice", self.lattice, 0, 1 << 16)
        count = len(self.x)
        if self.layer is None:
            object.__setattr__(self, "layer", np.zeros(count, dtype=np.uint8))
        window = self.crop_window if self.window is None else Window.of(self.window)
        object.__setattr__(self, "window", window)
        for name, dtype in _COLUMNS.items():
            column = np.ascontiguousarray(getattr(self, name), dtype=dtype)
            expected = (count, 3) if name == "rgb" else (count,)
            if column.shape != expected:
                raise ValueError(f"{name}: has shape {column.shape}, must have {expected}")
            object.__setattr__(self, name, column)
        if not all(condition.all() for condition in self._conditions()):
            valid = np.logical_and.reduce(
                [condition.reshape(count, -1).all(axis=1) for condition in self._conditions()]
            )
            for name in _COLUMNS:
                object.__setattr__(self, name, getattr(self, name)[valid])
            warnings.warn(
                f"dropped {count - len(self)} of {count} samples: radiance, alpha, position or "
                "weight not finite, or depth or weight not > 0",
                RuntimeWarning,
                stacklevel=3,
            )
        if len(self) == 0:
            raise ValueError("no samples: there must be at least one with finite radiance")

    def _conditions(self) -> Iterator[np.ndarray]:
        """What has to be true of the samples, bool (N,) or (N, 3) each."""
        for values in (self.rgb, self.alpha, self.x, self.y, self.weight):
            yield np.isfinite(values)
        for values in (self.z, self.weight):
            yield values > 0

    def __len__(self) -> int:
        return len(self.x)

    @property
    def crop_window(self) -> Window:
        """The window that the picture shows: the crop window of the camera."""
        return Window(*self.camera.crop_offset, *self.camera.crop_size)

    def __repr__(self) -> str:
        width, height = self.camera.crop_size
        return (
            f"PointSamples({len(self):,} in {width}x{height} pixels, z = {self.z.min():g} to "
            f"{self.z.max():g}, surfaces = {list(self.surfaces.values())}, lens = {self.lens})"
        )

    def replace(self, **changes: object) -> PointSamples:
        """Samples with some fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def visible(self) -> PointSamples:
        """What the pinhole sees: the samples of layer 0."""
        first = self.layer == 0
        if first.all():
            return self
        return self.replace(**{name: getattr(self, name)[first] for name in _COLUMNS})

    def pixel(self) -> np.ndarray:
        """Index of each sample's pixel in ``window``, row by row, int64 (N,).

        A sample on an edge between pixels belongs to the one on its right or below it; on the
        window's last edge, and beyond the window, to the nearest pixel.
        """
        return self.window.pixel_of(self.x, self.y)

    def merge(self, lens: ThinLens | None = None, tolerance: float = 0.1) -> PointSamples:
        """Fewer samples that ``lens`` (default: their own) can hardly tell from these.

        The rule: samples of one quarter of a pixel (its 2x2 squares), of the same layer, surface
        and alpha, whose signed circles of confusion round to the same multiple of ``tolerance``
        pixels, become one. It has the sum of their weights and, weighted by these, the mean of
        their positions, colours and 1/z, so that the light of a pixel is unchanged. Samples on
        a lattice belong to several pixels and stay as they are.
        Raises ``ValueError`` for a tolerance that is not > 0.
        """
        if not 0 < tolerance < np.inf:
            raise ValueError(f"tolerance={tolerance}: must be > 0 pixels and finite")
        if self.lattice > 0:
            return self
        circle = (lens or self.lens).circle_of_confusion(self.z.astype(np.float64))
        pixels_per_mm = self.camera.focal_length_pixels / (lens or self.lens).film_distance
        step = np.rint(circle * pixels_per_mm / tolerance)
        quarter = 2 * (self.y % 1 >= 0.5) + (self.x % 1 >= 0.5)
        keys = np.stack([self.pixel(), quarter, self.layer, self.surface, self.alpha, step])
        order = np.lexsort(keys[::-1])
        ordered = keys[:, order]
        first = np.flatnonzero(
            np.concatenate([[True], (ordered[:, 1:] != ordered[:, :-1]).any(axis=0)])
        )
        weight = self.weight[order].astype(np.float64)
        total = np.add.reduceat(weight, first)

        def mean(values: np.ndarray) -> np.ndarray:
            scale = weight if values.ndim == 1 else weight[:, None]
            sums = np.add.reduceat(values[order] * scale, first, axis=0)
            return sums / (total if values.ndim == 1 else total[:, None])

        with np.errstate(divide="ignore"):
            z = 1 / mean(1 / self.z.astype(np.float64))
        return self.replace(
            x=mean(self.x),
            y=mean(self.y),
            rgb=mean(self.rgb),
            alpha=self.alpha[order][first],
            z=z,
            surface=self.surface[order][first],
            layer=self.layer[order][first],
            weight=total,
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a deep EXR: see :func:`potmesil_mi.deep_exr.save`."""
        from . import deep_exr

        deep_exr.save(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> PointSamples:
        """Read a deep EXR that :meth:`save` wrote: see :func:`potmesil_mi.deep_exr.load`."""
        from . import deep_exr

        return deep_exr.load(path)
