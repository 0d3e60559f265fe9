"""What a notebook shows of an object: a card of HTML with a small picture and a few facts."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Mapping

import numpy as np

from ._image import encoded_picture

CARD = (
    "display: inline-flex; gap: 1em; align-items: flex-start; padding: .6em .8em; "
    "border: 1px solid rgba(128, 128, 128, .4); border-radius: 6px; font-size: 90%"
)
"""Colours are those of the page around it, so that it fits light and dark ones."""

NAME = (
    "text-align: left; vertical-align: top; padding: 0 1em 0 0; font-weight: normal; "
    "white-space: nowrap; opacity: .7"
)
FACT = "text-align: left; vertical-align: top; padding: 0"
ROW = "background: transparent"
TITLE = "text-align: left; padding: 0 0 .3em 0; font-weight: bold"


def picture_uri(picture: np.ndarray, ending: str = ".jpg") -> str:
    """A linear picture, (H, W, 3), as an address that holds all of it, in sRGB."""
    kind = "png" if ending == ".png" else "jpeg"
    data = base64.b64encode(encoded_picture(picture, ending)).decode("ascii")
    return f"data:image/{kind};base64,{data}"


def card(title: str, facts: Mapping[str, str], picture: np.ndarray | None = None) -> str:
    """HTML with a ``title``, ``facts`` by their names, and a linear ``picture`` (H, W, 3).

    Texts are escaped; there are no scripts and no styles but its own.
    """
    rows = "".join(
        f'<tr style="{ROW}"><th style="{NAME}">{html.escape(name)}</th>'
        f'<td style="{FACT}">{html.escape(fact)}</td></tr>'
        for name, fact in facts.items()
    )
    head = f'<tr style="{ROW}"><th colspan="2" style="{TITLE}">{html.escape(title)}</th></tr>'
    table = f'<table style="margin: 0; border: 0">{head}{rows}</table>'
    image = ""
    if picture is not None:
        height, width = picture.shape[:2]
        image = (
            f'<img src="{picture_uri(picture)}" width="{width}" height="{height}" '
            f'alt="{html.escape(title)}" style="border-radius: 3px; margin: 0">'
        )
    return f'<div style="{CARD}">{image}{table}</div>'


def displayed(made: Callable[[], str]) -> str | None:
    """What ``made`` gives, or ``None``, for which a notebook shows the ``repr`` in its place."""
    try:
        return made()
    except Exception:
        # Whoever looks at an object in a notebook wants no error of how it is drawn.
        return None
