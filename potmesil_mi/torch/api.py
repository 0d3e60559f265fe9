"""The focus stage as a function of torch's tensors."""

from __future__ import annotations

from typing import Any

import torch

from .._validation import require_choice, require_flag
from ..focusing.film import ReconstructionFilter
from ..focusing.methods import Method, MethodName, method_of
from ..optics.aperture import Aperture
from ..optics.disc import Disc
from ..optics.lens import FULL_FRAME_WIDTH
from ..samples.image_layers import HIDDEN, Hidden
from .arguments import for_each_picture, require_pictures
from .autograd import Focus
from .forming import NAMES, Options


def focus(
    rgb: torch.Tensor,
    depth: torch.Tensor,
    focus_distance: torch.Tensor | float,
    f_number: torch.Tensor | float,
    *,
    focal_length: torch.Tensor | float,
    frame_width: float = FULL_FRAME_WIDTH,
    millimeters_per_unit: float = 1.0,
    aperture: Aperture | str = Disc(),  # noqa: B008
    method: Method | MethodName = "layered",
    lens_points: int | None = None,
    squares: int | None = None,
    rfilter: ReconstructionFilter | None = None,
    antialiased: bool = False,
    hidden: Hidden = "farther",
) -> torch.Tensor:
    """Pictures through a thin lens, of sharp ones and their depth; differentiable.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``rgb``                       floats (B, 3, H, W), sharp pictures in linear sRGB
    ``depth``                     floats (B, 1, H, W), depth in scene units along the camera's
                                  axis, > 0; ``inf`` where nothing is
    ``focus_distance``            in scene units, beyond the focal length; ``inf`` is allowed
    ``f_number``                  > 0; ``inf`` is a pinhole
    ``focal_length``              in millimetres, > 0. These three are numbers or tensors, of
                                  one number, or of (B,), one for each picture
    ``frame_width``               width of the film in millimetres, > 0 (default 36): with the
                                  focal length it gives the field of view of the pictures
    ``millimeters_per_unit``      size of a scene unit, > 0 (default 1: distances in
                                  millimetres; 1000 for depth in metres)
    ``aperture``                  its shape, see :class:`potmesil_mi.ThinLens`
    ``method``                    ``layered`` (default), ``lightfield`` or ``paper``, which has no
    ``lens_points``, ``squares``  derivatives; and their options, see :func:`potmesil_mi.focus`
    ``rfilter``                   the film's reconstruction filter; box by default
    ``antialiased``               whether pixels on silhouettes show both sides, and are parted
                                  (default: they are not, as in what networks and rasterisers
                                  give); then there are no gradients of ``rgb``
    ``hidden``                    behind near edges ``farther`` things go on (default), or there
                                  is ``none``
    ============================  ==========================================================

    Returns pictures (B, 3, H, W) in linear sRGB, on the device of ``rgb``. There are gradients of
    ``rgb``, ``depth``, ``focus_distance``, ``f_number`` and ``focal_length``, as far as these have
    ``requires_grad``: first ones, by backward. Behind near edges there are copies of pixels beside
    them, whose gradients these get. Which pixels these are is found out of the numbers, and has no
    derivative. Within ``torch.no_grad()`` pictures are formed without, which is quicker.

    All is computed in float32. Half, bfloat16 and double are converted; a double ``rgb`` gives
    double pictures, all others give float32. Gradients have the types of what they are of.
    The backend is that of Mitsuba's variant, or the first that works; tensors on another device are
    copied. What is likely not meant, such as a lens that blurs nothing, is told once in a
    :class:`potmesil_mi.FocusWarning`.

    Raises ``TypeError`` or ``ValueError`` that names the parameter, as for lists of pictures of
    several sizes and for depth that is NaN or <= 0, ``NotImplementedError`` where there is no
    derivative, as for second ones.

    Example::

        distance = torch.tensor(2.0, requires_grad=True)
        picture = focus(rgb, depth, distance, 2.8, focal_length=50, millimeters_per_unit=1000)
        (picture - target).square().mean().backward()
        distance.grad
    """
    require_pictures(rgb, depth)
    require_choice("hidden", hidden, HIDDEN)
    require_flag("antialiased", antialiased)
    given = {"focus_distance": focus_distance, "f_number": f_number, "focal_length": focal_length}
    parameters = {name: for_each_picture(name, value, len(rgb)) for name, value in given.items()}
    options = Options(
        {
            "frame_width": frame_width,
            "millimeters_per_unit": millimeters_per_unit,
            "aperture": aperture,
        },
        method_of(method, lens_points=lens_points, squares=squares),
        antialiased,
        hidden,
        rfilter,
    )
    tensors: list[Any] = [rgb.to(torch.float32), depth.to(torch.float32), *parameters.values()]
    attached: tuple[str, ...] = ()
    if torch.is_grad_enabled():
        attached = tuple(name for name, of in zip(NAMES, tensors, strict=True) if of.requires_grad)
    pictures = Focus.apply(options, attached, *tensors)
    return pictures.to(torch.promote_types(rgb.dtype, torch.float32))
