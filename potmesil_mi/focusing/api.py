"""The focus stage: a picture through the lens, from point samples.

Section 3.2 of Potmesil & Chakravarty (1981). Methods form the picture on subpixels, and the film
brings it to pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

from .. import _backend as jit
from ..filters.base import FilterFunction
from ..optics.lens import ThinLens
from ..optics.psf import PointSpreadFunction
from ..optics.telecentric import TelecentricLens
from ..samples.point_samples import PointSamples
from .film import ReconstructionFilter
from .methods import Method, MethodName, method_of
from .session import form_picture, memo_of


def focus(
    samples: PointSamples,
    lens: ThinLens | TelecentricLens | None = None,
    *,
    method: Method | MethodName = "layered",
    psf: PointSpreadFunction | None = None,
    lens_points: int | None = None,
    tables: int | None = None,
    inverse_square: bool | None = None,
    squares: int | None = None,
    rfilter: ReconstructionFilter | None = None,
    alpha: bool = False,
    filters: Sequence[FilterFunction | str] = (),
    tiles: tuple[int, int] | None = None,
) -> jit.TensorXf:
    """The picture that ``lens`` forms of ``samples``.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples, of :func:`potmesil_mi.render_samples` or a
                                  file
    ``lens``                      any lens, in scene units of any size; the samples' own by
                                  default. The field of view stays that of the samples: the
                                  picture is that of a ``thinlens`` with this
                                  ``aperture_radius`` and ``focus_distance`` at their place.
                                  For samples of an orthographic camera a
                                  :class:`potmesil_mi.TelecentricLens`; what hit nothing then
                                  counts as just behind the farthest surface, and behind the
                                  focused plane
    ``method``                    ``layered`` (default): what is visible, fast.
                                  ``lightfield``: the same with more lens points, on a finer
                                  raster; the one to trust. ``paper``: equation 20, which
                                  knows no occlusion. Or a method with its options, such as
                                  ``Layered(lens_points=64)``. Options below that it does
                                  not have are checked and ignored
    ``psf``                       how the light of a point is spread; by default the lens's
                                  ``aperture``. One that is no :class:`potmesil_mi.Aperture`
                                  ``layered`` and ``lightfield`` use for what the whole lens
                                  sees; what only parts of it see they spread uniformly
    ``lens_points``               ``layered``, ``lightfield``: points of the lens from which
                                  visibility is found, 1 to 4096 (default 32 and 128; with
                                  vignetting 128)
    ``tables``                    ``paper``: number of depths, equally spaced from the nearest
                                  to the farthest sample, with a table each; 2 to 10000
                                  (default 73, the paper's)
    ``inverse_square``            ``paper``: light falls off as 1/z^2 (default, the paper's);
                                  a ray-traced lens does without, and so does a telecentric
                                  one
    ``squares``                   each pixel is evaluated on so many subpixels on a side, 1 to
                                  16 (default: ``layered`` 1, the others, and with
                                  diffraction all, 2; ``layered`` 2 and ``lightfield`` 4 in
                                  crowded scenes; but no more than the root of the samples
                                  a pixel, except in ``paper``)
    ``rfilter``                   the film's reconstruction filter; box by default
    ``alpha``                     add a fourth channel with the coverage
    ``filters``                   special effects, applied to the finished picture in their
                                  order: :class:`potmesil_mi.Star`, ``Diffraction``,
                                  ``Defocus``, ``Fade``, or texts such as ``star:points=6``
    ``tiles``                     form the picture by so many columns and rows of tiles, one
                                  after the other (default: as a whole). It is the same, up to
                                  the rounding of sums, takes less memory and longer, and nothing
                                  is kept for the next focus
    ============================  ==========================================================

    What is found out about samples is kept as long as they are, up to 2 GiB, for the next focus;
    :class:`potmesil_mi.FocusSession` lets one bound and clear it. Returns linear RGB (A), (height,
    width, 3 or 4), of the samples' crop window. Raises ``ValueError`` or ``TypeError`` that names
    the parameter, ``NotImplementedError`` for a lens whose parameters have gradients enabled,
    ``RuntimeError`` while a scalar variant is set. By ``tiles`` neither a method of one's own nor,
    except with ``paper``, samples of an exposure in which something moves can be formed.
    """
    chosen = method_of(
        method,
        lens_points=lens_points,
        tables=tables,
        inverse_square=inverse_square,
        squares=squares,
    )
    if tiles is not None:
        from .tiles.forming import focus_by_tiles

        return focus_by_tiles(samples, lens, chosen, tiles, psf, rfilter, alpha, filters)
    return form_picture(samples, lens, chosen, memo_of(samples), psf, rfilter, alpha, filters)
