"""Point samples: what the hidden-surface stage hands to the focus stage.

Section 3.1 of Potmesil & Chakravarty (1981): image coordinates, intensities, depth and surface
of every sample, with the parameters of the camera.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import os
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._html import displayed
from .._validation import require_whole
from ..optics.camera import Camera
from ..optics.depth import Clip, DepthKind
from ..optics.lens import ThinLens
from ..optics.telecentric import TelecentricLens, require_fitting
from . import files
from .aovs import are_ids, require_aov_names, require_named
from .attached import AttachedColumn, require_unattached, taken_from
from .changes import Changes
from .columns import OF_DEFAULT, TWINS, Columns, parts_of, require_beside_columns, visibility_points
from .counting import primary_rays
from .cropping import part_of
from .display import html_of_samples
from .header import Header
from .image_layers import Hidden
from .merging import merged, require_mergeable
from .provenance import Provenance, checked_provenance
from .raster import FARTHEST, Window

if TYPE_CHECKING:
    from typing_extensions import Unpack


CROWDED = 0.25
"""Hidden samples for each visible one from which on a scene is crowded with things that the lens
sees past, such as hair or twigs."""


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PointSamples(Columns):
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
                                  0 for what it sees (default), 1 and more for what is hidden;
                                  240 to 254 for the part that panes and veils keep back of what
                                  it sees, and that is seen past their edges;
                                  255 for what is on none of its rays: its place is that where
                                  it would be seen
    ``through``                   float32 (N,), depth of the mirror or pane that it is seen
                                  through, ``z`` being that of the image; 0 for what is seen
                                  directly; ``None`` (default) where that is all
    ``visibility``                uint64 (N,), which points of a lens see it: bit i is set for
                                  point i of ``visibility_points``; 0 where a focus is to find
                                  it out from the other samples; ``None`` (default) where that
                                  is all
    ``albedo``                    float32 (N, 3), diffuse reflectance of what is seen, in linear
                                  sRGB, 0 to 1; 1 of what does not reflect diffusely; 0 of lamps,
                                  of the sky, of media and veils; ``None`` (default) where it
                                  was not kept
    ``normal``                    float32 (N, 3), its shading normal in the world; 0 where
                                  ``albedo`` is for lamps and the like; ``None`` (default) where
                                  it was not kept
    ``time``                      float32 (N,), part of the exposure, 0 to 1, that is over when the
                                  sample is where it is; ``None`` (default) where all are of one
                                  time
    ``motion``                    float32 (N, 3), by how much x and y, in pixels, and z, in scene
                                  units, change during the part of the exposure that the sample
                                  stands for, half of it before its ``time`` and half after;
                                  ``None`` (default) where all stands still
    ``aovs``, ``aov_names``       float32 (N, K), further values that the nested integrator has of
                                  the sample's ray, and their K names, such as ``dd.T``; ``None``
                                  and () (default) where it has none
    ``visibility_radius``         half-widths (across, down) of that lens, in scene units;
                                  ``None`` without ``visibility``
    ``camera``, ``lens``          the pinhole that took them, the lens that came with it; for an
                                  orthographic camera a :class:`potmesil_mi.TelecentricLens`
    ``surfaces``                  name of every surface id
    ``lattice``                   where positions are multiples of 1/lattice pixels: that
                                  number; 0 where they may be anywhere
    ``window``                    :class:`potmesil_mi.Window` of what was sampled: the
                                  crop window (default), or more with overscan
    ``provenance``                how they were made: at most 64 names to texts and numbers, such
                                  as ``seed``, ``spp``, ``integrator``, ``version``; files and
                                  pictures keep it (default: none)
    ============================  ==========================================================

    Samples with radiance, alpha or position that is not finite, with depth or weight that is NaN or
    not positive, with ``through`` not finite or < 0, with an albedo or a time that is not 0 to 1, a
    normal longer than 1 or a motion that is not finite or goes through the camera are dropped, with
    a ``RuntimeWarning`` that counts them. Raises ``ValueError`` for
    columns of unequal length or wrong shape, for a window of less than one pixel, for
    ``visibility`` without the lens's half-widths or these without it, for AOVs without a name
    each, and where no sample is left,
    ``TypeError`` for a window of other than whole numbers.
    """

    camera: Camera
    lens: ThinLens | TelecentricLens
    surfaces: Mapping[int, str] = dataclasses.field(default_factory=dict)
    lattice: int = 0
    window: Window = OF_DEFAULT
    visibility_radius: Sequence[float] | None = None
    provenance: Provenance = dataclasses.field(default_factory=dict)
    aov_names: Sequence[str] = ()
    _attached: Mapping[str, AttachedColumn] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        given = taken_from({f.name: getattr(self, f.name) for f in self.present()})
        for name, (_, column) in given.items():
            object.__setattr__(self, name, column)
        require_whole("lattice", self.lattice, 0, 1 << 16)
        known = self.visibility is not None
        require_beside_columns(self.surfaces, self.visibility_radius, known)
        require_fitting(self.camera, self.lens)
        object.__setattr__(self, "provenance", checked_provenance(self.provenance))
        window = self.crop_window if self.window is OF_DEFAULT else Window.of(self.window)
        object.__setattr__(self, "window", window)
        super().__post_init__()
        names = require_aov_names(self.aov_names)
        require_named(self.aov_names, self.aovs)
        object.__setattr__(self, "aov_names", names)
        attached = {name: of for name, of in self._attached.items() if name not in given}
        for name, (values, _) in given.items():
            attached[name] = AttachedColumn(values, getattr(self, name))
        object.__setattr__(self, "_attached", attached)
        if not self.all_valid:
            count, valid = len(self), self.is_valid()
            for field in self.present():
                object.__setattr__(self, field.name, getattr(self, field.name)[valid])
            object.__setattr__(self, "_attached", self._attached_of(valid, attached))
            warnings.warn(
                f"dropped {count - len(self)} of {count} samples: radiance, alpha, position or "
                "weight not finite, depth or weight not > 0, through not finite or < 0, albedo not "
                "0 to 1, a normal longer than 1, or time or motion out of bounds",
                RuntimeWarning,
                stacklevel=3,
            )
        if len(self) == 0:
            raise ValueError("no samples: there must be at least one with finite radiance")

    @classmethod
    def from_image(
        cls,
        rgb: np.ndarray | str | os.PathLike[str],
        depth: np.ndarray | str | os.PathLike[str] | None = None,
        *,
        camera: Camera | float | None = None,
        lens: ThinLens | Mapping[str, Any] | None = None,
        depth_kind: DepthKind | None = None,
        near: float | None = None,
        far: float = math.inf,
        clip: Clip = "opengl",
        reverse: bool = False,
        background: float | None = None,
        depth_scale: float | None = None,
        surface: np.ndarray | None = None,
        surfaces: Mapping[int, str] | None = None,
        antialiased: bool = True,
        hidden: Hidden = "farther",
        layer: str | None = None,
        depth_channel: str | None = None,
    ) -> PointSamples:
        """Samples of a picture of any program and its depth: in arrays, or in files.

        ============================  ==========================================================
        Parameter                     Meaning
        ============================  ==========================================================
        ``rgb``                       float (H, W, 3), linear sRGB; or (H, W, 4), with alpha that
                                      they are multiplied by; or a file: EXR, HEIC, PNG, TIFF
        ``depth``                     (H, W), times ``depth_scale``; or a file (default: ``rgb``'s)
        ``camera``                    whose crop window the picture shows; or its horizontal field
                                      of view in degrees; by default what the file says
        ``lens``                      with a file some of its parameters are enough, in a mapping,
                                      where the file says the others
        ``depth_kind``                what ``depth`` is: ``z``, along the axis; ``distance``, along
                                      the ray, both > 0 scene units; ``inverse``, 1/z, >= 0;
                                      ``ndc``, the depth of a buffer; by default that of the
                                      program that wrote a file, if that is known
        ``near``, ``far``             planes of an NDC depth in scene units, with ``clip`` and
        ``clip``, ``reverse``         ``reverse`` as in :func:`.depth.depth_from_ndc`; ``near`` is
                                      also where a ``distance`` is counted from, as Mitsuba does
        ``background``                z from which on nothing was hit; 0: where it is 0 or NaN
        ``surface``, ``surfaces``     uint32 (H, W), ids and names; by default the file's, or 1
        ``antialiased``               whether pixels on silhouettes show both sides, and are parted
        ``hidden``                    behind near edges ``farther`` things go on, or ``none``
        ``layer``, ``depth_channel``  names in the file, where it has several
        ============================  ==========================================================

        The samples serve this lens and any that is not wider. Raises ``ValueError`` for arrays of
        other sizes, a depth that is NaN or out of bounds (an NDC depth may be before the near
        plane), planes that are missing or that no other kind has, ids that are not 0 to 2^32 - 1,
        files that cannot be read or do not say enough; ``TypeError`` for ids that are no whole
        numbers, ``OSError`` where there is no file.
        """
        # What reads pictures takes a while to import, and few samples are of pictures.
        from .images import Described, fields_of

        said = depth_kind, near, far, clip, reverse, background, depth_scale, antialiased, hidden
        described = Described(camera, lens, surface, surfaces, layer, depth_channel, *said)
        return cls(**fields_of(rgb, depth, described))

    @property
    def attached(self) -> dict[str, Any]:
        """The Dr.Jit arrays of the columns that have gradients, by name."""
        own = self._attached.items()
        return {name: of.values for name, of in own if of.column is getattr(self, name)}

    def _attached_of(
        self, which: np.ndarray | slice, attached: Mapping[str, AttachedColumn]
    ) -> dict[str, AttachedColumn]:
        return {name: of.chosen(which, getattr(self, name)) for name, of in attached.items()}

    def chosen(self, which: np.ndarray | slice) -> PointSamples:
        """The samples that ``which`` has, see :meth:`Columns.chosen`; they keep gradients."""
        chosen = super().chosen(which)
        attached = {name: self._attached[name] for name in self.attached}
        object.__setattr__(chosen, "_attached", chosen._attached_of(which, attached))
        return chosen

    @property
    def crop_window(self) -> Window:
        """The window that the picture shows: the crop window of the camera."""
        return Window(*self.camera.crop_offset, *self.camera.crop_size)

    @functools.cached_property
    def spp(self) -> int:
        """Primary rays in a pixel of the crop window: mean, rounded down.

        What a ray sees behind half-transparent things are several samples, of one position.
        """
        return primary_rays(self, self.crop_window, self.window, self.lattice > 0)

    @functools.cached_property
    def instants(self) -> int:
        """Instants of the exposure at which there are samples."""
        return 1 if self.time is None else len(np.unique(self.time))

    @property
    def moves(self) -> bool:
        """Whether the samples are of an exposure during which something moves."""
        return self.motion is not None or self.instants > 1

    def at_instants(self) -> list[PointSamples]:
        """The samples of each instant of the exposure, with their shares of a pixel at it."""
        if self.time is None or self.instants == 1:
            return [self]
        times = np.unique(self.time)
        if (self.time[1:] >= self.time[:-1]).all():
            ends = [*np.searchsorted(self.time, times), len(self)]
            parts = [self.chosen(slice(*part)) for part in itertools.pairwise(ends)]
        else:
            parts = [self.chosen(self.time == time) for time in times]
        return [part.replace(weight=part.weight * np.float32(len(parts))) for part in parts]

    @functools.cached_property
    def hidden_to_visible(self) -> float:
        """How much is hidden from the pinhole, for each of what it sees, by weight.

        Twins do not count, whose like is visible, nor what windows show to the rest of the lens.
        """
        sums = [0.0, 0.0]
        for part in parts_of(len(self)):
            layer, weight = self.layer[part], self.weight[part]
            for i, which in enumerate(((layer > 0) & (layer < TWINS), layer == 0)):
                sums[i] += weight[which].sum(dtype=np.float64)
        return float(sums[0] / sums[1]) if sums[1] > 0 else 0.0

    @property
    def is_crowded(self) -> bool:
        """Whether so much is hidden that thin things cover each other in most pixels."""
        return self.hidden_to_visible >= CROWDED

    @property
    def visibility_points(self) -> np.ndarray:
        """The points of the lens for the bits of ``visibility``, (64, 2), in scene units.

        They go to the left and upwards from the middle, as the camera looks. Raises ``ValueError``
        for samples without visibility.
        """
        if self.visibility_radius is None:
            raise ValueError("visibility: None, the samples have no visibility")
        return visibility_points(self.visibility_radius)

    def _repr_html_(self) -> str | None:
        return displayed(lambda: html_of_samples(self))

    def __repr__(self) -> str:
        width, height = self.camera.crop_size
        return (
            f"PointSamples({len(self):,} in {width}x{height} pixels, z = {self.z.min():g} to "
            f"{self.z.max():g}, surfaces = {list(self.surfaces.values())}, lens = {self.lens})"
        )

    def replace(self, **changes: Unpack[Changes]) -> PointSamples:
        """Samples with some fields changed; a window of ``None`` is the crop window.

        Raises ``TypeError`` for an unknown field, and what the constructor raises.
        """
        fields: dict[str, Any] = {**changes}
        return dataclasses.replace(self, **fields)

    def visible(self) -> PointSamples:
        """What the pinhole sees: the samples of layer 0."""
        first = self.layer == 0
        count = int(np.count_nonzero(first))
        # What is hidden mostly comes last, and nothing has to be copied.
        which = slice(count) if first[:count].all() else first
        return self if count == len(self) else self.chosen(which)

    def pixel(self) -> np.ndarray:
        """Index of each sample's pixel in ``window``, row by row, int64 (N,).

        A sample on an edge between pixels belongs to the one on its right or below it; on the
        window's last edge, and beyond the window, to the nearest pixel.
        """
        return self.window.pixel_of(self.x, self.y)

    def crop(self, window: Window, halo: int = 0) -> PointSamples:
        """The samples of a part of the picture, and of ``halo`` pixels around it.

        The crop window of their camera is ``window``, so that :func:`potmesil_mi.focus` forms
        that part of the picture. It is the same part of the whole picture, up to rounding, where
        the halo reaches as far as the circles of confusion of all that stands around it, once
        for its light and once more for what it hides. The halo ends where the samples end.
        What is chosen from all samples is chosen from those at hand: parts that are to be put
        beside each other are formed by ``focus(..., tiles=...)``.

        Raises ``ValueError`` for a window that goes beyond the crop window, and for one without
        samples; ``TypeError`` for other than whole numbers.
        """
        window = Window.of(window)
        require_whole("halo", halo, 0, FARTHEST)
        if not self.crop_window.covers(window):
            raise ValueError(
                f"window={tuple(window)}: must lie in the crop window {tuple(self.crop_window)}"
            )
        sampled = window.grown(halo).intersection(self.window)
        if not sampled.shows(self.x, self.y, self.window, edges=self.lattice > 0).any():
            raise ValueError(f"window={tuple(window)}, halo={halo}: there are no samples in it")
        return part_of(self, window, sampled)

    def merge(
        self, lens: ThinLens | TelecentricLens | None = None, tolerance: float = 0.1
    ) -> PointSamples:
        """Fewer samples that ``lens`` (default: their own) can hardly tell from these.

        The rule: samples of one quarter of a pixel (its 2x2 squares), of the same layer, surface
        and alpha, seen by the same points of the lens and through nothing or one thing, whose
        signed circles of confusion round to the same multiple of ``tolerance`` pixels, become one.
        It has the sum of their weights and, weighted by these, the mean of their positions,
        colours and 1/z (of an orthographic camera z), so that the light of a pixel is unchanged.
        Where circles are about as small as a pixel, detail finer than half a pixel is lost.
        Where there were 64 a pixel, ``layered`` no longer looks closely by itself, but with
        ``squares=2,lens_points=64``. Samples on a lattice belong to several pixels and stay as they
        are.
        Raises ``ValueError`` for a tolerance that is not > 0.
        """
        lens = self.lens if lens is None else lens
        require_unattached(self.attached, "merge")
        require_mergeable(self.camera, lens, tolerance)
        if self.lattice > 0:
            return self
        columns = merged(self, self.pixel(), self.camera, lens, tolerance, are_ids(self.aov_names))
        return self.replace(**vars(columns))

    def denoised(self) -> PointSamples:
        """Samples with less noise in their radiance, for the price of a little bias.

        Needs ``albedo`` and ``normal``, which ``Sampling(features=True)`` keeps, and the extra
        ``denoise``: Intel's Open Image Denoise. It works on the irradiance, for each surface in a
        pixel by itself, hidden ones and overscan included, so that nothing is smeared over edges
        and textures keep their detail. Lamps, the sky, media and veils stay as they are, and so do
        alpha and depth. Where samples have little noise beside the bias of the denoiser they are
        mixed with what it makes of them, by estimates of both: see ``samples/denoising.py``.
        Very bright samples that stand alone count as noise, and their light is spread or lost;
        where the mean of a pixel is negative it becomes 0.

        Denoise once, before :meth:`merge`, which leaves too few samples to tell their noise.
        Raises ``ValueError`` for samples without ``albedo`` or ``normal``, ``ImportError`` without
        the extra.
        """
        from .denoising import denoised_radiance, denoiser_name

        require_unattached(self.attached, "denoised")
        rgb = denoised_radiance(self, self.window)
        return self.replace(rgb=rgb, provenance={**self.provenance, "denoised": denoiser_name()})

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file, in the format that the ending of its name stands for.

        ``.samples`` is an archive of compressed columns: it keeps all bit for bit and in order, and
        is many times as fast. ``.exr`` is a deep EXR for other programs: by pixel, nearest first,
        and colours are rounded. See ``samples/archive.py`` and ``samples/deep_exr.py``.

        Raises ``ValueError`` for another name, and for a camera or a lens that :meth:`load`
        would not take; ``OSError`` where the file cannot be written. Then nothing is left behind.
        """
        known = {field.name: getattr(self, field.name) for field in dataclasses.fields(Header)}
        files.write(path, Header(**{**known, "surfaces": dict(self.surfaces)}), self)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> PointSamples:
        """Read a file that :meth:`save` wrote. What is in it is not trusted.

        A name that does not end in ``.samples`` is taken for a deep EXR. Raises
        ``FileNotFoundError`` or another ``OSError`` where there is none or it cannot be read, and
        ``ValueError`` for a file that is not of its format, is truncated or damaged, takes far more
        memory than its size lets one expect, or does not hold the samples of this package. Each
        names the file.
        """
        header, columns = files.read(path)
        return PointSamples(
            **vars(columns),
            camera=header.camera,
            lens=header.lens,
            surfaces=header.surfaces,
            lattice=header.lattice,
            window=header.window,
            visibility_radius=header.visibility_radius,
            provenance=header.provenance,
            aov_names=header.aov_names,
        )
