"""Making living pictures: samples become a page that lets anybody refocus, and says how well."""

from __future__ import annotations

import dataclasses
import math
import os
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._files import require_writable, written_whole
from .._validation import require_kind, require_number, require_whole, shown
from ..filters.base import FilterFunction, as_filters
from ..focusing.methods import Method, MethodName
from ..focusing.session import FocusSession
from ..optics.lens import ThinLens
from ..samples.choosing import require_samples
from ..samples.maps import depth_map
from ..samples.point_samples import PointSamples
from .forming import SweepForming
from .lenses import apertures_of, focus_range
from .page import HTML, page_of, read_pictures
from .picture import Level, LivingPicture
from .sweep import BLENDED, Compressed, Sweep

if TYPE_CHECKING:
    from ..focusing.film import ReconstructionFilter

PSNR = 40.0
"""What is aimed at unless it is said, in dB."""

MAX_BYTES = 10_000_000
"""The largest page that is made unless it is said."""

LEAST_PSNR = 20.0
"""Below it no picture is worth a page."""

PER_BYTES = 6.0
"""By how many dB the aim falls for each e-th of bytes that are too many: about what JPEG takes."""


def living_picture(
    samples: PointSamples,
    path: str | os.PathLike[str],
    *,
    f_numbers: Iterable[float] | None = None,
    near: float | None = None,
    far: float | None = None,
    psnr: float = PSNR,
    max_bytes: int = MAX_BYTES,
    title: str = "",
    method: Method | MethodName = "layered",
    rfilter: ReconstructionFilter | None = None,
    filters: Sequence[FilterFunction | str] = (),
) -> LivingPicture:
    """Write a page with a picture that whoever opens it refocuses, without a network.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``samples``                   point samples of a perspective camera; their lens says how the
                                  page opens. They must serve the widest aperture, see
                                  ``Sampling.min_f_number``
    ``path``                      the page to write, ``.html``
    ``f_numbers``                 apertures that one may choose, F/D; by default the lens's own and
                                  the full stops beyond it, up to six, until hardly anything is
                                  blurred
    ``near``, ``far``             nearest and farthest focus in scene units, ``far`` may be ``inf``;
                                  by default of what is in sight, and no nearer than two focal
                                  lengths
    ``psnr``                      what is aimed at, 20 to 60 dB (default 40): what the page shows
                                  against :func:`potmesil_mi.focus`, in 8 bits of sRGB, at the worst
                                  focus that is measured
    ``max_bytes``                 largest page, >= 1000 bytes (default 10 000 000); where it is too
                                  small for ``psnr`` a warning says what was reached
    ``title``                     what the picture is called
    ``method``, ``rfilter``,      as in :func:`potmesil_mi.focus`
    ``filters``
    ============================  ==========================================================

    For each aperture pictures are formed from near to far, so close that circles of confusion grow
    by 1.4 pixels at most, and closer where that is too much. Of these the page keeps as few as it
    takes so that blends of two neighbours show all the others. What one sees between two apertures
    is a short fade. Nothing is left behind where it is interrupted. Returns what the page has, and
    how well it shows it. Raises ``ValueError`` or ``TypeError`` that names the
    parameter, ``OSError`` where the page cannot be written.
    """
    require_samples(samples)
    path = require_writable(path, HTML)
    require_kind("title", title, str, "text")
    require_number("psnr", psnr, LEAST_PSNR, 60)
    require_whole("max_bytes", max_bytes, 1000, 1 << 31)
    session, lens = FocusSession(samples, method), samples.lens
    if not isinstance(lens, ThinLens):
        raise ValueError(f"samples={shown(lens)}: must be of a perspective camera, with a ThinLens")
    lens = lens.plain()
    focused = focus_range(samples, lens, near, far)
    apertures = apertures_of(samples, lens, focused, f_numbers)
    session.accept_any_focus()
    forming = SweepForming(session, focused, {"rfilter": rfilter, "filters": as_filters(filters)})
    opened = min(range(len(apertures)), key=lambda i: abs(apertures[i] - lens.f_number))
    place = float(focused.place_of(lens.focus_distance))
    first = LivingPicture(
        title=title,
        size=samples.camera.crop_size,
        focus_range=focused,
        millimeters_per_unit=float(lens.millimeters_per_unit),
        focal_length=float(lens.focal_length),
        levels=(),
        depth=np.rint(255 * focused.place_of(depth_map(samples))).astype(np.uint8),
        opened=(place, opened),
        poster=forming.poster(lens.replace(f_number=apertures[opened]), place),
        worst=0.0,
        median=0.0,
        measured=0,
    )
    allowed = BLENDED * 10 ** (-psnr / 10)
    with tempfile.TemporaryFile() as file:
        sweeps = forming.sweeps(lens, apertures, allowed, file)
        made, page = _fitting(sweeps, first, float(psnr), int(max_bytes))
    with written_whole(path) as temporary:
        temporary.write_bytes(page)
    if made.worst < psnr:
        warnings.warn(
            f"psnr={psnr:g}: only {made.worst:.1f} dB were reached at the worst focus, and "
            f"{made.median:.1f} dB at the median, in max_bytes={max_bytes}; less noise, fewer "
            "f_numbers or a smaller picture take fewer bytes",
            stacklevel=2,
        )
    return made


def living_page(
    paths: Iterable[str | os.PathLike[str]], path: str | os.PathLike[str], *, title: str = ""
) -> list[LivingPicture]:
    """Write a page with the pictures of several that :func:`living_picture` wrote.

    ============================  ==========================================================
    Parameter                     Meaning
    ============================  ==========================================================
    ``paths``                     those pages, one at least, in order
    ``path``                      the page to write, ``.html``
    ``title``                     what stands above them
    ============================  ==========================================================

    Nothing of the pages but checked data gets into the new one. Returns the pictures. Raises
    ``ValueError`` or ``TypeError`` that names the parameter or what is wrong in which file, and
    ``OSError`` where one cannot be read or written.
    """
    if isinstance(paths, (str, bytes, os.PathLike)) or not isinstance(paths, Iterable):
        raise TypeError(f"paths={shown(paths)}: must be names of files, in a list")
    sources = list(paths)
    if not sources:
        raise ValueError(f"paths={shown(paths)}: must be one at least")
    require_kind("title", title, str, "text")
    path = require_writable(path, HTML)
    pictures = [picture for source in sources for picture in read_pictures(source)]
    page = page_of(pictures, title)
    with written_whole(path) as temporary:
        temporary.write_bytes(page.encode("utf-8"))
    return pictures


def _fitting(
    sweeps: Sequence[Sweep], first: LivingPicture, psnr: float, max_bytes: int
) -> tuple[LivingPicture, bytes]:
    """What shows its worst focus with ``psnr``, or as well as it can in so many bytes; its page."""
    aim, best = psnr, None
    while aim >= LEAST_PSNR:
        made = _made([sweep.compressed(10 ** (-aim / 10)) for sweep in sweeps], first)
        page = page_of([made]).encode("utf-8")
        if len(page) > max_bytes:
            if best is not None:  # What was better is too large.
                return best
            aim -= max(PER_BYTES * math.log(len(page) / max_bytes), 0.25)
            continue
        missing = psnr - made.worst
        if aim < psnr or missing <= 0 or aim > psnr + 2:
            return made, page
        if best is None or made.worst > best[0].worst:
            best = made, page
        aim += missing + 0.1
    raise ValueError(
        f"max_bytes={max_bytes}: must be larger: {len(page)} bytes are not enough for "
        f"{LEAST_PSNR:g} dB"
    )


def _made(sweeps: Sequence[Compressed], first: LivingPicture) -> LivingPicture:
    """The living picture with what is kept of its sweeps."""
    errors = np.concatenate([sweep.errors for sweep in sweeps])
    psnr = -10 * np.log10(np.maximum(errors, 1e-10))
    return dataclasses.replace(
        first,
        levels=tuple(Level(*sweep[:3]) for sweep in sweeps),
        worst=round(float(psnr.min()), 2),
        median=round(float(np.median(psnr)), 2),
        measured=len(psnr),
    )
