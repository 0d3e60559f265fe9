"""Equation 20 as printed: the focus processor of the paper, by tables.

Section 3.2 of Potmesil & Chakravarty (1981). The intensity of a subpixel of the film is

    Q = sum_i c_i f_i / sum_i f_i,    f_i = (integral over the subpixel of I(z_i, x - x_i)) / z_i^2

over all samples i. The integrals come from tables at equally spaced depths, interpolated linearly
between the two nearest. That is linear in the tables, so the sums over samples are sums over
tables of the samples' shares of that table, convolved with it: the cost does not grow with the
area of the circles.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import drjit as dr
import numpy as np

from .. import _backend as jit
from .._progress import track
from ..optics.convolution import convolve_fully
from ..samples.point_samples import PointSamples
from ..samples.raster import Window
from .choices import TableEnds
from .exposure import Exposure
from .fragments import among_few, scatter_mode
from .smearing import samples_along_paths

SCATTERED_AT_ONCE = 1 << 21
"""Most samples that are scattered at once; it bounds the memory of a step."""

SMALL_REACH = 2
"""Circles that reach no farther than so many subpixels are added subpixel by subpixel."""

SMALL_CLASSES = 64
"""Position classes on a side of a subpixel for small circles, whose place matters most."""

AS_IF_INFINITE = 0.02
"""Radius in subpixels that the circles of what is farther away than the last table lack, at most,
to be as large as those of what is infinitely far away, with which they are counted."""

NEAREST = 1e-5
"""Depth of the first table, as a part of the last one's, at least: precision bounds how much
brighter than far light near light can be, and how much wider its circles."""

DARKEST = 1e-12
"""Denominator of equation 20, as a part of the largest, below which a subpixel has no light."""


def form(exposure: Exposure, tables: int, inverse_square: bool) -> tuple[np.ndarray, np.ndarray]:
    """Q for every subpixel of the crop window, and what the subpixel counts in its pixel.

    Samples that move are spread along their paths first: their surfaces are known, as section 3.1
    keeps them for, and what hides what on the way is not. The C intensities c_i are R, G, B and, if
    it is asked for, alpha. ``tables`` stand at equally spaced depths between the nearest and the
    farthest sample; samples at infinity have a table of their own. With ``inverse_square`` light
    falls off as 1/z^2; for want of a finite depth, samples at infinity are weighted like the
    farthest that hit something. Before a telecentric lens light does not fall off: there each point
    of the film sees all of the lens's cone.

    Returns Q, float64 (H, W, C), and what each subpixel counts in its pixel, float64 (H, W): on a
    lattice all alike, as in the paper; elsewhere, where chance puts more samples here than there,
    the light that reaches it before its fall-off. A subpixel that no light reaches is 0 and counts
    nothing.
    """
    exposure = as_seen(exposure)
    samples = exposure.samples
    classes = PositionClasses.of(exposure)
    # As far as a sample can be from a subpixel of the crop window.
    whole = samples.window.subdivided(exposure.subpixels)
    farthest = whole.width + exposure.crop.width, whole.height + exposure.crop.height
    inverse_square = inverse_square and not exposure.telecentric
    depths = _depths(exposure)
    ends = table_ends(exposure) if exposure.choices is None else exposure.choices.tables
    assert ends is not None
    depths = np.where(depths > ends.last, np.float32(np.inf), depths)
    stack = _TableStack.of(np.maximum(depths, ends.nearest), ends, tables)
    columns = [samples.rgb] + ([samples.alpha[:, None]] if exposure.alpha else [])
    # Only differences from the mean are convolved: a uniform picture stays so to the last digit.
    mean = np.concatenate([samples.weight @ column for column in columns])
    mean /= samples.weight.sum()
    # The numerators, the denominator, and where it is asked for the light before its fall-off.
    unattenuated = inverse_square and not samples.lattice
    sums = np.zeros((*exposure.crop.shape, len(mean) + 1 + unattenuated))
    for depth, index, share in track(stack, "Focusing", total=tables + 1):

        def light_of(
            part: slice, index: np.ndarray = index, share: np.ndarray = share
        ) -> np.ndarray:
            i = index[part]
            weight = (samples.weight[i] * share[part])[:, None]
            falloff = np.ones_like(weight)
            if inverse_square:
                z = np.minimum(stack.z[i], stack.farthest)
                falloff[:, 0] = np.square(stack.farthest / z)
            differences = np.concatenate([column[i] for column in columns], axis=1) - mean
            values = [differences * falloff, falloff]
            if unattenuated:
                values.append(np.ones_like(falloff))
            return np.concatenate(values, axis=1) * weight

        if exposure.telecentric:
            depth = 1 / depth if depth > 0 else math.inf

        def table(offset: np.ndarray, depth: float = depth) -> np.ndarray:
            lens, per_mm = exposure.lens, exposure.subpixels_per_mm
            return exposure.psf.table(lens, depth, per_mm, offset, farthest)

        _spread(sums, classes, samples, index, light_of, table)

    numerators, denominator, light = sums[..., : len(mean)], sums[..., len(mean)], sums[..., -1]
    lit = denominator > DARKEST * denominator.max()
    q = mean + numerators / np.where(lit, denominator, 1)[..., None]
    # A mean of samples lies between them; what the convolution's rounding adds does not.
    least, most = (
        np.concatenate([bound(column, axis=0) for column in columns]) for bound in (np.min, np.max)
    )
    weights = np.ones_like(light) if samples.lattice else np.maximum(light, 0)
    return np.where(lit[..., None], np.clip(q, least, most), 0), np.where(lit, weights, 0)


def as_seen(exposure: Exposure) -> Exposure:
    """The exposure of what the pinhole sees, along the paths of what moves."""
    return dataclasses.replace(exposure, samples=samples_along_paths(exposure.samples.visible()))


def _depths(exposure: Exposure) -> np.ndarray:
    """The depths of samples that steps between tables are equal in, float32 (N,).

    The depth of an orthographic camera is affine in 1/z of what stands for its samples.
    """
    z = exposure.samples.z
    with np.errstate(divide="ignore"):
        return 1 / z if exposure.telecentric else z


def table_ends(exposure: Exposure) -> TableEnds:
    """Where the tables of all samples of an exposure end, :func:`as_seen`."""
    depths, last = _depths(exposure), math.inf
    if not exposure.telecentric:
        radius = exposure.blur.radius_per_vergence
        last = radius / AS_IF_INFINITE or float(depths.min()) / NEAREST
    finite = depths[np.isfinite(depths) & (depths <= last)]
    if len(finite) == 0:
        return TableEnds(np.float32(0), np.float32(0), last)
    farthest = finite.max()
    return TableEnds(np.maximum(finite.min(), NEAREST * farthest), farthest, last)


class PositionClasses(NamedTuple):
    """Where in the subpixels of the crop window samples lie, in classes.

    Positions are rounded to ``n`` x ``n`` classes in each subpixel, each with a table of its own.
    Samples on a ``lattice`` (the paper's, with its corners, edge middles and centres of pixels) are
    met exactly; others are taken at the middle of their class. ``left`` and ``top`` are the crop
    window's first pixel of the film.
    """

    subpixels: int
    left: int
    top: int
    lattice: int

    @classmethod
    def of(cls, exposure: Exposure) -> PositionClasses:
        """Those of an exposure."""
        left, top = exposure.samples.crop_window[:2]
        return cls(exposure.subpixels, left, top, exposure.samples.lattice)

    def on_a_side(self, reach: int) -> int:
        """Classes on a side of a subpixel for circles of that reach in subpixels."""
        classes = SMALL_CLASSES if reach <= SMALL_REACH else 2 if reach <= 8 else 1
        return min(classes, math.ceil(self.lattice / self.subpixels)) if self.lattice else classes

    def locate(
        self, positions: np.ndarray, origin: int, classes: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Subpixel and class, along one axis, of positions in pixels of the film."""
        fine = (positions.astype(np.float64) - origin) * (self.subpixels * classes)
        rounded = np.rint(fine) if self.lattice else np.floor(fine)
        subpixel, class_ = np.divmod(rounded.astype(np.int32), classes)
        return subpixel, class_

    def offsets(self, classes: int) -> np.ndarray:
        """Where in a subpixel, 0 to 1, the samples of each class lie: (classes * classes, 2)."""
        middle = 0.0 if self.lattice else 0.5
        y, x = np.divmod(np.arange(classes**2), classes)
        return np.stack([x + middle, y + middle], axis=-1) / classes


@dataclasses.dataclass(frozen=True)
class _TableStack:
    """Depths of the tables, and the nearer of the two between which each sample lies."""

    z: np.ndarray
    depths: list[float]
    spacing: float
    farthest: float
    nearer: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray, ends: TableEnds, tables: int) -> _TableStack:
        finite = np.isfinite(z)
        nearest, farthest = float(ends.nearest) or 1.0, float(ends.farthest) or 1.0
        spacing = max(farthest - nearest, np.finfo(np.float32).tiny) / (tables - 1)
        nearer = np.full(len(z), tables, dtype=np.int16)
        nearer[finite] = np.minimum((z[finite] - nearest) / spacing, tables - 2)
        depths = [*np.linspace(nearest, farthest, tables).tolist(), math.inf]
        return cls(z, depths, spacing, farthest, nearer)

    def __iter__(self) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        """Each table's depth, the samples that use it, and the share of each that it gets."""
        before = np.empty(0, dtype=np.uint32)
        for k, depth in enumerate(self.depths):
            # 32 bits: with all samples of a large film in a table or two, indices weigh heavily.
            beyond = np.flatnonzero(self.nearer == k).astype(np.uint32)
            if math.isinf(depth):
                yield depth, beyond, np.ones(len(beyond), dtype=np.float32)
                return
            index = np.concatenate([before, beyond])
            share = self.z[index]
            share -= np.float32(depth)
            np.abs(share, out=share)
            share /= np.float32(-self.spacing)
            share += 1
            yield depth, index, np.clip(share, 0, 1, out=share)
            before = beyond


def _spread(
    target: np.ndarray,
    classes: PositionClasses,
    samples: PointSamples,
    index: np.ndarray,
    light_of: Callable[[slice], np.ndarray],
    table: Callable[[np.ndarray], np.ndarray],
) -> None:
    """Add to ``target``, (H, W, C), the light of the samples ``index``, spread by ``table``.

    ``light_of`` gives the values, float32 (n, C), of a part of them. The samples are gathered
    by subpixel and class, and each class is convolved with its table, in the box where there are
    samples; where the tables are small, samples are added subpixel by subpixel instead.
    """
    count = len(index)
    if count == 0:
        return
    middle = table(np.array([0.5, 0.5]))
    reach_y, reach_x = (size // 2 for size in middle.shape)
    reach = max(reach_x, reach_y)
    side = classes.on_a_side(reach)
    offsets = classes.offsets(side)
    kernels = middle[None] if np.array_equal(offsets, [[0.5, 0.5]]) else table(offsets)
    small = reach <= SMALL_REACH
    parts = [
        slice(start, min(start + SCATTERED_AT_ONCE, count))
        for start in range(0, count, SCATTERED_AT_ONCE)
    ]
    (left, right), (top, bottom) = (
        classes.locate(_range(positions[index[part]] for part in parts), origin, side)[0].tolist()
        for positions, origin in ((samples.x, classes.left), (samples.y, classes.top))
    )
    box = Window(left, top, right - left + 1, bottom - top + 1)
    reached = Window(
        left - reach_x, top - reach_y, box.width + 2 * reach_x, box.height + 2 * reach_y
    )
    if small:
        box = reached
    shape = (1 if small else side**2, *box.shape, target.shape[-1])
    size = math.prod(shape)
    gathered = dr.zeros(jit.Float, among_few(size, 2))
    for part in parts:
        x, class_x = classes.locate(samples.x[index[part]], classes.left, side)
        y, class_y = classes.locate(samples.y[index[part]], classes.top, side)
        class_ = class_y * side + class_x
        place = (y - box.top) * box.width + (x - box.left)
        if small:
            _scatter_add(gathered, light_of(part), place, (kernels, class_, box.width))
        else:
            _scatter_add(gathered, light_of(part), class_ * box.size + place)
    images = np.array(gathered)[:size].reshape(shape)
    del gathered
    if small:
        _add(target, images[0], box)
        return
    dr.flush_malloc_cache()  # the transforms need the memory that Dr.Jit would keep
    for kernel, image in zip(kernels, images, strict=True):
        if not image.any():
            continue
        for channel in range(image.shape[-1]):
            spread = convolve_fully(image[..., channel].astype(np.float64), kernel)
            _add(target[..., channel], spread, reached)


def _scatter_add(
    target: jit.Float,
    values: np.ndarray,
    place: np.ndarray,
    around: tuple[np.ndarray, np.ndarray, int] | None = None,
) -> None:
    """Add each row of ``values``, (n, C), to the C elements of ``target`` at its place.

    With ``around`` it is spread over the K x L places around: kernels (classes, K, L), the class
    of each row, and the number of places in a row of the picture.
    """
    mode = scatter_mode(values.size / dr.width(target))
    channels = values.shape[1]
    lane = dr.arange(jit.UInt32, values.size)
    row = lane // channels
    index = dr.gather(jit.UInt32, jit.from_numpy(jit.UInt32, place), row) * channels
    index += lane - row * channels
    value = jit.from_numpy(jit.Float, values.ravel())
    if around is None:
        dr.scatter_add(target, value, index, mode=mode)
    else:
        kernels, class_, across = around
        rows, columns = kernels.shape[1:]
        width = dr.opaque(jit.Int32, across * channels)
        flat = jit.from_numpy(jit.Float, kernels.ravel())
        first = dr.gather(jit.UInt32, jit.from_numpy(jit.UInt32, class_), row) * (rows * columns)
        for i, (dy, dx) in enumerate(itertools.product(range(rows), range(columns))):
            if kernels[:, dy, dx].any():
                offset = (dy - rows // 2) * width + (dx - columns // 2) * channels
                share = dr.gather(jit.Float, flat, first + i)
                beside = jit.UInt32(jit.Int32(index) + offset)
                dr.scatter_add(target, value * share, beside, mode=mode)
    dr.eval(target)


def _range(parts: Iterable[np.ndarray]) -> np.ndarray:
    """Least and greatest of all elements."""
    ends = [(part.min(), part.max()) for part in parts]
    return np.array([min(least for least, _ in ends), max(most for _, most in ends)])


def _add(target: np.ndarray, image: np.ndarray, box: Window) -> None:
    """Add ``image``, which covers ``box``, to ``target``; what lies outside it is lost."""
    whole = Window(0, 0, *target.shape[1::-1])
    common = whole.intersection(box)
    if not common.is_empty:
        target[common.slices_in(whole)] += image[common.slices_in(box)]
