"""Frames of an animation in files: which ones, by what names, and which are there already."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._files import require_each_once, require_writable
from .._image import PICTURES, PictureForm, require_format, write_picture
from .._validation import shown

if TYPE_CHECKING:
    from typing_extensions import Unpack

RANGE = re.compile(r"(\d+)(?:-(\d+))?")
SHARD = re.compile(r"(\d+)/(\d+)")
PLACE = re.compile(r"\{(?::0?\d{0,2}d?)?\}")
BRACE = re.compile(r"[{}]")


def chosen_frames(every: range, frames: str | None = None, shard: str | None = None) -> list[int]:
    """The frames that are meant, of ``every`` one of an animation.

    ``frames`` are numbers and ranges with commas between, such as ``10-20,35``; ``shard``, such as
    ``3/64``, is the third of 64 parts of these, of every 64th frame. Raises ``ValueError`` that
    names what is wrong, and for frames that there are not.
    """
    chosen = list(every)
    if frames is not None:
        numbers: set[int] = set()
        for part in frames.split(","):
            match = RANGE.fullmatch(part.strip())
            first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
            if first > last:
                raise ValueError(f"frames={shown(frames)}: must be such as 10-20 or 3,10-20")
            if first not in every or last not in every:
                raise ValueError(
                    f"frames={shown(frames)}: must be among {every.start}-{every.stop - 1}, the "
                    "frames of the animation"
                )
            numbers.update(range(first, last + 1))
        chosen = sorted(numbers)
    if shard is not None:
        match = SHARD.fullmatch(shard.strip())
        number, count = (int(match[1]), int(match[2])) if match else (0, 0)
        if not 1 <= number <= count:
            raise ValueError(f"shard={shown(shard)}: must be such as 3/64, from 1/64 to 64/64")
        chosen = chosen[number - 1 :: count]
    return chosen


class FrameFiles:
    """Files of frames, by patterns such as ``frame_{:04d}.exr``, and a name for each of them.

    ``form`` is how :func:`write_picture` is to keep each. Raises ``ValueError`` for a pattern
    without a place for the number, or with another one.
    """

    def __init__(
        self,
        patterns: Sequence[str],
        **form: Unpack[PictureForm],
    ) -> None:
        self.patterns, self.form = patterns, form
        require_each_once(patterns)
        for pattern in patterns:
            if len(PLACE.findall(pattern)) != 1 or BRACE.search(PLACE.sub("", pattern)):
                raise ValueError(
                    f"output={shown(pattern)}: must have one place for the number of the frame, "
                    "such as frame_{:04d}.exr"
                )

    def check(self, frames: Iterable[int], sources: Iterable[str]) -> None:
        """Find out before the first frame that one cannot be written, or would replace a source.

        Raises what :func:`potmesil_mi._files.require_writable` does, and ``ValueError``.
        """
        kept = {Path(source).resolve(): source for source in sources}
        folders: dict[Path, Path] = {}
        for path in (path for frame in frames for path in self.of(frame)):
            folders.setdefault(path.parent, path)
            source = kept.get(path.resolve())
            if source is not None:
                raise ValueError(f"{source}: a frame must not take its place")
        for path in folders.values():
            require_writable(path, PICTURES)
        # Also where there are no frames to write.
        require_format(self.of(0), **self.form)

    def of(self, frame: int) -> list[Path]:
        """The files of a frame."""
        return [Path(pattern.format(frame)) for pattern in self.patterns]

    def are_there(self, frame: int) -> bool:
        """Whether a frame is finished: files are written whole or not at all."""
        return all(path.is_file() for path in self.of(frame))

    def older_than(self, frames: Iterable[int], sources: Iterable[str | Path]) -> list[Path]:
        """Files of finished frames that are older than one of the files they were made of."""
        newest = max(os.stat(source).st_mtime for source in sources)
        every = (path for frame in frames for path in self.of(frame))
        return [path for path in every if path.stat().st_mtime < newest]

    def write(self, frame: int, picture: object, said: Mapping[str, Any] | None = None) -> None:
        """Write a frame with what is ``said`` of it, see :func:`write_picture`."""
        for path in self.of(frame):
            write_picture(picture, path, said, **self.form)
