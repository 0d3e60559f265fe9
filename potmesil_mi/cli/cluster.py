"""Options of commands that make many pictures, and the cluster that one of them names."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .._cluster import Cluster


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
