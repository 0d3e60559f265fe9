"""Options that commands share, made from the parameters they stand for."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from .._examples import PREFIX, file_of
from .._units import MILLIMETERS, Length, f_number_of

T = TypeVar("T")

VARIANTS = ("cuda_ad_rgb", "llvm_ad_rgb")
"""Mitsuba's variants of which the first that works is taken."""

SAMPLING_OPTIONS = {
    "pattern": "where the image is sampled",
    "threshold": "adaptive: intensity difference that is subdivided",
    "subdivisions": "adaptive: most subdivisions, 0 to 8",
    "layers": "most surfaces along a ray that are sampled, where the lens sees them (default 16)",
    "overscan": "beyond each side (default: as far as circles of confusion reach)",
    "min_f_number": "widest aperture that the samples must serve (default: the lens's)",
    "virtual_depth": "images in mirrors and glass have their own depth (default: yes)",
    "refine": "further samples where radiance varies, as a share of all (default 0.25)",
    "focus_range": "nearest and farthest distance that will be focused on (default: any)",
    "clamp": "most radiance of a sample that shows no lamp (default: any)",
    "features": "samples keep albedo and normal, to be denoised later (default: as --denoise says)",
}
"""Help of the options that are fields of ``Sampling``."""

LENS_OPTIONS = {
    "f_number": "aperture number F/D, such as 2.8 or f/2.8",
    "aperture_radius": "in scene units or as 5mm, in place of --f-number",
    "focus_distance": "in scene units along the axis, or with a unit, 1.2m, or inf",
    "half_angle": "in degrees, of the telecentric lens of an orthographic sensor",
    "focal_length": "in mm, or with a unit",
    "frame_width": "width of the film in mm, or with a unit",
    "millimeters_per_unit": "size of a scene unit in mm",
    "film": "film at F, or at the focused image",
    "aperture": "disc, polygon:blades=6,rotation=15,curvature=0.2, image:filename=heart.png, or "
    "lommel:wavelengths=610/550/465",
    "squeeze": "anamorphic: height of highlights to width",
    "vignetting": "of the lens's rim, in the corners",
}
"""Help of the options that are parameters of ``ThinLens`` and ``TelecentricLens``."""

PICTURE_OPTIONS = {
    "depth": "file of its depth: EXR, PNG, TIFF, .npy (default: the depth in it)",
    "depth_kind": "z: along the axis; distance: along the ray; inverse: 1/z; ndc (default: that of "
    "the program that wrote it, if that is known)",
    "depth_scale": "scene units for 1 of a depth, such as 0.001 for whole numbers in mm",
    "camera": "its horizontal field of view in degrees (default: what it says)",
    "near": "ndc: the near plane, in scene units; distance: where it is counted from (0)",
    "far": "ndc: the far plane (default inf)",
    "clip": "ndc: opengl, -1 to 1 (default), or direct3d, 0 to 1",
    "reverse": "ndc: whether 1 is near",
    "background": "depth from which on nothing was hit",
    "antialiased": "whether silhouettes are smooth, and parted in two surfaces (default: yes)",
    "hidden": "behind near edges farther things go on (default), or none",
    "layer": "name of the layer of colours, where it has several",
    "depth_channel": "name of the channel of depth, where it has several",
}
"""Help of the options that are parameters of ``PointSamples.from_image``."""

OPTION_NAMES = {"camera": "--fov"}
"""Options that are not called what their parameters are."""

METHOD_OPTIONS = {
    "method": "layered: what is visible (default); lightfield: the same, finer; paper: equation "
    "20; or one with parameters, such as layered:lens_points=64,squares=2",
    "lens_points": "points of the lens from which visibility is found (32 or 64, "
    "lightfield 128 or 192)",
    "tables": "paper: number of depth tables (default 73)",
    "inverse_square": "paper: weight samples by 1/z^2 (default: yes)",
    "squares": "squares on a side of a pixel (layered 1 or 2, lightfield 2 or 4, paper 2)",
}
"""Help of the options that say how ``focus`` forms the picture."""

IN_UNITS = {"focus_distance", "aperture_radius", "near", "far", "background"}
"""Parameters that are lengths in scene units."""

IN_MILLIMETERS = {"focal_length", "frame_width"}
"""Parameters that are lengths in millimetres."""

F_NUMBERS = {"f_number", "min_f_number"}
"""Parameters that are f-numbers."""

METAVARS = {
    "overscan": "PIXELS",
    "min_f_number": "N",
    "depth": "FILE",
    "depth_scale": "S",
    "camera": "DEGREES",
    "near": "N",
    "far": "F",
    "background": "Z",
    "layer": "NAME",
    "depth_channel": "NAME",
    "refine": "SHARE",
    "focus_range": "NEAR/FAR",
    "clamp": "RADIANCE",
    "f_number": "N",
    "aperture_radius": "R",
    "focus_distance": "U",
    "half_angle": "DEGREES",
    "focal_length": "F",
    "frame_width": "W",
    "millimeters_per_unit": "S",
    "aperture": "SHAPE",
    "squeeze": "RATIO",
    "vignetting": "SHARE",
}
"""What stands for the value of an option in the help, where it is not the option's name."""


class FileAction(argparse.Action):
    """Stores the name of a file, which may be given as ``example:NAME``.

    Raises ``ValueError`` for an example that there is not.
    """

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Store it."""
        setattr(namespace, self.dest, file_of(values))


def add_scene(command: argparse.ArgumentParser, what: str = "the scene") -> None:
    """Add the options of the scene and of its samples."""
    command.add_argument(
        "scene", metavar="SCENE.xml", action=FileAction,
        help=f"{what}; {PREFIX}NAME is a scene that comes with the package, such as terrace",
    )  # fmt: skip
    command.add_argument(
        "-D", "--define", metavar="KEY=VALUE", action="append", default=[], type=_definition,
        help="value of a $KEY in the scene; may be given several times",
    )  # fmt: skip
    command.add_argument("--sensor", type=int, default=0, help="number of the sensor (default 0)")
    command.add_argument(
        "--spp", type=int, default=0, help="samples a pixel (default: the sampler's count)"
    )
    command.add_argument("--seed", type=int, default=0, help="of the random numbers (default 0)")


def add_samples(command: argparse.ArgumentParser) -> None:
    """Add the option that keeps the samples of a scene."""
    command.add_argument(
        "--samples", metavar="FILE", help="keep the point samples in an archive, FILE.samples, or "
        "in a deep EXR, FILE.exr; with --denoise as they were rendered, so that `focus --denoise` "
        "denoises them"
    )  # fmt: skip


def add_output(command: argparse.ArgumentParser) -> None:
    """Add the options of the pictures to write, and of the variant."""
    command.add_argument(
        "-o", "--output", metavar="FILE", action="append", required=True,
        help="picture to write, linear .exr or sRGB .png, .jpg, .tif; may be given several times",
    )  # fmt: skip
    add_form(command)
    add_variant(command)


def add_form(command: argparse.ArgumentParser) -> None:
    """Add the options of how the numbers of pictures are kept."""
    from .._image import JPEG_QUALITY, BitDepth

    command.add_argument(
        "--bit-depth", choices=get_args(BitDepth),
        help="of all pictures: .png 8 (default) or 16, .tif 16 (default) or 8, in sRGB, or float, "
        "linear; .exr float (default) or half; .jpg 8",
    )  # fmt: skip
    command.add_argument(
        "--quality", type=int, metavar="1-100", help=f"of .jpg (default {JPEG_QUALITY})"
    )


def add_variant(command: argparse.ArgumentParser) -> None:
    """Add the option that names Mitsuba's variants."""
    command.add_argument(
        "-m", "--variant",
        help="Mitsuba variants, of which the first that works is taken (default "
        f"{','.join(VARIANTS)})",
    )  # fmt: skip


def add_sampling(command: argparse.ArgumentParser) -> None:
    """Add an option for each field of ``Sampling``."""
    from ..tracing.sampling import Sampling

    group = command.add_argument_group("sampling", "default: what the scene's integrator says")
    _add_parameters(group, _types_of(Sampling), SAMPLING_OPTIONS)


def add_maps(command: argparse.ArgumentParser) -> None:
    """Add the option for maps beside the picture."""
    from ..samples.maps import MAPS

    command.add_argument(
        "--maps", nargs="+", choices=MAPS, default=[],
        help="further channels of an EXR: Z, depth along the axis; coc, diameter of the circle of "
        "confusion in pixels, negative beyond the focus; id, of the surface; albedo and N, the "
        "normal, of samples with features; aovs, those of an integrator aov, not blurred",
    )  # fmt: skip


def add_picture(command: argparse.ArgumentParser, names: Mapping[str, str] = OPTION_NAMES) -> None:
    """Add an option for each parameter of ``PointSamples.from_image`` but the lens.

    ``names`` are those of options that are not called what their parameters are.
    """
    from ..samples.point_samples import PointSamples

    group = command.add_argument_group(
        "picture of another program", "what it says of itself needs no option"
    )
    types = get_type_hints(PointSamples.from_image)
    _add_parameters(group, types, PICTURE_OPTIONS, names)


def add_motion(command: argparse.ArgumentParser) -> None:
    """Add the option that tells what moves."""
    command.add_argument(
        "--motion", metavar="FILE.toml", action=FileAction,
        help="what moves while the picture is exposed, tables "
        "[camera], [shapes.ID] and [shutter] (default: what the scene's integrator says)"
    )  # fmt: skip


def add_lens(command: argparse.ArgumentParser) -> None:
    """Add an option for each parameter of ``ThinLens`` and ``TelecentricLens``."""
    from ..optics.lens import ThinLens
    from ..optics.telecentric import TelecentricLens

    types = {**_types_of(TelecentricLens), **_types_of(ThinLens)}
    group = command.add_argument_group("lens", "default: what the scene or the samples say")
    _add_parameters(group, types, LENS_OPTIONS)
    add_units(group)
    group.add_argument(
        "--focus-at", metavar="X,Y", type=_place,
        help="focus on what this pixel shows, from the top left corner; or 30%%,50%%",
    )  # fmt: skip
    group.add_argument(
        "--focus-on", metavar="NAME",
        help="focus on the surface of this name (`potmesil info` lists them), or on the center",
    )  # fmt: skip


def add_units(group: argparse._ActionsContainer) -> None:
    """Add the option that names a scene unit."""
    group.add_argument(
        "--units", choices=MILLIMETERS,
        help="what a scene unit is, in the place of --millimeters-per-unit",
    )  # fmt: skip


def add_method(command: argparse.ArgumentParser) -> None:
    """Add an option for each parameter of the methods of ``focus``."""
    from ..focusing.methods import method_of

    group = command.add_argument_group("focus stage")
    _add_parameters(group, get_type_hints(method_of), METHOD_OPTIONS)
    group.add_argument(
        "--max-memory", metavar="SIZE",
        help="memory that it may take, such as 4G (default: what is free); more is refused",
    )  # fmt: skip


def add_denoise(command: argparse.ArgumentParser, default: str) -> None:
    """Add the option that denoises samples, which does so by ``default`` as that says."""
    command.add_argument(
        "--denoise", action=argparse.BooleanOptionalAction,
        help=f"denoise the samples before they are focused (default: {default}); needs pip install "
        "'potmesil_mi[denoise]'",
    )  # fmt: skip


def add_filter(command: argparse.ArgumentParser) -> None:
    """Add the option for special effects."""
    from ..filters.base import Filter

    group = command.add_argument_group("special effects")
    group.add_argument(
        "--filter", metavar="NAME:PARAMETER=VALUE,...", action="append", default=[],
        help=f"{', '.join(Filter.members())}, such as star:points=6,length=0.1,threshold=2; may "
        "be given several times, in order, and takes the place of the scene's",
    )  # fmt: skip


def add_talk(command: argparse.ArgumentParser) -> None:
    """Add the options that say how much the command says."""
    group = command.add_argument_group("messages")
    group.add_argument("-q", "--quiet", action="store_true", help="warnings and errors alone")
    group.add_argument("-v", "--verbose", action="store_true", help="more of what was done")
    group.add_argument(
        "--json", action="store_true", help="what it says as JSON, on standard output"
    )


def _types_of(owner: type) -> dict[str, Any]:
    """Types of the parameters with which objects of a class are made."""
    return get_type_hints(owner.__init__)  # type: ignore[misc]


def _add_parameters(
    group: argparse._ArgumentGroup,
    types: Mapping[str, Any],
    texts: Mapping[str, str],
    names: Mapping[str, str] = OPTION_NAMES,
) -> None:
    """Add an option for each parameter in ``texts``, which have their help; ``None`` by default."""
    for name, text in texts.items():
        option = names.get(name, "--" + name.replace("_", "-"))
        metavar = METAVARS.get(name)
        parsing = _parsing(name, types[name])
        group.add_argument(option, help=text, metavar=metavar, dest=name, **parsing)


def _parsing(name: str, kind: Any) -> dict[str, Any]:
    """How ``argparse`` reads a parameter of that name and type, which may be optional."""
    if name in IN_UNITS:
        return {"type": length}
    if name in IN_MILLIMETERS:
        return {"type": millimeters}
    if name in F_NUMBERS:
        return {"type": f_number}
    kinds = [kind] if get_origin(kind) in (None, Literal) else [*get_args(kind)]
    for one in kinds:
        if get_origin(one) is Literal:
            return {"choices": get_args(one)}
    if bool in kinds:
        return {"action": argparse.BooleanOptionalAction}
    if str in kinds:
        return {}
    return {"type": int if int in kinds else float}


def length(text: str) -> Length:
    """A length as an option says it, with or without a unit."""
    return _read(Length.of, text)


def millimeters(text: str) -> float:
    """A length in millimetres, where no other unit is said."""
    return length(text).in_units(1.0)


def f_number(text: str) -> float:
    """An f-number as an option says it."""
    return _read(f_number_of, text)


def _read(parse: Callable[[str], T], text: str) -> T:
    """What ``parse`` makes of an option's text; what is wrong with it is said of the option."""
    try:
        return parse(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _place(text: str) -> tuple[tuple[float, bool], ...]:
    """A place in the picture: across and down, numbers, each in pixels or a share of the side."""
    parts = [part.strip() for part in text.split(",")]
    try:
        x, y = parts
        return tuple(
            (float(part.rstrip("%")) / (100 if part.endswith("%") else 1), part.endswith("%"))
            for part in (x, y)
        )
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: must be two numbers with a comma between, pixels such as 320,240 or 30%,50%"
        ) from None


def _definition(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise argparse.ArgumentTypeError(f"{text!r}: must be KEY=VALUE")
    return key, value


def add_taking(command: argparse.ArgumentParser, names: Mapping[str, str] = OPTION_NAMES) -> None:
    """Add what says how samples are taken, or read, and focused.

    ``names`` are those of :func:`add_picture`.
    """
    add_variant(command)
    add_samples(command)
    add_denoise(command, "what the scene's integrator says")
    add_sampling(command)
    add_lens(command)
    add_method(command)
    add_filter(command)
    add_picture(command, names)
