"""Descriptions in one word, for command lines and scenes: ``polygon:blades=6,rotation=15``."""

from __future__ import annotations

from typing import Any


def described(text: str, what: str) -> tuple[str, dict[str, Any]]:
    """The name and the parameters in ``name:parameter=value,parameter=value``.

    Values are whole numbers, numbers, ``true`` or ``false``, several numbers with ``/`` between,
    or else text. Raises ``ValueError`` that names ``what``, where there is no such form.
    """
    name, _, rest = text.strip().partition(":")
    parameters: dict[str, Any] = {}
    for part in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not name or not key or not equals or not value or key in parameters:
            raise ValueError(
                f"{what}={text!r}: must be a name, or name:parameter=value,parameter=value"
            )
        parameters[key] = _value(value)
    return name.strip(), parameters


def describe(name: str, parameters: dict[str, Any]) -> str:
    """The text of which :func:`described` makes the same name and parameters."""
    given = ",".join(f"{key}={_text(value)}" for key, value in parameters.items())
    return f"{name}:{given}" if given else name


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return "/".join(map(repr, value))
    return str(value)


def _value(text: str) -> Any:
    if text in ("true", "false"):
        return text == "true"
    for kind in (int, float, _several):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _several(text: str) -> tuple[float, ...]:
    return tuple(float(number) for number in text.split("/"))
