"""The far field of an aperture, spread over the picture."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Protocol, runtime_checkable

import numpy as np

from .._threads import processors
from .._validation import require_number, require_whole, shown
from ..optics.lens import ThinLens
from .base import Filter
from .spread import light_above, three_numbers, with_light_moved

if TYPE_CHECKING:
    import scipy.sparse

GRID = 2048
"""Elements on a side of the transform of an aperture, what is around the aperture included."""

LEAST_PUPIL = 64
"""Elements across an aperture, at least."""

JOIN = 3 * GRID // 16
"""Radius, in elements of the transform, about which the far field is continued from itself."""


@runtime_checkable
class Opening(Protocol):
    """What light goes through, as :class:`potmesil_mi.Aperture` is."""

    def transmission(self, size: int) -> np.ndarray:
        """What it lets through, (size, size), 0 to 1, as of :class:`potmesil_mi.Aperture`."""


@dataclasses.dataclass(frozen=True)
class Diffraction(Filter):
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
    aperture: Opening | None = dataclasses.field(default=None, metadata={"spec": False})

    name: ClassVar[str] = "diffraction"

    def __post_init__(self) -> None:
        require_number("scale", self.scale, 0.01, 1000)
        require_number("threshold", self.threshold, 0)
        require_number("strength", self.strength, 0, 1)
        wavelengths = three_numbers("wavelengths", self.wavelengths, 100, 10_000)
        object.__setattr__(self, "wavelengths", wavelengths)
        require_number("bandwidth", self.bandwidth, 0)
        if self.bandwidth >= 2 * min(wavelengths):
            raise ValueError(
                f"bandwidth={self.bandwidth}: must be less than twice each of the wavelengths, "
                f"{wavelengths}"
            )
        require_whole("samples", self.samples, 1, 64)
        if self.aperture is not None and not isinstance(self.aperture, Opening):
            raise TypeError(
                f"aperture={shown(self.aperture)}: must have transmission(size), or be None"
            )

    needs_focal_length: ClassVar[bool] = True

    def __call__(self, picture: np.ndarray, lens: ThinLens, pixels_per_mm: float) -> np.ndarray:
        """See :meth:`Filter.__call__`."""
        light = self.strength * light_above(self.threshold, picture)
        if not light.any():
            return picture.copy()
        kernel = self.kernel(lens, pixels_per_mm, picture.shape[:2])
        return with_light_moved(picture, light, kernel)

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
        aperture = lens.aperture if self.aperture is None else self.aperture
        squeeze = float(lens.squeeze)
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


def far_field(transmission: Callable[[int], np.ndarray], reach: float) -> tuple[np.ndarray, float]:
    """The intensity of the Fraunhofer diffraction of an aperture, and the step of its grid.

    ``transmission`` gives it on a grid, as :meth:`potmesil_mi.Polygon.transmission` does. Returns
    a float32 array (2K+1, 2K+1), rows and columns of frequencies -K to K steps; a step is in
    periods per radius of the aperture. ``reach`` is the number of pixels that a frequency of 1
    is from the middle: steps are half a pixel or finer where the pattern has detail.
    """
    import scipy.fft

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
    half = scipy.fft.rfft2(pupil, (GRID, GRID), workers=processors())[:, : last + 1]
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
    import scipy.sparse

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
