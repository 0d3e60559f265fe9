"""Options of commands that make pictures in parts, and the cluster that one of them names."""

from __future__ import annotations

import argparse
import contextlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .._cluster import Cluster
    from ..samples.point_samples import PointSamples


def add_many(command: argparse.ArgumentParser, task: str, many: str, made: str) -> None:
    """Add the options of a command that makes ``many`` things, and has a ``task`` for each.

    What it has ``made`` stays, unless it is asked for anew.
    """
    command.add_argument(
        "--shard", metavar="3/64", help=f"one of so many parts of the {many}, for several machines"
    )
    command.add_argument(
        "--cluster", metavar="ADDRESS",
        help=f"have {task} made by the workers of a Dask cluster, such as tcp://host:8786, or by "
        "`local` ones, `local:4` by four; needs pip install 'potmesil_mi[cluster]'",
    )  # fmt: skip
    command.add_argument(
        "--overwrite", action="store_true", help=f"make {made} anew that are there already"
    )


def add_tiles(command: argparse.ArgumentParser) -> None:
    """Add the options of a command that makes one picture, which may be formed by tiles."""
    group = command.add_argument_group("tiles", "the picture is the same with and without")
    group.add_argument(
        "--tiles", metavar="COLUMNSxROWS", type=_columns_and_rows,
        help="form the picture by tiles, such as 2x2, one after the other: with less memory, and "
        "slower",
    )  # fmt: skip
    group.add_argument(
        "--cluster", metavar="ADDRESS",
        help="have each tile formed by the workers of a Dask cluster, such as tcp://host:8786, or "
        "by `local` ones, `local:4` by four; needs pip install 'potmesil_mi[cluster]'",
    )  # fmt: skip


def _columns_and_rows(text: str) -> tuple[int, int]:
    """The columns and rows of tiles, as an option says them."""
    found = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text}: must be columns and rows, such as 2x2")
    return int(found[1]), int(found[2])


@contextlib.contextmanager
def given_forming(options: argparse.Namespace) -> Iterator[Callable[..., Any]]:
    """What forms the picture of samples through their lens, as the options say, within the block.

    It takes the samples and what ``potmesil_mi.focus`` takes besides. Raises ``ValueError`` for a
    cluster without tiles.
    """
    from ..focusing.api import focus

    if options.cluster is None:
        yield lambda samples, **how: focus(samples, samples.lens, tiles=options.tiles, **how)
        return
    if options.tiles is None:
        raise ValueError(f"cluster={options.cluster}: needs --tiles, such as 4x4")
    from ..focusing.tiles.forming import focus_by_tiles
    from ..focusing.tiles.workers import tiles_elsewhere

    with given_cluster(options, Path(options.output[0]).parent) as cluster:
        assert cluster is not None

        def form(samples: PointSamples, **how: Any) -> Any:
            with tiles_elsewhere(cluster, samples) as doing:
                return focus_by_tiles(
                    samples, samples.lens, tiles=options.tiles, doing=doing, **how
                )

        yield form


@contextlib.contextmanager
def given_cluster(options: argparse.Namespace, folder: Path) -> Iterator[Cluster | None]:
    """The cluster that the option says, ``None`` without; output is written in the ``folder``."""
    if options.cluster is None:
        yield None
        return
    from .. import _backend as jit
    from .._cluster import joined

    # Dask has threads, too, but they evaluate nothing.
    with joined(options.cluster, folder, options.variant) as cluster, jit.alone():
        yield cluster
