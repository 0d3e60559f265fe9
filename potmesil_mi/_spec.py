"""Specs: families of frozen dataclasses, each with a text such as ``polygon:blades=6,rotation=15``.

A family is a direct subclass of :class:`Spec`; its members are the classes below it that have a
``name``. They register themselves as they are defined, so a class of one's own is a member::

    @dataclasses.dataclass(frozen=True)
    class Ring(Aperture):
        inner: float = 0.5
        name: ClassVar[str] = "ring"

    Aperture.parse("ring:inner=0.7") == Ring(0.7)
"""

from __future__ import annotations

import dataclasses
import importlib
import re
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np

from ._validation import shown

S = TypeVar("S", bound="Spec")

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
"""What the name of a member may look like, so that a text can begin with it."""


class Spec:
    """A member of a family: a frozen dataclass that has a text.

    A family is declared by ``class Aperture(Spec, family="aperture", modules=(...))``; the modules
    define the members that the package itself offers, and are imported when a name is not known
    yet. A field with ``metadata={"spec": False}`` is no parameter of the text. What it has cannot
    be told then, unless members are equal whatever they have there (``compare=False``).
    """

    name: ClassVar[str]
    """What the text of a member begins with; a class without one is no member."""

    _family: ClassVar[str] = "spec"
    _modules: ClassVar[Sequence[str]] = ()
    _registered: ClassVar[dict[str, type[Any]]] = {}

    def __init_subclass__(
        cls, family: str | None = None, modules: Sequence[str] = (), **options: Any
    ) -> None:
        super().__init_subclass__(**options)
        if family is not None:
            cls._family, cls._modules, cls._registered = family, modules, {}
            return
        name = cls.__dict__.get("name")
        if name is None:
            return
        if not isinstance(name, str) or not NAME.fullmatch(name):
            raise ValueError(
                f"name={shown(name)}: must be a word of letters, digits, - and _, to name the "
                f"{cls._family} {cls.__qualname__}"
            )
        known = cls._registered.get(name)
        if known is not None and not _is_anew(cls, known):
            raise ValueError(f"name={name!r}: is that of the {cls._family} {_place(known)} already")
        cls._registered[name] = cls

    @classmethod
    def members(cls: type[S]) -> dict[str, type[S]]:
        """The classes of the family by their names; those of the package come first."""
        for module in cls._modules:
            importlib.import_module(module)
        own = {module: place for place, module in enumerate(cls._modules)}
        kinds = [kind for kind in cls._registered.values() if issubclass(kind, cls)]
        kinds.sort(key=lambda kind: own.get(kind.__module__, len(own)))
        return {kind.name: kind for kind in kinds}

    @classmethod
    def member(cls: type[S], name: str, *, from_file: bool = False) -> type[S]:
        """The class with this name. Raises ``ValueError`` that says which there are."""
        kind = cls._registered.get(name) or cls.members().get(name)
        if kind is not None and issubclass(kind, cls):
            return kind
        known = ", ".join(cls.members())
        before = "before the file is loaded" if from_file else "first"
        raise ValueError(
            f"{cls._family}={shown(name)}: must be one of {known}; a class of your own with this "
            f"name must be defined, or its module imported, {before}"
        )

    @classmethod
    def parse(cls: type[S], described: S | str, *, from_file: bool = False) -> S:
        """The member that a text such as ``polygon:blades=6`` describes; a member is itself.

        That is the name, and after a colon parameters with commas between; what has several
        values has slashes between, as in ``fade:amount=0.5,color=1/0.9/0.8``. ``from_file`` is for
        a text that was not written by the user: it may name no file. Raises ``TypeError`` for what
        is neither text nor member, and ``ValueError`` or ``TypeError`` that names what is unknown,
        missing or out of range.
        """
        if isinstance(described, cls):
            return described
        if not isinstance(described, str):
            raise TypeError(
                f"{cls._family}={shown(described)}: must be one of "
                f"{', '.join(kind.__name__ + '()' for kind in cls.members().values())}, or text "
                f"such as {next(iter(cls.members()), 'name')}"
            )
        name, parameters = read(described, cls._family)
        kind = cls.member(name, from_file=from_file)
        return kind.of_parameters(parameters, from_file=from_file)

    @classmethod
    def of_parameters(cls: type[S], parameters: Mapping[str, Any], *, from_file: bool = False) -> S:
        """The member with the parameters of a text; see :meth:`parse` for what is raised."""
        fields = {field.name: field for field in cls._fields()}
        for key in parameters:
            if key not in fields:
                raise ValueError(
                    f"{key}: not a parameter of the {cls._family} {cls.name}, which has "
                    f"{', '.join(fields) or 'none'}"
                )
        for key, field in fields.items():
            if _default(field) is dataclasses.MISSING and key not in parameters:
                raise ValueError(
                    f"{cls._family}={cls.name!r}: needs {key}, as in {cls.name}:{key}=0.5"
                )
        return cls(**parameters)

    def describe(self) -> str:
        """The text, with all parameters, of which :meth:`parse` makes an equal member.

        Raises ``ValueError`` for a parameter that no text can tell.
        """
        return self._text(defaults=True)

    def __str__(self) -> str:
        """The text with the parameters that are not the default ones; ``repr`` if there is none."""
        try:
            return self._text(defaults=False)
        except (ValueError, TypeError):
            return repr(self)

    def _text(self, *, defaults: bool) -> str:
        kind = type(self)
        if "name" not in kind.__dict__:
            raise TypeError(f"{kind.__qualname__}: has no name, so no text describes it")
        told = [field.name for field in kind._fields()]
        values = {}
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            if not field.init or not field.compare:
                continue
            value, default = getattr(self, field.name), _default(field)
            same = value is default or value == default
            usual = isinstance(same, bool) and same
            if field.name in told and not (usual and (default is None or not defaults)):
                values[field.name] = value
            elif field.name not in told and not usual:
                raise ValueError(f"{field.name}={shown(value)}: cannot be told in a text")
        text = written(kind.name, values)
        _require_told(text, values)
        return text

    @classmethod
    def _fields(cls) -> list[dataclasses.Field[Any]]:
        """The fields that are parameters of the text."""
        settings = cls.__dict__.get("__dataclass_params__")
        if settings is None or not settings.frozen:
            raise TypeError(
                f"{cls.__qualname__}: must be a frozen dataclass, as by "
                "@dataclasses.dataclass(frozen=True), to be described by a text"
            )
        fields = dataclasses.fields(cls)  # type: ignore[arg-type]
        return [field for field in fields if field.init and field.metadata.get("spec", True)]


def read(text: str, what: str) -> tuple[str, dict[str, Any]]:
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
                f"{what}={shown(text)}: must be a name, or name:parameter=value,parameter=value"
            )
        parameters[key] = _value(value)
    return name.strip(), parameters


def written(name: str, parameters: Mapping[str, Any]) -> str:
    """The text of which :func:`read` makes the same name and parameters."""
    given = ",".join(f"{key}={_text(value)}" for key, value in parameters.items())
    return f"{name}:{given}" if given else name


def _require_told(text: str, values: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` unless :func:`read` finds ``values`` in ``text``."""
    try:
        told = read(text, "spec")[1]
    except ValueError:
        told = {}
    for key, value in values.items():
        # Several values of which there is one read as that one.
        single = value[0] if isinstance(value, tuple) and len(value) == 1 else value
        if key not in told or told[key] not in (value, single):
            raise ValueError(
                f"{key}={shown(value)}: cannot be told in a text; must be a number, true or false, "
                "several numbers, or a text without commas"
            )


def _is_anew(kind: type[Any], known: type[Any]) -> bool:
    """Whether a class is a known one, defined anew; in a notebook it may have another name."""
    return _place(kind) == _place(known) or kind.__module__ == known.__module__ == "__main__"


def _place(kind: type[Any]) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _text(value: Any) -> str:
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, tuple):
        return "/".join(map(_text, value))
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
