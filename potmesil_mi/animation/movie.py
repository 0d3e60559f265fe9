"""Movies of frames that have been written, by ffmpeg."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .._files import require_writable, written_whole
from .._image import read_srgb
from .._progress import track

MOVIES = (".mp4", ".mov", ".mkv")
"""Suffixes of the files that :func:`write_movie` writes."""

QUALITY = "18"
"""Constant rate factor of H.264: 18 can hardly be told from the frames; more is smaller."""

COLOURS = (
    *("-vf", "scale=out_color_matrix=bt709", "-pix_fmt", "yuv420p", "-colorspace", "bt709"),
    *("-color_primaries", "bt709", "-color_trc", "iec61966-2-1"),
)
"""What players are told of the colours, which are sRGB."""


def require_extra() -> str:
    """The program ffmpeg. Raises ``ImportError`` without the extra ``movie``."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise ImportError(
            f"movies need imageio-ffmpeg: pip install 'potmesil_mi[movie]' ({error})"
        ) from None
    return str(get_ffmpeg_exe())


def write_movie(path: str | os.PathLike[str], frames: Sequence[Path], fps: float) -> None:
    """Write a movie of pictures in files, all of one size, ``fps`` of them a second.

    Colours of linear pictures become sRGB; alpha is left out. A picture with an odd number of
    columns or rows gets one more, like the last. Raises ``OSError`` where it cannot be written,
    ``ValueError`` for pictures of several sizes, ``ImportError`` without the extra ``movie``.
    """
    program, path = require_extra(), require_writable(path, MOVIES)
    height, width = read_srgb(frames[0]).shape[:2]
    size = f"{width + width % 2}x{height + height % 2}"
    read = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(fps), "-i", "-")
    write = ("-an", "-c:v", "libx264", "-crf", QUALITY, *COLOURS)
    with written_whole(path) as temporary:
        command = [program, "-loglevel", "error", "-y", *read, *write, str(temporary)]
        # No shell reads the command, and the name of a temporary file begins with a dot.
        with subprocess.Popen(  # noqa: S603
            command, stdin=subprocess.PIPE, stderr=subprocess.PIPE
        ) as ffmpeg:
            assert ffmpeg.stdin is not None
            try:
                for frame in track(frames, "Movie"):
                    ffmpeg.stdin.write(_even(frame, (height, width), frames[0]))
            except BrokenPipeError:
                pass  # It has ended, and says why.
            except BaseException:
                ffmpeg.kill()
                raise
            _, said = ffmpeg.communicate()
        if ffmpeg.returncode != 0:
            last = said.decode(errors="replace").strip().splitlines()[-1:]
            raise OSError(f"{path}: ffmpeg could not write it: {''.join(last)}")


def _even(frame: Path, size: tuple[int, int], first: Path) -> bytes:
    """The pixels of a frame, of a ``size`` (H, W) like the ``first``, made even."""
    picture = read_srgb(frame)
    if picture.shape[:2] != size:
        raise ValueError(
            f"{frame}: has {picture.shape[1]}x{picture.shape[0]} pixels, must have "
            f"{size[1]}x{size[0]} as {first} has"
        )
    return np.pad(picture, ((0, size[0] % 2), (0, size[1] % 2), (0, 0)), mode="edge").tobytes()
