"""``potmesil animate``: frames of an animation."""

from __future__ import annotations

import argparse
import dataclasses
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .cluster import add_many, given_cluster
from .given import given_form
from .options import (
    FileAction,
    add_denoise,
    add_form,
    add_lens,
    add_method,
    add_picture,
    add_samples,
    add_sampling,
    add_scene,
    add_variant,
)
from .report import Report
from .taking import (
    SCENE,
    Opened,
    begun_with_file,
    samples_of_file,
    sampling_for,
    tell_done,
)

if TYPE_CHECKING:
    from .._cluster import Cluster
    from ..animation.animation import Animation
    from ..animation.frames import FrameFiles
    from ..focusing.session import FocusSession

ANIMATE_EXAMPLES = """
examples:
  potmesil animate example:figure11 example:motions/pull -D res=128 --samples pull.samples \\
    -o 'frames/pull_{:04d}.png' -o pull.mp4
  potmesil animate pull.samples example:motions/pull -o 'pull_{:04d}.exr' --frames 4-6
  potmesil animate pull.samples example:motions/pull -o 'pull_{:04d}.exr' --shard 2/3

An animation, for example:

  frames = 100                     # 0 to 99; or [first, last]
  [lens]
  focus_distance = [[0, 550, "ease"], [99, 2000]]
  f_number = 2.8
  [[filters]]
  name = "fade"
  amount = [[0, 1], [12, 0]]

Samples are taken once. Frames that are there already stay, so that what was interrupted goes on.
"""


def animate_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil animate``; returns the examples."""
    add_scene(command, "the scene, a file of `render --samples`, or a picture with its depth")
    command.add_argument(
        "animation", metavar="ANIMATION.toml", action=FileAction, help="what changes, see below"
    )
    command.add_argument(
        "-o", "--output", metavar="PATTERN", action="append", required=True,
        help="pictures to write, such as frame_{:04d}.exr (or .png, .jpg, .tif), with the number "
        "of the frame in the braces; may be given several times. And a movie of them, such as "
        "pull.mp4, which needs pip install 'potmesil_mi[movie]'",
    )  # fmt: skip
    add_form(command)
    command.add_argument("--frames", metavar="10-20", help="which frames (default: all)")
    add_many(command, "each frame", "frames", "frames")
    add_variant(command)
    add_samples(command)
    add_denoise(command, "what the scene's integrator says")
    add_sampling(command)
    add_lens(command)
    add_method(command)
    add_picture(command)
    return ANIMATE_EXAMPLES


def animate(options: argparse.Namespace) -> None:
    """``potmesil animate``: samples once, then the frames."""
    from .._files import require_writable
    from ..animation.animation import Animation
    from ..animation.frames import FrameFiles, chosen_frames
    from ..animation.movie import MOVIES, write_movie
    from ..samples.files import ENDINGS

    report = Report(options)
    movies = [path for path in options.output if Path(path).suffix.lower() in MOVIES]
    files = FrameFiles(
        [path for path in options.output if path not in movies], **given_form(options)
    )
    _check_movies(options, movies, files)
    animation = Animation.load(options.animation)
    chosen = chosen_frames(animation.frames, options.frames, options.shard)
    done = [] if options.overwrite else [frame for frame in chosen if files.are_there(frame)]
    frames = sorted(set(chosen) - set(done))
    sources = [options.scene, *([options.samples] if options.samples else [])]
    files.check(chosen, sources)
    if done:
        of = options.scene, options.animation
        tell_done(report, "frames", len(done), len(chosen), files.older_than(done, of), of)
    if options.samples:
        require_writable(options.samples, ENDINGS)
        if not frames:
            warnings.warn(
                f"samples={options.samples}: are not taken, for all frames are there already; "
                "`potmesil render --samples` takes them, and --overwrite makes frames anew",
                stacklevel=1,
            )
    if frames and not options.scene.lower().endswith(SCENE):
        _of_file(options, animation, frames, files)
    elif frames:
        _of_scene(options, animation, frames, files)
    for movie in movies:
        write_movie(movie, [files.of(frame)[0] for frame in chosen], animation.fps)
    report.files([*options.output], f"{len(frames)} of {len(chosen)} frames were made")


def _check_movies(options: argparse.Namespace, movies: list[str], files: FrameFiles) -> None:
    """Find out before the first frame that there can be no movie."""
    from .._files import require_writable
    from ..animation.movie import MOVIES, require_extra

    for movie in movies:
        require_extra()
        require_writable(movie, MOVIES)
        if not files.patterns:
            raise ValueError(
                f"output={movie!r}: a movie is made of frames, which must have names, too, such as "
                "-o frame_{:04d}.png"
            )
        if options.frames or options.shard:
            raise ValueError(
                f"output={movie!r}: a movie is of all frames, without --frames, --shard"
            )


def _of_scene(
    options: argparse.Namespace, animation: Animation, frames: list[int], files: FrameFiles
) -> None:
    """The frames of a scene, sampled as all of the animation needs it."""
    from ..focusing.session import FocusSession

    if animation.moves:
        _of_moving_scene(options, animation, frames, files)
        return
    opened = _opened(options, animation)
    lens = opened.sensor.lens()
    if animation.shutter is not None:
        warnings.warn("shutter: has no effect, for neither camera nor shapes move", stacklevel=1)
    sampling = sampling_for(lens, animation.lenses(lens), opened.sampling)
    filters = () if animation.filters else opened.filters
    with given_cluster(options, _folder(files, frames)) as cluster:
        session = FocusSession(opened.sampled(options, sampling), opened.method)
        picture = {"rfilter": opened.film.rfilter(), "alpha": opened.has_alpha}
        _do(cluster, animation, session, frames, files, filters=filters, **picture)
    opened.require_kept()


def _folder(files: FrameFiles, frames: list[int]) -> Path:
    """Where the first of the frames is written, or else the folder at hand."""
    return next((path.parent for path in files.of(frames[0])), Path())


def _do(
    cluster: Cluster | None,
    animation: Animation,
    session: FocusSession,
    frames: list[int],
    files: FrameFiles,
    **picture: Any,
) -> None:
    """Form and write frames of the same samples, by a cluster if there is one."""
    from ..animation.workers import frames_elsewhere, said_of

    if cluster is not None:
        frames_elsewhere(cluster, animation, session, frames, files, **picture)
        return
    said = said_of(animation, session)
    for frame, formed in animation.pictures(session, frames, **picture):
        files.write(frame, formed, said(frame))


def _opened(options: argparse.Namespace, animation: Animation) -> Opened:
    """The scene. Raises ``ValueError`` for one that has a motion of its own."""
    opened = Opened.of(options, animation.first_lens())
    if opened.motion is not None:
        raise ValueError(
            f"motion: {options.scene} has one, for a single picture; tell by [camera], [shapes.ID] "
            f"and [shutter] of {options.animation} what moves"
        )
    return opened


def _of_moving_scene(
    options: argparse.Namespace, animation: Animation, frames: list[int], files: FrameFiles
) -> None:
    """The frames of a scene that has samples of its own for each: their seeds differ, too."""
    from .._progress import reported, step_progress
    from ..animation.workers import do_frames
    from ..tracing.exposing import require_motions

    if options.samples:
        raise ValueError(
            f"samples={options.samples!r}: must not be given where something moves, and each frame "
            "has its own"
        )
    moving = _Moving(options, animation, files)
    opened = moving.prepared()
    lens = opened.sensor.lens()
    # What is wrong in a frame is found before the first.
    for frame in frames:
        animation.lens_at(lens, frame)
    motions = [animation.motion_at(frame) for frame in frames]
    require_motions(opened.scene, opened.sensor, motions)
    with given_cluster(options, _folder(files, frames)) as cluster, reported() as report:
        if cluster is not None:
            cluster.require_shared("a scene in which something moves")
            do_frames(cluster, moving, frames, files)
            return
        for done, frame in enumerate(frames):
            with step_progress(report, f"Frame {frame}", done, len(frames), within=False):
                moving.do(opened, frame)


@dataclasses.dataclass(frozen=True)
class _Moving:
    """Takes the samples of frames of a scene, forms and writes them: a job for workers, too."""

    options: argparse.Namespace
    animation: Animation
    files: FrameFiles

    def prepared(self, file: Path | None = None) -> Opened:
        """The scene."""
        return _opened(self.options, self.animation)

    def do(self, prepared: Opened, task: int) -> None:
        """Make a frame."""
        from ..focusing.api import focus
        from ..samples.formed import attributes_of_formed

        opened, options, own = prepared, self.options, prepared.sensor.lens()
        lens, motion = self.animation.lens_at(own, task), self.animation.motion_at(task)
        sampling = sampling_for(own, [lens], opened.sampling)
        samples = opened.sampled(options, sampling, options.seed + task, motion)
        picture = focus(
            samples,
            lens,
            method=opened.method,
            filters=self.animation.filters_at(task) or opened.filters,
            rfilter=opened.film.rfilter(),
            alpha=opened.has_alpha,
        )
        said = attributes_of_formed(samples, opened.method, lens)
        self.files.write(task, picture, said)


def _of_file(
    options: argparse.Namespace, animation: Animation, frames: list[int], files: FrameFiles
) -> None:
    """The frames of samples in a file, or of a picture of another program."""
    from ..focusing.session import FocusSession

    method = begun_with_file(options)
    if animation.moves:
        raise ValueError(
            f"{animation.moves}: moves, which asks for a scene, and {options.scene} has its "
            "samples already"
        )
    with given_cluster(options, _folder(files, frames)) as cluster:
        samples = samples_of_file(options.scene, options, animation)
        if options.denoise:
            samples = samples.denoised()
        _do(cluster, animation, FocusSession(samples, method), frames, files)
