"""The option ``--cluster`` of commands that make many pictures."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .._cluster import Cluster


def add_cluster(command: argparse.ArgumentParser, what: str) -> None:
    """Add the option; ``what`` there is one task for."""
    command.add_argument(
        "--cluster", metavar="ADDRESS",
        help=f"have {what} made by the workers of a Dask cluster, such as tcp://host:8786, or by "
        "`local` ones, `local:4` by four; needs pip install 'potmesil_mi[cluster]'",
    )  # fmt: skip


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
