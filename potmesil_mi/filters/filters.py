"""Special-effect filters: what is done to the finished picture.

Potmesil & Chakravarty (1981) name them as extensions: star and diffraction filters convolved with
the picture, uniform defocusing, fade in and out. Pictures are linear RGB or RGBA, with colours
multiplied by alpha as Mitsuba's films give them.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
import scipy.fft
import scipy.sparse
import scipy.special

from .._spec import read as described, written as describe
from .._validation import require_number, require_whole
from ..optics.lens import ThinLens
from ..optics.disc import disc_kernel

LEAST_WIDTH = 1.5
"""Width of a ray of :class:`Star` in pixels, at half its height, that is sampled without dots."""

GRID = 2048
"""Elements on a side of the transform of an aperture, what is around the aperture included."""

LEAST_PUPIL = 64
"""Elements across an aperture, at least."""

JOIN = 3 * GRID // 16
"""Radius, in elements of the transform, about which the far field is continued from itself."""


class Filter(Protocol):
    """What is done to a finished picture; any function of these arguments can be one."""

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """The picture that becomes of ``picture``, float (H, W, 3 or 4), which stays as it is.

        ``lens`` is what it was taken with, ``pixels_per_mm`` the number of pixels in a millimetre
        of its film: the whole film, of which the picture may be a part, is
        ``lens.frame_width * pixels_per_mm`` pixels wide.
        """
        ...


class _Named:
    """A filter that has a text, which :func:`parse_filter` reads."""

    name: ClassVar[str]

    def __str__(self) -> str:
        values = {
            field.name: getattr(self, field.name)
            for field in _parameters(type(self))
            if getattr(self, field.name) != field.default
        }
        return describe(self.name, values)


@dataclasses.dataclass(frozen=True)
class Star(_Named):
    """Rays around bright spots, as of a glass with engraved lines before the lens.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``points``                    number of rays, 1 to 64 (default 4)
    ``length``                    of a ray, as a share of the frame's width; 0 to 2 (default
                                  0.1). Light falls off along it as (1 - distance/length)^2
    ``threshold``                 what is brighter, in its brightest channel, is spread; >= 0
                                  (default 1)
    ``rotation``                  degrees by which the star is turned, anticlockwise; at 0
                                  (default) a ray points upwards
    ``strength``                  share of the light above ``threshold`` that goes into the
                                  rays, 0 to 1 (default 0.5)
    ``width``                     of a ray at half its height, as a share of the frame's
                                  width; 0 to 1 (default 0.001), but no less than 1.5 pixels
    ============================  ==========================================================

    The light is taken from the bright spots, none is added; that of a spot keeps its hue. Alpha
    stays.
    """

    points: int = 4
    length: float = 0.1
    threshold: float = 1.0
    rotation: float = 0.0
    strength: float = 0.5
    width: float = 0.001

    name: ClassVar[str] = "star"

    def __post_init__(self) -> None:
        require_whole("points", self.points, 1, 64)
        require_number("length", self.length, 0, 2)
        require_number("threshold", self.threshold, 0)
        require_number("rotation", self.rotation)
        require_number("strength", self.strength, 0, 1)
        require_number("width", self.width, 0, 1)

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :class:`Filter`."""
        light = self.strength * _light_above(self.threshold, picture)
        if not light.any():
            return picture.copy()
        frame = _frame_width(lens, pixels_per_mm)
        kernel = self.kernel(frame, picture.shape[:2])
        return _with_light_moved(picture, light, kernel[..., None])

    def kernel(self, frame: float, size: tuple[int, int]) -> np.ndarray:
        """The star of one point, float64 (2K+1, 2L+1), of sum 1, on a frame of so many pixels.

        ``size``, rows and columns of the picture, bounds it.
        """
        length = self.length * frame
        sigma = max(self.width * frame, LEAST_WIDTH) / math.sqrt(8 * math.log(2))
        y, x = _offsets(math.ceil(length + 4 * sigma), size)
        kernel = np.zeros((y.size, x.size))
        for k in range(self.points):
            angle = math.radians(self.rotation) + 2 * math.pi * k / self.points
            right, down = -math.sin(angle), -math.cos(angle)
            along, across = x * right + y * down, x * down - y * right
            kernel += np.exp(-0.5 * (across / sigma) ** 2) * _ray(along, length, sigma)
        return kernel / kernel.sum()


@dataclasses.dataclass(frozen=True)
class Diffraction(_Named):
    r"""The far field of the aperture: what diffraction makes of each point in focus.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``scale``                     size of the pattern, 1 (default) as in nature: there it is
                                  tiny but for the spikes of an aperture with straight blades
                                  around very bright spots. 0.01 to 1000
    ``threshold``                 what is brighter, in its brightest channel, is spread; >= 0
                                  (default 0: everything, as in nature)
    ``strength``                  share of that light that is spread, 0 to 1 (default 1)
    ``wavelengths``               of red, green and blue in nm, 100 to 10000 each
                                  (default 610, 550, 465)
    ``bandwidth``                 of each of the three in nm, from 0 (default 80); less than
                                  twice each wavelength
    ``samples``                   wavelengths in each band, 1 to 64 (default 9); more give
                                  smoother streaks
    ``aperture``                  what has ``transmission(size)``, as
                                  :class:`potmesil_mi.Polygon` has; by default the lens's own
    ============================  ==========================================================

    The intensity at x millimetres on the film is :math:`|\hat T(x / (2 \lambda N))|^2`, with the
    Fourier transform :math:`\hat T` of the aperture, its radius the unit of length, and
    N = (distance of the film) / (diameter of the lens); the first dark ring of a round one has the
    radius 1.22 lambda N. It is integrated over each pixel. Beyond what the transform covers, some
    hundred lambda N, it goes on as it does in its last octave, with the third power of the
    distance. Each channel's pattern sums to 1 within the picture's reach. Alpha stays.

    An aperture that diffracts by itself, such as ``Lommel``, counts here as what it lets through:
    its pattern in focus would be there twice. Raises ``ValueError`` for a closed aperture.
    """

    scale: float = 1.0
    threshold: float = 0.0
    strength: float = 1.0
    wavelengths: tuple[float, float, float] = (610.0, 550.0, 465.0)
    bandwidth: float = 80.0
    samples: int = 9
    aperture: Any = None

    name: ClassVar[str] = "diffraction"

    def __post_init__(self) -> None:
        require_number("scale", self.scale, 0.01, 1000)
        require_number("threshold", self.threshold, 0)
        require_number("strength", self.strength, 0, 1)
        wavelengths = _three("wavelengths", self.wavelengths, 100, 10_000)
        object.__setattr__(self, "wavelengths", wavelengths)
        require_number("bandwidth", self.bandwidth, 0)
        if self.bandwidth >= 2 * min(wavelengths):
            raise ValueError(
                f"bandwidth={self.bandwidth}: must be less than twice each of the wavelengths, "
                f"{wavelengths}"
            )
        require_whole("samples", self.samples, 1, 64)
        if self.aperture is not None and not hasattr(self.aperture, "transmission"):
            raise TypeError(f"aperture={self.aperture!r}: must have transmission(size), or be None")

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :class:`Filter`."""
        light = self.strength * _light_above(self.threshold, picture)
        if not light.any():
            return picture.copy()
        kernel = self.kernel(lens, pixels_per_mm, picture.shape[:2])
        return _with_light_moved(picture, light, kernel)

    def kernel(self, lens: ThinLens, pixels_per_mm: float, size: tuple[int, int]) -> np.ndarray:
        """The pattern of one point, float64 (2H-1, 2W-1, 3), for pictures (H, W) = ``size``."""
        diameter = float(lens.lens_diameter)
        if not diameter > 0:
            raise ValueError(f"f_number={lens.f_number}: a closed aperture has no diffraction")
        # Pixels that a frequency of one period per radius of the aperture is from the middle.
        reach = self.scale * 2 * float(lens.film_distance) / diameter * pixels_per_mm * 1e-6
        bands = np.array(self.wavelengths)[:, None] + self.bandwidth * (
            (np.arange(self.samples) + 0.5) / self.samples - 0.5
        )
        aperture, squeeze = _aperture(lens)
        aperture = aperture if self.aperture is None else self.aperture
        pattern, step = far_field(aperture.transmission, reach * squeeze * bands.max())
        parts = _parts(pattern)
        channels = [
            sum(
                _on_pixels(parts, step * reach * nm, step * reach * squeeze * nm, size)
                for nm in band.tolist()
            )
            for band in bands
        ]
        kernel = np.maximum(np.stack(channels, axis=-1, dtype=np.float64), 0)
        # The pattern of what only takes light away is symmetric about its middle.
        kernel = np.concatenate([kernel[:0:-1, ::-1], kernel])
        return kernel / kernel.sum(axis=(0, 1))


@dataclasses.dataclass(frozen=True)
class Defocus(_Named):
    """The whole picture out of focus by the same, whatever its depth.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``radius``                    of the circle that becomes of a point, as a share of the
                                  frame's width; 0 to 1
    ============================  ==========================================================

    Colours and alpha alike.
    """

    radius: float

    name: ClassVar[str] = "defocus"

    def __post_init__(self) -> None:
        require_number("radius", self.radius, 0, 1)

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :class:`Filter`."""
        height, width = picture.shape[:2]
        radius = self.radius * _frame_width(lens, pixels_per_mm)
        kernel = disc_kernel(radius, (0.5, 0.5), (width - 1, height - 1))
        blurred = _spread(picture, kernel[..., None] / kernel.sum())
        # A mean is no less than the least value, but for the rounding of transforms.
        return np.maximum(blurred, picture.min(axis=(0, 1)))


@dataclasses.dataclass(frozen=True)
class Fade(_Named):
    """The picture on its way to one colour, for fading in and out.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``amount``                    0, the picture, to 1, the colour
    ``color``                     linear RGB, >= 0 (default black)
    ============================  ==========================================================

    picture (1 - amount) + color amount. Alpha stays, and the colour is multiplied by it.
    """

    amount: float
    color: tuple[float, float, float] = (0.0, 0.0, 0.0)

    name: ClassVar[str] = "fade"

    def __post_init__(self) -> None:
        require_number("amount", self.amount, 0, 1)
        object.__setattr__(self, "color", _three("color", self.color, 0))

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :class:`Filter`."""
        faded = picture.copy()
        faded[..., :3] *= 1 - self.amount
        faded[..., :3] += np.multiply(self.color, self.amount) * picture[..., 3:].prod(
            axis=-1, keepdims=True
        )
        return faded


FILTERS: dict[str, type[Any]] = {kind.name: kind for kind in (Star, Diffraction, Defocus, Fade)}


def parse_filter(text: str) -> Filter:
    """The filter of a text such as ``star:points=6,length=0.1``.

    That is the name, and after a colon parameters with commas between; what has three values has
    slashes between, as in ``fade:amount=0.5,color=1/0.9/0.8``. ``str`` of a filter is such a text.
    Raises ``ValueError`` or ``TypeError`` that names what is unknown, missing or out of range.
    """
    name, values = described(text, "filter")
    kind = FILTERS.get(name)
    if kind is None:
        raise ValueError(f"filter={name!r}: must be one of {', '.join(FILTERS)}")
    fields = {field.name: field for field in _parameters(kind)}
    for key in values:
        if key not in fields:
            allowed = ", ".join(fields)
            raise ValueError(f"{key}: not a parameter of the filter {name}, which has {allowed}")
    for key, field in fields.items():
        if field.default is dataclasses.MISSING and key not in values:
            raise ValueError(f"filter={text!r}: needs {key}, as in {name}:{key}=0.5")
    return kind(**values)


def as_filters(filters: Iterable[Filter | str]) -> tuple[Filter, ...]:
    """Filters of filters and texts.

    Raises ``TypeError`` for what is neither, and for one alone, ``ValueError`` for a wrong text.
    """
    if isinstance(filters, str) or not isinstance(filters, Iterable):
        raise TypeError(f"filters={filters!r}: must be a list, such as ['star:points=6']")
    parsed = tuple(parse_filter(one) if isinstance(one, str) else one for one in filters)
    for one in parsed:
        if not callable(one) or isinstance(one, type):
            raise TypeError(
                f"filters: {one!r} must be a filter, such as Star(), or a text, such as 'star'"
            )
    return parsed


def apply_filters(
    picture: Any,
    filters: Sequence[Filter | str],
    lens: ThinLens,
    pixels_per_mm: float | None = None,
) -> np.ndarray:
    """The picture after each filter, in their order, float32 (H, W, 3 or 4).

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``picture``                   linear RGB (A), (H, W, 3 or 4); stays as it is. Values that
                                  are not finite count as 0
    ``filters``                   filters such as :class:`Star`, or their texts, see
                                  :func:`parse_filter`
    ``lens``                      what it was taken with; lengths are shares of its
                                  ``frame_width``
    ``pixels_per_mm``             pixels in a millimetre of film; by default as many as make
                                  the picture the whole frame
    ============================  ==========================================================

    Where the kernel of a filter goes beyond the picture, what is there is taken for the mean of
    what the kernel meets within; so uniform pictures stay uniform. Raises ``ValueError`` or
    ``TypeError`` that names the parameter.
    """
    filters = as_filters(filters)
    image = np.array(picture, dtype=np.float64)
    if image.ndim != 3 or image.shape[-1] not in (3, 4) or image.size == 0:
        raise ValueError(f"picture: has shape {image.shape}, must be (height, width, 3 or 4)")
    if not isinstance(lens, ThinLens):
        raise TypeError(f"lens={lens!r}: must be a ThinLens, such as samples.lens")
    if pixels_per_mm is None:
        pixels_per_mm = image.shape[1] / float(lens.frame_width)
    require_number("pixels_per_mm", pixels_per_mm, 0)
    image[~np.isfinite(image)] = 0
    for one in filters:
        filtered = np.asarray(one(image, lens, float(pixels_per_mm)))
        if filtered.shape != image.shape:
            raise ValueError(
                f"filters: {one!r} gave the shape {filtered.shape}, must be {image.shape}"
            )
        image = filtered
    return image.astype(np.float32)


def far_field(transmission: Any, reach: float) -> tuple[np.ndarray, float]:
    """The intensity of the Fraunhofer diffraction of an aperture, and the step of its grid.

    ``transmission`` gives it on a grid, as :meth:`potmesil_mi.Polygon.transmission` does. Returns
    a float32 array (2K+1, 2K+1), rows and columns of frequencies -K to K steps; a step is in
    periods per radius of the aperture. ``reach`` is the number of pixels that a frequency of 1
    is from the middle: steps are half a pixel or finer where the pattern has detail.
    """
    across = int(np.clip(GRID / max(reach, 1e-9), LEAST_PUPIL, GRID // 2)) // 2 * 2
    pupil = np.asarray(transmission(across), dtype=np.float32)
    if pupil.shape != (across, across):
        raise ValueError(
            f"aperture: transmission({across}) has shape {pupil.shape}, "
            f"must be ({across}, {across})"
        )
    if not (np.isfinite(pupil).all() and pupil.any()):
        raise ValueError("aperture: must be finite, and let light through somewhere")
    last = 2 * JOIN
    half = scipy.fft.rfft2(pupil, (GRID, GRID), workers=os.cpu_count())[:, : last + 1]
    half = half[np.arange(-last, last + 1)]
    right = half.real**2 + half.imag**2
    # Elements are means over squares, whose transform is divided out.
    square = np.sinc(np.arange(-last, last + 1) / GRID) ** 2
    pattern = np.concatenate([right[::-1, :0:-1], right], axis=1) / (square[:, None] * square)
    return (pattern / pattern.max()).astype(np.float32), across / (2 * GRID)


def _parts(pattern: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pattern up to :data:`JOIN`, and its last octave; the one fades into the other."""
    index = np.arange(len(pattern) // 2 + 1, dtype=np.float32)
    radius = np.maximum(np.hypot(index[:, None], index), 0.5) / JOIN
    octaves = np.clip(np.log2(radius), -1, 1)
    weight = np.cos(np.pi / 2 * octaves) ** 2
    inner = np.where(octaves < 0, 1 - weight, 0)
    # One quarter is like the others.
    last = len(pattern) // 2
    octave, inner = (np.pad(part, ((last, 0), (last, 0)), "reflect") for part in (weight, inner))
    octave *= pattern
    inner *= pattern
    return inner, octave


def _on_pixels(
    parts: tuple[np.ndarray, np.ndarray], down: float, across: float, size: tuple[int, int]
) -> np.ndarray:
    """Integrals of a pattern over pixels, rows 0 to H-1 and columns -(W-1) to W-1 from its middle.

    ``down`` and ``across`` are the pixels between elements of its ``parts``. The last octave is
    continued: edges, straight or curved, send light of 1/r^2 between r and r + dr into their
    directions, so that I(2r) = I(r)/8.
    """
    height, width = size
    inner, octave = parts
    middle = len(inner) // 2
    inner = inner[middle - JOIN : middle + JOIN + 1, middle - JOIN : middle + JOIN + 1]
    result = np.zeros((height, 2 * width - 1), dtype=np.float32)
    _add_on_pixels(result, inner, down, across, 1.0)
    k = 0
    while JOIN / 2 * min(down, across) * 2**k < math.hypot(height, width):
        _add_on_pixels(result, octave, down * 2**k, across * 2**k, 0.5**k)
        k += 1
    return result


def _add_on_pixels(
    result: np.ndarray, pattern: np.ndarray, down: float, across: float, factor: float
) -> None:
    """Add ``factor`` times the light of a pattern, interpolated between elements, to pixels."""
    height, width = result.shape[0], (result.shape[1] + 1) // 2
    last = len(pattern) // 2
    rows = min(last, math.ceil(height / down) + 2)
    columns = min(last, math.ceil(width / across) + 2)
    part = pattern[last - rows : last + rows + 1, last - columns : last + columns + 1]
    bottom = min(height - 1, math.ceil((rows + 2) * down))
    side = min(width - 1, math.ceil((columns + 2) * across))
    by_row = _shares(rows, down, 0, bottom) @ part
    values = _shares(columns, across, -side, side) @ np.ascontiguousarray(by_row.T)
    result[: bottom + 1, width - 1 - side : width + side] += factor * values.T


def _shares(last: int, step: float, first_pixel: int, last_pixel: int) -> scipy.sparse.csr_array:
    """Shares that pixels have of elements -last to last, which are ``step`` pixels apart.

    Between elements a pattern is interpolated by R. Keys' cubic convolution (1981), which does not
    blur it as straight lines would.
    """
    middle = np.arange(-last, last + 1) * step
    left = np.floor(middle - 2 * step + 0.5).astype(int)
    edges = left[:, None] + np.arange(math.ceil(4 * step) + 3) - 0.5
    shares = np.diff(_integral_of_cubic((edges - middle[:, None]) / step), axis=-1)
    pixels = left[:, None] + np.arange(shares.shape[1])
    elements = np.broadcast_to(np.arange(2 * last + 1)[:, None], pixels.shape)
    inside = (pixels >= first_pixel) & (pixels <= last_pixel) & (shares != 0)
    return scipy.sparse.csr_array(
        (
            shares[inside].astype(np.float32),
            (pixels[inside] - first_pixel, elements[inside]),
        ),
        shape=(last_pixel - first_pixel + 1, 2 * last + 1),
    )


def _integral_of_cubic(t: np.ndarray) -> np.ndarray:
    """Integral from 0 to ``t`` of Keys' kernel, whose elements are 1 apart."""
    u = np.minimum(np.abs(t), 2)
    near = u * (1 + u * u * (3 * u / 8 - 5 / 6))
    far = u * (2 + u * (-2 + u * (5 / 6 - u / 8))) - 1 / 6
    return np.copysign(np.where(u < 1, near, far), t)


def _aperture(lens: ThinLens) -> tuple[Any, float]:
    """The aperture of a lens, and how many times as tall as wide it is."""
    return lens.aperture, float(lens.squeeze)


def _frame_width(lens: ThinLens, pixels_per_mm: float) -> float:
    """Width in pixels of the whole frame."""
    return float(lens.frame_width) * pixels_per_mm


def _light_above(threshold: float, picture: np.ndarray) -> np.ndarray:
    """RGB of what is above ``threshold`` in each pixel's brightest channel, of the same hue."""
    rgb = np.maximum(picture[..., :3], 0)
    brightest = rgb.max(axis=-1, keepdims=True)
    return rgb * np.maximum(1 - threshold / np.where(brightest > 0, brightest, np.inf), 0)


def _with_light_moved(picture: np.ndarray, light: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """The picture with ``light`` (H, W, 3) taken from it and put back spread by a kernel."""
    moved = picture.copy()
    moved[..., :3] += np.maximum(_spread(light, kernel), 0) - light
    return moved


def _spread(picture: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Convolution with a kernel (2K+1, 2L+1, C or 1), divided by what of it is in the picture."""
    height, width = picture.shape[:2]
    down, across = kernel.shape[0] // 2, kernel.shape[1] // 2
    # What wraps around must not reach the picture: so much is empty beyond it.
    shape = tuple(scipy.fft.next_fast_len(n, real=True) for n in (height + down, width + across))
    spread = np.empty_like(picture)
    workers = os.cpu_count()
    for channel in range(picture.shape[-1]):
        if channel < kernel.shape[-1]:
            wrapped = np.zeros(shape)
            wrapped[: 2 * down + 1, : 2 * across + 1] = kernel[..., channel]
            wrapped = np.roll(wrapped, (-down, -across), axis=(0, 1))
            response = scipy.fft.rfft2(wrapped, workers=workers)
            inside = _share_inside(kernel[..., channel], (height, width))
        light = scipy.fft.rfft2(picture[..., channel], shape, workers=workers)
        light = scipy.fft.irfft2(light * response, shape, workers=workers)
        spread[..., channel] = light[:height, :width] / inside
    return spread


def _share_inside(kernel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """How much of the kernel around each pixel meets a picture of ``size``, (H, W)."""
    integral = np.zeros((kernel.shape[0] + 1, kernel.shape[1] + 1))
    integral[1:, 1:] = kernel.cumsum(axis=0).cumsum(axis=1)
    for axis, n in enumerate(size):
        reach = kernel.shape[axis] // 2
        place = np.arange(n)
        above = np.minimum(place + reach + 1, 2 * reach + 1)
        below = np.maximum(place - n + 1 + reach, 0)
        integral = integral.take(above, axis) - integral.take(below, axis)
    return integral


def _offsets(reach: int, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Rows (N, 1) and columns (1, M) of a kernel, from its middle, as far as a picture has any."""
    down, across = (min(reach, n - 1) for n in size)
    return np.arange(-down, down + 1.0)[:, None], np.arange(-across, across + 1.0)[None, :]


def _ray(along: np.ndarray, length: float, sigma: float) -> np.ndarray:
    """Brightness along a ray of ``length`` pixels, its beginning as soft as its sides."""
    if length == 0:
        return np.exp(-0.5 * (along / sigma) ** 2)
    fall = np.clip(1 - along / length, 0, 1) ** 2
    return fall * scipy.special.ndtr(along / sigma)


def _parameters(kind: type[Any]) -> list[dataclasses.Field[Any]]:
    """The parameters of a filter that a text can give."""
    return [field for field in dataclasses.fields(kind) if field.name != "aperture"]


def _three(
    name: str, values: Any, least: float, most: float = math.inf
) -> tuple[float, float, float]:
    """Three numbers, each checked."""
    if not isinstance(values, (tuple, list, np.ndarray)):
        raise TypeError(f"{name}={values!r}: must be three numbers")
    if len(values) != 3:
        raise ValueError(f"{name}={values!r}: must be three numbers")
    for value in values:
        require_number(name, value, least, most)
    red, green, blue = (float(value) for value in values)
    return red, green, blue
