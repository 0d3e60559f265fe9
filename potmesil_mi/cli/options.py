"""Options that commands share, made from the parameters they stand for, and what they say."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

from .._examples import PREFIX, file_of

if TYPE_CHECKING:
    import mitsuba as mi

    from ..focusing.methods import Method
    from ..motion.motion import Motion
    from ..tracing.sampling import Sampling

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
    "f_number": "aperture number F/D",
    "aperture_radius": "in scene units, in place of --f-number",
    "focus_distance": "in scene units along the axis, or inf",
    "half_angle": "in degrees, of the telecentric lens of an orthographic sensor",
    "focal_length": "in mm",
    "frame_width": "width of the film in mm",
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

OPENINGS = {"f_number", "aperture_radius"}
"""Two parameters of which one says how wide the aperture is."""

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


# ---------------------------------------------------------------- groups of options


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
        help="picture to write, linear float .exr or sRGB .png, .jpg; may be given several times",
    )  # fmt: skip
    add_variant(command)


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
        "confusion in pixels, negative beyond the focus; id, of the surface",
    )  # fmt: skip


def add_picture(command: argparse.ArgumentParser) -> None:
    """Add an option for each parameter of ``PointSamples.from_image`` but the lens."""
    from ..samples.point_samples import PointSamples

    group = command.add_argument_group(
        "picture of another program", "what it says of itself needs no option"
    )
    types = get_type_hints(PointSamples.from_image)
    _add_parameters(group, types, PICTURE_OPTIONS)


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


def _types_of(owner: type) -> dict[str, Any]:
    """Types of the parameters with which objects of a class are made."""
    return get_type_hints(owner.__init__)  # type: ignore[misc]


def _add_parameters(
    group: argparse._ArgumentGroup, types: Mapping[str, Any], texts: Mapping[str, str]
) -> None:
    """Add an option for each parameter in ``texts``, which have their help; ``None`` by default."""
    for name, text in texts.items():
        option = OPTION_NAMES.get(name, "--" + name.replace("_", "-"))
        metavar = METAVARS.get(name)
        group.add_argument(option, help=text, metavar=metavar, dest=name, **_parsing(types[name]))


def _parsing(kind: Any) -> dict[str, Any]:
    """How ``argparse`` reads a parameter of a type, which may be optional."""
    kinds = [kind] if get_origin(kind) in (None, Literal) else [*get_args(kind)]
    for one in kinds:
        if get_origin(one) is Literal:
            return {"choices": get_args(one)}
    if bool in kinds:
        return {"action": argparse.BooleanOptionalAction}
    if str in kinds:
        return {}
    return {"type": int if int in kinds else float}


def _definition(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        raise argparse.ArgumentTypeError(f"{text!r}: must be KEY=VALUE")
    return key, value


# ---------------------------------------------------------------- what the options say


def scene_with_lens(
    options: argparse.Namespace, otherwise: Mapping[str, Any] | None = None
) -> tuple[mi.Scene, mi.Sensor]:
    """The scene, and its sensor with the lens of the options.

    Where these do not say it, the lens has the parameters ``otherwise``.
    """
    import mitsuba as mi

    from ..tracing.sensor import (
        has_lens,
        is_orthographic,
        pick_sensor,
        potmesil_sensor,
        stated_focus_distance,
    )

    set_variant(options.variant)
    # Optimised loading merges meshes of one material, and with them their ids and names.
    scene = mi.load_file(options.scene, optimize=False, **dict(options.define))
    if scene.integrator() is None:
        raise ValueError(f"{options.scene}: has no integrator")
    sensor = pick_sensor(scene, options.sensor)
    given, lens = given_lens(options), dict(otherwise or {})
    if not given.keys().isdisjoint(OPENINGS):
        lens = {name: value for name, value in lens.items() if name not in OPENINGS}
    lens.update(given)
    if is_orthographic(sensor):
        told = "focus_distance" in lens or stated_focus_distance(sensor) is not None
        if not (has_lens(sensor) or (told and "half_angle" in lens)):
            raise ValueError(
                f"{options.scene}: its sensor is orthographic and has no lens; describe one with "
                "--half-angle and --focus-distance"
            )
        return scene, potmesil_sensor(sensor, **lens)
    if "half_angle" in lens:
        raise ValueError(
            f"half_angle={lens['half_angle']}: is for an orthographic sensor, which the scene "
            f"{options.scene} does not have"
        )
    if not has_lens(sensor) and lens.keys().isdisjoint(OPENINGS):
        raise ValueError(
            f"{options.scene}: its sensor has no lens; describe one with --f-number (or "
            "--aperture-radius) and --focus-distance"
        )
    return scene, potmesil_sensor(sensor, **lens)


def given_lens(options: argparse.Namespace) -> dict[str, Any]:
    """Parameters of the lens that the options give."""
    return _given(options, LENS_OPTIONS)


def given_picture(options: argparse.Namespace) -> dict[str, Any]:
    """Parameters of ``PointSamples.from_image`` that the options give."""
    return _given(options, PICTURE_OPTIONS)


def given_sampling(options: argparse.Namespace, integrator: mi.Integrator) -> Sampling:
    """What the options say of the sampling, and for the rest what the integrator says."""
    from ..tracing.sampling import Sampling

    sampling = getattr(integrator, "sampling", Sampling())
    return dataclasses.replace(sampling, **_given(options, SAMPLING_OPTIONS))


def given_denoise(options: argparse.Namespace, integrator: mi.Integrator) -> bool:
    """Whether samples are denoised: what the option says, and without it the integrator."""
    if options.denoise is None:
        return bool(getattr(integrator, "denoise", False))
    return bool(options.denoise)


def given_motion(options: argparse.Namespace, integrator: mi.Integrator) -> Motion | None:
    """What moves: what the option says, and without it the integrator."""
    from ..motion.motion import Motion

    path = getattr(options, "motion", None)
    return getattr(integrator, "motion", None) if path is None else Motion.load(path)


def given_method(options: argparse.Namespace, said: Method | None = None) -> Method:
    """The method that the options describe, and for the rest ``said``, by the scene.

    Raises ``ValueError`` or ``TypeError`` that names the parameter.
    """
    from .._spec import read
    from ..focusing.methods import method_of

    given = _given(options, METHOD_OPTIONS)
    if said is None or "method" not in given:
        return method_of(given.pop("method", said or "layered"), **given)
    # Another method has those parameters of the scene's that both have, unless its text tells them.
    _, told = read(given["method"], "method")
    names = METHOD_OPTIONS.keys() - {"method", *told}
    kept = {name: getattr(said, name, None) for name in names}
    return method_of(**{**kept, **given})


def _given(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    values = {name: getattr(options, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def set_variant(names: str | None) -> None:
    """Set the first that works of Mitsuba's variants, which are those of the option."""
    import mitsuba as mi

    mi.set_variant(*(VARIANTS if names is None else names.split(",")))
