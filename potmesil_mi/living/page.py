"""Pages of HTML that hold living pictures and all that shows them: they ask nobody for anything."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
from collections.abc import Sequence
from importlib.resources import files

from .._files import require_readable, require_suffix
from .._validation import shown
from .._version import package_version
from .picture import LivingPicture

HTML = (".html", ".htm")
"""Suffixes of pages."""

DATA = '<script type="application/json" class="living-picture">'
"""What stands before the JSON of a living picture."""

FIGURE = """<figure class="living">
<div class="view">
<img width="{width}" height="{height}" alt="{alt}" src="data:image/jpeg;base64,{poster}">
</div>
<noscript><p class="note">This picture is refocused by a script: JavaScript is switched off.</p>\
</noscript>
</figure>
{data}{json}</script>
"""

POLICY = "default-src 'none'; img-src data: blob:; base-uri 'none'; form-action 'none'; "
"""What a browser allows the page: pictures that are in it. Its one script and style are added."""


def page_of(pictures: Sequence[LivingPicture], title: str = "") -> str:
    """The page, as text, that shows ``pictures`` one below the other.

    ``title`` is the page's, by default that of its first picture that has one.
    """
    code, style = _part("page.js"), _part("page.css")
    titles = [title, *(picture.title for picture in pictures), "A picture to refocus"]
    policy = f"{POLICY}script-src '{_hash(code)}'; style-src '{_hash(style)}'"
    made = f"made with potmesil_mi {package_version()}"
    return _part("page.html").format(
        policy=html.escape(policy),
        title=html.escape(next(filter(None, titles))),
        heading=f"<h1>{html.escape(title)}</h1>" if title else "",
        style=style,
        figures="".join(map(_figure, pictures)),
        made=html.escape(made),
        code=code,
    )


def read_pictures(path: str | os.PathLike[str]) -> list[LivingPicture]:
    """The living pictures in a page.

    Raises ``OSError`` where it cannot be read, and ``ValueError`` or ``TypeError`` that names the
    file for one without any, or with others than :func:`page_of` writes.
    """
    path = require_suffix(require_readable(path), HTML)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: must be a page with living pictures, in UTF-8") from None
    found = re.findall(re.escape(DATA) + "(.*?)</script>", text, re.DOTALL)
    if not found:
        raise ValueError(f"{path}: must be a page with living pictures, and has none")
    try:
        return [LivingPicture.from_dict(_parsed(one)) for one in found]
    except (ValueError, TypeError) as error:
        raise type(error)(f"{path}: {error}") from error


def _figure(picture: LivingPicture) -> str:
    values = picture.to_dict()
    width, height = picture.size
    return FIGURE.format(
        width=width,
        height=height,
        alt=html.escape(picture.title or "A picture to refocus"),
        poster=values["poster"],
        data=DATA,
        # A script's text ends at the first "</script", whatever it is in.
        json=json.dumps(values, separators=(",", ":")).replace("<", "\\u003c"),
    )


def _parsed(text: str) -> object:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(f"{shown(text)}: must be JSON") from None


def _part(name: str) -> str:
    """A part of the page that comes with the package."""
    return (files(__package__) / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """What the policy calls a script or a style by."""
    digest = hashlib.sha256(text.encode("utf-8")).digest()
    return f"sha256-{base64.b64encode(digest).decode('ascii')}"
