"""Denoising of point samples, before the lens: Intel's Open Image Denoise on images of irradiance.

The denoiser works on images, and samples of one pixel may show several surfaces. So the samples of
a pixel that show one surface are a *group*, be they visible or hidden, and an image shows one group
in each pixel. The first image shows what is seen most of. A group that it does not show gets what
is denoised of its surface in the pixels beside its own, so that nothing is carried over an edge.
What is seen most of nowhere near, such as a hidden thing, is shown by further images, and around it
what the first shows. A few groups that none shows are left alone.

What is denoised is the irradiance: radiance over albedo, as a ratio of sums over the group, so that
textures are not in it. Normals tell edges, and a grey for each surface those between parallel ones.
Samples then have the denoised irradiance times their own albedo.

A denoiser is biased. Between samples and what it makes of them stand two weights for each group,
both of estimates that are averaged over a few pixels around (``REACH``):

- ``own``: of the mean of the group. Its variance V is that of its samples over their number, and
  its mean squared difference to what is denoised is D. What D is more than V, and more than it may
  be by chance, is the denoiser's bias B; ``own`` is B / (B + V), as James and Stein weigh.
- ``detail``: of what varies within the group, as the shading of something thin does. If that is
  noise it shows between pixels, too, and V is no more than about D, or twice that where a sampler
  is stratified. It is kept from there on: ``detail`` is 1 - D / (V ``NOISE``).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import scipy.ndimage

from .._progress import track
from .columns import Columns
from .grouping import grouped
from .raster import Window

LEAST_ALBEDO = 0.01
"""What is darker counts as that: radiance is divided by it, and glossy things reflect more."""

REACH = 2.0
"""Standard deviation, in pixels, of the Gaussian over which variances and differences are averaged:
some fifty pixels."""

SURE = 1.0
"""Standard errors by which what is taken for bias is more than the variance."""

NOISE = 0.5
"""Share of the variance within pixels that noise shows between them, at least."""

MOST_SURFACES = 6
"""Images that are denoised. What else there is in a pixel, behind and beside each other, is left
alone."""

LEAST_SHOWN = 0.005
"""For groups in a smaller part of the pixels there is no further image."""

DARKEST = 1e-3
"""Irradiance that differences are relative to at least, to the root mean square of the image's."""

BESIDE = 2
"""Pixels in each direction in which the surface of a group is looked for that is not seen most of
in its own."""

SHARPNESS = 128
"""Power of the cosine between normals: surfaces that face elsewhere have another irradiance."""

LEAST_ALIKE = 0.3
"""Weight of neighbours, of which one beside the pixel that faces the same way has 0.6, that is
enough."""

GOLDEN_SECTION = (5**0.5 - 1) / 2

TINY = 1e-30
"""Less than any variance, and not 0."""

LABEL = "Denoising"
"""What is said of the progress."""


def require_extra() -> ModuleType:
    """The denoiser. Raises ``ImportError`` that says how to install it."""
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise ImportError(
            f"denoising needs mitsuba-oidn: pip install 'potmesil_mi[denoise]' ({error})"
        ) from error
    module: ModuleType = mitsuba_oidn
    return module


def denoiser_name() -> str:
    """The name of the denoiser, with its version."""
    return f"oidn {require_extra().oidn_version()}"


def denoised_radiance(samples: Columns, window: Window) -> np.ndarray:
    """The radiance of ``samples`` of a window without most of its noise, float32 (N, 3).

    See :meth:`potmesil_mi.PointSamples.denoised`.
    """
    if samples.albedo is None or samples.normal is None:
        raise ValueError(
            "albedo, normal: the samples have none and cannot be denoised; render them with "
            "sampling=Sampling(features=True)"
        )
    oidn = require_extra()
    albedo = np.maximum(samples.albedo, LEAST_ALBEDO)
    albedo[~_has_surface(samples)] = 1
    groups = Groups.of(samples, window.pixel_of(samples.x, samples.y), albedo)
    blend = Blend.left_alone(groups)
    first = _first_image(groups, window)
    is_first = first.ravel()[groups.pixel] == np.arange(len(groups.pixel))
    image, new = first, np.flatnonzero(is_first)
    rest = np.flatnonzero(~is_first & groups.is_known)
    for _ in track(range(MOST_SURFACES), LABEL):
        denoised = _denoised(oidn, groups, image)
        blend.put(denoised, groups, image, new)
        found, beside = _beside(groups, image, denoised, rest)
        for shown, new in _more_images(groups, first, rest[found]):
            denoised.reshape(-1, 3)[groups.pixel[new]] = beside[np.searchsorted(rest, new)]
            blend.put(denoised, groups, shown, new)
        rest = rest[~found]
        if len(rest) <= LEAST_SHOWN * window.size:
            break
        image, new = next(_more_images(groups, first, rest))
        rest = np.setdiff1d(rest, new)
    return blend.radiance(groups, samples.rgb, albedo)


def _has_surface(columns: Columns) -> np.ndarray:
    """Which samples show a surface that can be denoised, bool (N,): not the sky, lamps or media."""
    assert columns.normal is not None
    return np.asarray(columns.normal.any(axis=1))


# ---------------------------------------------------------------- groups


@dataclasses.dataclass(frozen=True)
class Groups:
    """G groups of samples: those of a pixel that show the same surface.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``number``                    int64 (N,), which of them each sample belongs to
    ``pixel``                     int64 (G,), its pixel in the window of the samples
    ``seen``, ``weight``          float64 (G,), sum of the weights of its visible samples, and of
                                  all of them
    ``irradiance``                float64 (G, 3), sum of their radiance over that of their albedo
    ``variance``                  float64 (G,), of that ratio, as samples of independent noise
                                  have it, summed over R, G and B; NaN for a single sample
    ``normal``                    float64 (G, 3), mean normal
    ``grey``                      float64 (G, 3), what stands for its albedo, which is not in its
                                  irradiance: a grey that its neighbours do not have
    ``kind``                      int64 (G,), one number for each surface, and others for its images
    ``is_known``                  bool (G,), whether it can be denoised
    ============================  ==========================================================
    """

    number: np.ndarray
    pixel: np.ndarray
    seen: np.ndarray
    weight: np.ndarray
    irradiance: np.ndarray
    variance: np.ndarray
    normal: np.ndarray
    grey: np.ndarray
    kind: np.ndarray
    is_known: np.ndarray

    @classmethod
    def of(cls, columns: Columns, pixel: np.ndarray, albedo: np.ndarray) -> Groups:
        """The groups of samples in pixels, int64 (N,), with an ``albedo`` > 0, (N, 3)."""
        assert columns.normal is not None
        known = _has_surface(columns)
        kind = _kinds(columns, known)
        of, first = grouped(pixel * (int(kind.max()) + 1) + kind)
        count, weight = len(first), columns.weight.astype(np.float64)

        def summed(values: np.ndarray, weight: np.ndarray = weight) -> np.ndarray:
            sums = [np.bincount(of, weight * column, count) for column in values.T]
            return np.stack(sums, axis=1)

        total, size = np.bincount(of, weight, count), np.bincount(of, minlength=count)
        reflected = summed(albedo)
        irradiance = summed(columns.rgb) / reflected
        apart = columns.rgb - albedo * irradiance[of]
        variance = (summed(np.square(apart), np.square(weight)) / np.square(reflected)).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            variance *= np.where(size > 1, size / (size - 1), np.nan)
        return cls(
            number=of,
            pixel=pixel[first],
            seen=np.bincount(of, weight * (columns.layer == 0), count),
            weight=total,
            irradiance=irradiance,
            variance=variance,
            normal=summed(columns.normal) / total[:, None],
            grey=np.repeat(_greys(columns.surface[first])[:, None], 3, axis=1),
            kind=kind[first],
            is_known=known[first],
        )


def _greys(surface: np.ndarray) -> np.ndarray:
    """A grey of its own for each id, from 1/2 to 1, far from those of the next ones."""
    return 1 - (surface * GOLDEN_SECTION) % 1 / 2


def _kinds(columns: Columns, known: np.ndarray) -> np.ndarray:
    """Numbers from 0, int64 (N,), of what samples show.

    A thing and its image in a mirror are apart, and so is the back of a lamp from its front.
    """
    surface, _ = grouped(columns.surface)
    images = np.zeros(len(surface), bool) if columns.through is None else columns.through > 0
    return np.asarray((surface * 2 + images) * 2 + known)


# ---------------------------------------------------------------- images


def _first_image(groups: Groups, window: Window) -> np.ndarray:
    """The group that is seen most of in each pixel, int64 (H, W).

    A pixel that has no sample shows what the nearest one does.
    """
    order = np.lexsort([-groups.weight, -groups.seen, groups.pixel])
    pixel = groups.pixel[order]
    begins = np.diff(pixel, prepend=-1) != 0
    first = np.full(window.shape, -1)
    first.ravel()[pixel[begins]] = order[begins]
    if (first < 0).any():
        nearest = scipy.ndimage.distance_transform_edt(
            first < 0, return_distances=False, return_indices=True
        )
        first = first[tuple(nearest)]
    return first


def _more_images(
    groups: Groups, first: np.ndarray, rest: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The ``first`` image with groups of the ``rest`` in it, one of a pixel in each; and these."""
    rest = rest[np.lexsort([-groups.weight[rest], -groups.seen[rest], groups.pixel[rest]])]
    place = np.arange(len(rest))
    begins = np.diff(groups.pixel[rest], prepend=-1) != 0
    place -= np.maximum.accumulate(np.where(begins, place, 0))
    for number in range(int(place.max(initial=-1)) + 1):
        new = rest[place == number]
        shown = first.copy()
        shown.ravel()[groups.pixel[new]] = new
        yield shown, new


def _denoised(oidn: ModuleType, groups: Groups, shown: np.ndarray) -> np.ndarray:
    """The denoised irradiance of the groups that an image shows, float64 (H, W, 3)."""
    colour, albedo, normal = (
        np.ascontiguousarray(values[shown], np.float32)
        for values in (groups.irradiance, groups.grey, groups.normal)
    )
    result = oidn.denoise(colour, albedo, normal, hdr=True, clean_aux=True)
    return np.asarray(result).astype(np.float64)


def _beside(
    groups: Groups, first: np.ndarray, denoised: np.ndarray, rest: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What is ``denoised``, (H, W, 3), of the surfaces of groups in the pixels beside theirs.

    ``first`` is the image that it is of. Returns which of the groups ``rest`` have their surface
    within ``BESIDE`` pixels, bool (R,), and its irradiance there, float64 (R, 3).
    """
    height, width = first.shape
    row, column = np.divmod(groups.pixel[rest], width)
    sums, total = np.zeros((len(rest), 3)), np.zeros(len(rest))
    steps = range(-BESIDE, BESIDE + 1)
    for down, across in itertools.product(steps, steps):
        there = np.clip(row + down, 0, height - 1), np.clip(column + across, 0, width - 1)
        other = first[there]
        alike = np.maximum((groups.normal[other] * groups.normal[rest]).sum(axis=1), 0)
        weight = np.where(groups.kind[other] == groups.kind[rest], alike**SHARPNESS, 0)
        weight *= np.exp(-(down**2 + across**2) / 2)
        total += weight
        sums += weight[:, None] * denoised[there]
    found = total > LEAST_ALIKE
    return found, sums / np.maximum(total, TINY)[:, None]


# ---------------------------------------------------------------- what is denoised and what is left


@dataclasses.dataclass(frozen=True)
class Blend:
    """What becomes of each of G groups; the head of this file says how the weights are found.

    ============================  ==========================================================
    Field                         Meaning
    ============================  ==========================================================
    ``irradiance``                float64 (G, 3), denoised
    ``own``                       float64 (G,), weight of the mean of the group's samples, 0 to 1
    ``detail``                    float64 (G,), weight of what each sample differs by from that
    ============================  ==========================================================
    """

    irradiance: np.ndarray
    own: np.ndarray
    detail: np.ndarray

    @classmethod
    def left_alone(cls, groups: Groups) -> Blend:
        """All as it is."""
        ones = np.ones(len(groups.pixel))
        return cls(groups.irradiance.copy(), ones, ones.copy())

    def put(self, denoised: np.ndarray, groups: Groups, shown: np.ndarray, new: np.ndarray) -> None:
        """Blend in what is ``denoised``, (H, W, 3), for the groups ``new`` of those ``shown``."""
        new = new[groups.is_known[new]]
        difference, variance, bias = _around(denoised, groups, shown, new)
        own = bias / np.maximum(bias + variance, TINY)
        detail = 1 - np.minimum(difference / np.maximum(variance * NOISE, TINY), 1)
        pixel = groups.pixel[new]
        self.irradiance[new] = denoised.reshape(-1, 3)[pixel]
        self.own[new] = own.ravel()[pixel]
        self.detail[new] = np.maximum(own, detail).ravel()[pixel]

    def radiance(self, groups: Groups, rgb: np.ndarray, albedo: np.ndarray) -> np.ndarray:
        """The radiance of samples, float32 (N, 3), that had ``rgb`` and have an ``albedo``."""
        own, detail = self.own[:, None], self.detail[:, None]
        mean = (1 - own) * self.irradiance + own * groups.irradiance
        # rgb is albedo times the irradiance of its group, and the rest, of which a part is kept.
        result = (mean - detail * groups.irradiance)[groups.number] * albedo
        result += detail[groups.number] * rgb
        kept = (own == 1).ravel()[groups.number]
        result[kept] = rgb[kept]
        return result.astype(np.float32)


def _around(
    denoised: np.ndarray, groups: Groups, shown: np.ndarray, new: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean squared difference to what is ``denoised``, variance, and bias around pixels, (H, W).

    They are means of the groups ``new`` of those ``shown``, and relative to the irradiance, so that
    dark surfaces count beside bright ones.
    """
    scale = np.square(denoised).sum(axis=2)
    scale += np.square(DARKEST) * scale.mean() + TINY
    difference = np.square(groups.irradiance[shown] - denoised).sum(axis=2) / scale
    variance = groups.variance[shown] / scale
    counts = np.zeros(shown.shape, bool)
    counts.ravel()[groups.pixel[new]] = True
    counts &= np.isfinite(variance)
    difference, variance = (np.where(counts, values, 0) for values in (difference, variance))
    excess = difference - variance
    share, *sums = (
        scipy.ndimage.gaussian_filter(values, REACH)
        for values in (counts.astype(np.float64), excess, np.square(excess), difference, variance)
    )
    mean, square, difference, variance = (values / np.maximum(share, TINY) for values in sums)
    count = np.maximum(4 * np.pi * np.square(REACH) * share, 1)
    error = np.sqrt(np.maximum(square - np.square(mean), 0) / count)
    return difference, variance, np.maximum(mean - SURE * error, 0)
