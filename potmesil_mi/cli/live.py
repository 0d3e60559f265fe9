"""``potmesil live``: a picture that one refocuses in a browser."""

from __future__ import annotations

import argparse
import math
import sys
from typing import TYPE_CHECKING

from .options import (
    add_motion,
    add_scene,
    add_taking,
)
from .report import Report
from .taking import SCENE, Opened, begun_with_file, samples_of_file

if TYPE_CHECKING:
    from ..viewer.view import Viewer

LIVE_EXAMPLES = """
examples:
  potmesil live example:figure11 -D res=128 --samples figure11.samples --no-browser --seconds 1
  potmesil live figure11.samples --f-number 8 --no-browser --seconds 1

Without --no-browser and --seconds it opens the browser, and ends by Ctrl-C. A picture of another
program and its depth do as well as samples. The page is for browsers on this machine alone, and for
whoever knows its address. Needs pip install 'potmesil_mi[interactive]'.
"""

MOST_PORT = 65535
"""The largest number of a port."""


def live_options(command: argparse.ArgumentParser) -> str:
    """Add the options of ``potmesil live``; returns the examples."""
    add_scene(command, "the scene, a file of `render --samples`, or a picture with its depth")
    group = command.add_argument_group("page")
    group.add_argument(
        "--port", type=int, default=0, help="that is listened on (default: one that is free)"
    )
    group.add_argument(
        "--no-browser", action="store_true", help="print the address, and open no browser"
    )
    group.add_argument(
        "--seconds", type=float, help="after which it ends by itself (default: never)"
    )
    add_taking(command)
    add_motion(command)
    return LIVE_EXAMPLES


def live(options: argparse.Namespace) -> None:
    """``potmesil live``: the page, until Ctrl-C or as long as the option says."""
    from .._validation import require_positive, require_whole
    from ..viewer.server import Live, require_server

    require_server()
    require_whole("port", options.port, 0, MOST_PORT)
    if options.seconds is not None:
        require_positive("seconds", options.seconds)
    is_scene = options.scene.lower().endswith(SCENE)
    server = Live(_view_of_scene(options) if is_scene else _view_of_file(options), options.port)
    with server.listening():
        _announce(options, server.address)
        server.run(math.inf if options.seconds is None else options.seconds)


def _announce(options: argparse.Namespace, address: str) -> None:
    """Say where the page is, and have it opened."""
    if options.json:
        Report(options).values({"address": address})
    else:
        print(address)
        until = "until Ctrl-C" if options.seconds is None else f"for {options.seconds:g} s"
        Report(options).line(f"the page is there {until}")
    sys.stdout.flush()
    if not options.no_browser:
        import webbrowser

        webbrowser.open(address)


def _view_of_scene(options: argparse.Namespace) -> Viewer:
    """The view of a scene, whose samples are taken now."""
    from ..filters.base import as_filters
    from ..viewer.beside import Beside
    from ..viewer.view import Viewer

    filters = as_filters(options.filter)
    opened = Opened.of(options)
    samples = opened.sampled(options, opened.sampling)
    is_still = not samples.moves and samples.camera.projection == "perspective"
    opened.require_kept()
    return Viewer(
        samples,
        method=opened.method,
        rfilter=opened.film.rfilter(),
        filters=filters or opened.filters,
        beside=Beside(opened.scene, opened.sensor, options.seed) if is_still else None,
    )


def _view_of_file(options: argparse.Namespace) -> Viewer:
    """The view of samples in a file, or of a picture of another program."""
    from ..viewer.view import Viewer

    method = begun_with_file(options)
    samples = samples_of_file(options.scene, options)
    if options.denoise:
        samples = samples.denoised()
    return Viewer(samples, method=method, filters=options.filter)
