"""Strict conversion between dataclasses and the plain values of TOML and JSON files, in both directions.

:func:`from_plain` makes a dataclass from a parsed document. It converts nothing silently: ``"3"`` is not accepted as
3, and ``true`` is not accepted as 1. The only exception is a whole number where a number with decimals is expected. An
unknown key is refused, and the message suggests the nearest known key. The allowed values of a dataclass follow from
its types (``Literal``, ``tuple[float, float]``, ``float | None``), from :class:`Bounds` and :class:`Length` in
``Annotated``, and from its own ``__post_init__``. Every message names the table and the key:
``[protocol] depth_mm = 'x': must be a finite number``::

    @dataclass(frozen=True, kw_only=True)
    class Holder:
        rim_mm: Annotated[float, Bounds(-50.0, 50.0)] = 2.0
        gap_mm: Annotated[float, Bounds(0.0)]

    @dataclass(frozen=True, kw_only=True)
    class Document:
        holder: Holder

    document = read_toml(path, Document, "study")
"""

from __future__ import annotations

import dataclasses
import datetime
import enum
import inspect
import math
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError, nearest
from tacbench_cad.util.text import decimal_hint

if TYPE_CHECKING:
    from cattrs import Converter

T = TypeVar("T")
#: A function that gets a plain value and a type, and returns a value of that type.
Hook = Callable[[Any, Any], Any]

#: The first and the last year that a date may have.
MIN_YEAR, MAX_YEAR = 1970, 2200


@dataclass(frozen=True)
class Bounds:
    """The range of a number, as metadata: ``Annotated[float, Bounds(0.0, 10.0)]``.

    Args:
        low: The smallest allowed value.
        high: The largest allowed value.
    """

    low: float = -math.inf
    high: float = math.inf

    def refusal(self, value: Any) -> str | None:
        """Why the value is not allowed, or None."""
        if value is None or self.low <= value <= self.high:
            return None
        number = "a whole number " if isinstance(value, int) else ""
        low, high = (f"{bound:.15g}" for bound in (self.low, self.high))
        if math.isinf(self.high):
            return f"must be {number}{'of ' if number else ''}at least {low}"
        if math.isinf(self.low):
            return f"must be {number}{'of ' if number else ''}at most {high}"
        return f"must be {number}from {low} to {high}"


@dataclass(frozen=True)
class Length:
    """The number of items that a list or a table may have, as metadata: ``Annotated[tuple[float, ...], Length(1)]``.

    Args:
        low: The smallest allowed number of items.
        high: The largest allowed number of items.
    """

    low: int = 0
    high: int = 10_000_000

    def refusal(self, value: Any) -> str | None:
        """Why the value is not allowed, or None."""
        if value is None or self.low <= len(value) <= self.high:
            return None
        return (
            f"must have at least {self.low} items" if len(value) < self.low else f"may have at most {self.high} items"
        )


@dataclass(frozen=True)
class NumberAsText:
    """Metadata of ``Annotated[str, NumberAsText()]``: a whole number is accepted and becomes a string."""


#: A string that may also be written as a whole number: ``textures = [1, "waves.toml"]``.
Word = Annotated[str, NumberAsText()]


class _FaultError(Exception):
    """A value that is not allowed, with the keys and indices that lead to it."""

    def __init__(self, value: Any, allowed: str, path: tuple[str | int, ...] = (), ending: str | None = None) -> None:
        super().__init__(allowed)
        self.value, self.allowed, self.path = value, allowed, path
        #: The text after the table's name in the message, where a dataclass itself refused one of its fields. It is
        #: empty where the whole table is at fault, and None otherwise.
        self.ending = ending

    def within(self, step: str | int) -> _FaultError:
        return _FaultError(self.value, self.allowed, (step, *self.path), self.ending)

    @property
    def field(self) -> str:
        """The place of the value in the document: ``[study] [[prints]] 2: copies``."""
        text, names = "", list[str]()
        path = list(self.path)
        while path and isinstance(path[-1], int) and self.ending is None:
            path.pop()
        for step in path:
            if isinstance(step, str):
                names.append(step)
                continue
            *tables, key = names or [""]
            text, names = text + (f"[{'.'.join(tables)}] " if tables else "") + f"[[{key}]] {step}: ", []
        if self.ending is not None:
            return (text + (f"[{'.'.join(names)}] " if names else "") + self.ending).rstrip(" :")
        *tables, key = names or [""]
        return text + (f"[{'.'.join(tables)}] " if tables else "") + key


def from_plain(cls: type[T], data: Any, where: str = "") -> T:
    """Make a dataclass (or a value of any type that a field may have) from the values of a parsed document.

    The key of a field is the field's name, unless ``field(metadata={"key": "N"})`` gives another key.

    Args:
        cls: The dataclass.
        data: The values that a TOML or JSON parser returned.
        where: The beginning of every error message: ``"run.toml: "``, ``"[gauge] "``.

    Raises:
        InputError: A key is unknown or missing, or a value is not allowed.
    """
    try:
        result: T = _converter().structure(data, cls)
    except _FaultError as fault:
        raise InputError(f"{where}{fault.field}".rstrip(" :"), fault.value, fault.allowed) from None
    return result


def check_fields(value: Any) -> None:
    """Check that the fields of a dataclass have values that their types allow; to be called in ``__post_init__``.

    The converter checks values that come from a file. This function also checks objects made in Python code.

    Raises:
        InputError: A field has a value that is not allowed.
    """
    cls: Any = type(value)
    for field, key, kind, hook in _hooks(cls):
        try:
            _structured(hook, getattr(value, field.name), kind, key)
        except _FaultError as fault:
            raise InputError(fault.field, fault.value, fault.allowed) from None


class Checked:
    """Base class of dataclasses that check their fields when they are created; see :func:`check_fields`."""

    def __post_init__(self) -> None:
        check_fields(self)


def read_toml(path: Path, cls: type[T], what: str, *, within: Path | None = None) -> T:
    """Read an untrusted TOML file into a dataclass.

    Args:
        path: The file.
        cls: The dataclass of the whole document.
        what: The kind of document, for error messages: ``texture``.
        within: A folder that the file must lie in, also if ``path`` is a link.

    Raises:
        InputError: The file cannot be read, or a value is not allowed. The message names the file, table and key.
    """
    return from_plain(cls, untrusted.read_document(path, what, "toml", within=within), f"{path}: ")


def read_json(path: Path, cls: type[T], what: str, *, within: Path | None = None) -> T:
    """Read an untrusted JSON file into a dataclass; same arguments and errors as :func:`read_toml`."""
    return from_plain(cls, untrusted.read_document(path, what, "json", within=within), f"{path}: ")


def to_plain(value: Any, *, without_none: bool = False, without_defaults: bool = False) -> Any:
    """Convert an object to the plain values of TOML and JSON: tables, lists, strings, numbers, booleans and None.

    - A dataclass becomes a table with a key for each field. The key is the field's name, unless
      ``field(metadata={"key": "N"})`` gives another key; a field with ``metadata={"key": None}`` is left out.
    - Tuples and sets become lists.
    - Paths and enums become strings.
    - NumPy numbers and arrays become Python numbers and lists.

    Args:
        value: The object.
        without_none: Leave out fields that are None (TOML has no such value).
        without_defaults: Leave out fields that have their default value.

    Raises:
        TypeError: A value cannot be written as plain values.
    """

    def plain(inner: Any) -> Any:
        return to_plain(inner, without_none=without_none, without_defaults=without_defaults)

    if value is None or type(value) in (bool, int, float, str):
        return value
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = ((field, key, getattr(value, field.name)) for field, key in _keys(type(value)))
        return {
            key: plain(inner)
            for field, key, inner in items
            if not (without_none and inner is None) and not (without_defaults and _is_default(field, inner))
        }
    if isinstance(value, enum.Enum):
        return plain(value.value)
    if isinstance(value, Mapping):
        return {str(plain(key)): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(inner) for inner in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, (datetime.date, datetime.time)):
        return value.isoformat()
    if hasattr(value, "tolist"):  # an array or a number of NumPy
        return plain(value.tolist())
    for kind in (int, float, str):  # a subclass
        if isinstance(value, kind):
            return kind(value)
    raise TypeError(f"a {type(value).__name__} has no plain form")


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
    if field.default_factory is not dataclasses.MISSING:
        return bool(value == field.default_factory())
    return field.default is not dataclasses.MISSING and bool(value == field.default)


def _keys(cls: Any) -> Iterator[tuple[dataclasses.Field[Any], str]]:
    """Yield the fields of a dataclass that are part of its plain form, with their keys."""
    for field in dataclasses.fields(cls):
        key = field.metadata.get("key", field.name)
        if key is not None and field.init:
            yield field, key


@cache
def _hooks(cls: Any) -> tuple[tuple[dataclasses.Field[Any], str, Any, Hook], ...]:
    """Return the same fields with their types and hooks. They are cached, because a run has about a hundred values."""
    hints = get_type_hints(cls, include_extras=True)
    return tuple(
        (field, key, hints[field.name], _converter().get_structure_hook(hints[field.name])) for field, key in _keys(cls)
    )


@cache
def _converter() -> Converter:
    from cattrs import Converter  # imported here, so that commands that read no document start faster

    converter = Converter()
    for kind, hook in ((bool, _flag), (int, _whole), (float, _number), (str, _text), (Path, _path)):
        converter.register_structure_hook(kind, hook)
    converter.register_structure_hook(datetime.datetime, _date)
    converter.register_structure_hook(datetime.date, _date)
    factories: list[tuple[Callable[[Any], bool], Any]] = [
        (dataclasses.is_dataclass, _table_hook),
        (lambda kind: get_origin(kind) in (list, tuple, Sequence), _list_hook),
        (lambda kind: get_origin(kind) in (dict, Mapping) or kind in (dict, Mapping), _mapping_hook),
        (lambda kind: get_origin(kind) in (Union, types.UnionType), _union_hook),
        (lambda kind: get_origin(kind) is Literal, _literal_hook),
        (lambda kind: isinstance(kind, type) and issubclass(kind, enum.Enum), _enum_hook),
        (lambda kind: get_origin(kind) is Annotated, _annotated_hook),
        # a field with a protocol or an abstract class as its type gets objects, and its dataclass checks them
        (
            lambda kind: getattr(kind, "_is_protocol", False) or inspect.isabstract(kind),
            lambda _kind, _: lambda value, _: value,
        ),
    ]
    for fits, factory in factories:
        converter.register_structure_hook_factory(fits, factory)
    return converter


def _flag(value: Any, _: Any) -> bool:
    if not isinstance(value, bool):
        raise _FaultError(value, "must be true or false")
    return value


def _whole(value: Any, _: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise _FaultError(value, "must be a whole number")
    if abs(value) > untrusted.MAX_WHOLE:
        raise _FaultError(None, f"must be a whole number of at most {untrusted.MAX_WHOLE}")
    return value


def _number(value: Any, _: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not -1e300 <= value <= 1e300:
        raise _FaultError(value, f"must be a finite number{decimal_hint(value) if isinstance(value, str) else ''}")
    return float(value)


def _text(value: Any, _: Any) -> str:
    if not isinstance(value, str):
        raise _FaultError(value, "must be a string")
    return value


def _path(value: Any, _: Any) -> Path:
    text = _text(value, str)
    if not text or "\0" in text:
        raise _FaultError(value, "must be a path")
    return Path(text)


def _date(value: Any, kind: Any) -> Any:
    try:
        date = value if isinstance(value, kind) else kind.fromisoformat(value)
    except (TypeError, ValueError):
        date = None
    if date is None or not MIN_YEAR <= date.year <= MAX_YEAR:
        allowed = f"must be {_meaning(kind)} between the years {MIN_YEAR} and {MAX_YEAR}, for example 2026-01-31"
        raise _FaultError(value, allowed)
    return date


def _table_hook(cls: Any, _: Converter) -> Any:
    """Return the hook that makes a dataclass from a table."""
    read = {key: (field.name, kind, hook) for field, key, kind, hook in _hooks(cls)}
    required = {
        key
        for field, key in _keys(cls)
        if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
    }

    def structure(value: Any, _: Any) -> Any:
        if isinstance(value, cls):
            return value
        if not isinstance(value, Mapping):
            raise _FaultError(None, "must be a table", ending="")
        _refuse_unknown(value, read)
        values = {}
        for key, (name, kind, hook) in read.items():
            if key in value:
                values[name] = _structured(hook, value[key], kind, key)
            elif key in required:
                if _meaning(kind) == "a table":
                    raise _FaultError(None, "this table is missing", (key,), ending="")
                if "tables" in _meaning(kind):
                    raise _FaultError(None, "at least one of these tables is needed", ending=f"[[{key}]]")
                raise _FaultError(None, f"is missing; must be {_meaning(kind)}", (key,))
        try:
            return cls(**values)
        except InputError as error:
            raise _FaultError(error.value, error.allowed, ending=error.field) from None

    return structure


def _refuse_unknown(table: Mapping[Any, Any], keys: Collection[str]) -> None:
    for key in table:
        if key not in keys:
            hint = nearest(str(key), keys)
            every = "" if hint.startswith("allowed") else f" Allowed: {', '.join(keys)}"
            raise _FaultError(None, f"unknown key; {hint}{every}", (str(key),))


def _structured(hook: Hook, value: Any, kind: Any, step: str | int) -> Any:
    try:
        return hook(value, kind)
    except _FaultError as fault:
        raise fault.within(step) from None


def _list_hook(kind: Any, converter: Converter) -> Any:
    """Return the hook that makes a tuple or a list from a list."""
    items = get_args(kind)
    open_ended = get_origin(kind) is not tuple or items[-1] is Ellipsis
    result = list if get_origin(kind) is list else tuple
    allowed = f"must be {_meaning(kind)}"
    hooks = [(item, converter.get_structure_hook(item)) for item in items if item is not Ellipsis]

    def structure(value: Any, _: Any) -> Any:
        if not isinstance(value, (list, tuple)) or (not open_ended and len(value) != len(items)):
            raise _FaultError(value, allowed)
        kinds = hooks[:1] * len(value) if open_ended else hooks
        return result(
            _structured(hook, each, item, i) for i, (each, (item, hook)) in enumerate(zip(value, kinds, strict=True), 1)
        )

    return structure


def _mapping_hook(kind: Any, converter: Converter) -> Any:
    """Return the hook that makes a dict from a table with any keys."""
    item = get_args(kind)[1] if get_args(kind) else Any
    hook = converter.get_structure_hook(item)

    def structure(value: Any, _: Any) -> Any:
        if not isinstance(value, Mapping):
            raise _FaultError(None, "must be a table", ending="")
        return {str(key): _structured(hook, each, item, str(key)) for key, each in value.items()}

    return structure


def _union_hook(kind: Any, converter: Converter) -> Any:
    """Return the hook that makes a value of one of several types: of the first type that accepts the value.

    Where several dataclasses share a ``Literal`` field, such as ``family``, the value of that field selects the
    dataclass. If no type accepts the value, the error is that of the last type.
    """
    members = [member for member in get_args(kind) if member is not type(None)]
    optional = len(members) < len(get_args(kind))
    tag, tables = _tagged([member for member in members if dataclasses.is_dataclass(member)])

    def structure(value: Any, _: Any) -> Any:
        if value is None and optional:
            return None
        if len(members) == 1:
            return converter.structure(value, members[0])
        if tag and isinstance(value, Mapping):
            if tag not in value:
                _refuse_unknown(value, dict.fromkeys(key for table in tables.values() for _, key in _keys(table)))
                raise _FaultError(None, f"is missing; must be one of {', '.join(tables)}", (tag,))
            word = _structured(converter.structure, value[tag], Literal.__getitem__(tuple(tables)), tag)
            return converter.structure(value, tables[word])
        fitting = [member for member in members if _could_be(value, member)]
        for member in fitting[:-1]:
            try:
                return converter.structure(value, member)
            except _FaultError:
                continue
        if not fitting:
            allowed = "must be " + " or ".join(dict.fromkeys(map(_meaning, members)))
            raise _FaultError(value, allowed) if len(tables) < len(members) else _FaultError(None, allowed, ending="")
        return converter.structure(value, fitting[-1])

    return structure


def _tagged(tables: list[Any]) -> tuple[str, dict[str, Any]]:
    """Find the ``Literal`` field that several dataclasses share; return its name and the dataclass of each value."""
    hints = [get_type_hints(table) for table in tables]
    for name, kind in hints[0].items() if len(hints) > 1 else ():
        if get_origin(kind) is Literal and all(get_origin(each.get(name)) is Literal for each in hints):
            return name, {
                word: table for table, each in zip(tables, hints, strict=True) for word in get_args(each[name])
            }
    return "", {}


def _could_be(value: Any, kind: Any) -> bool:
    """Whether a plain value has the right form (table, list, string or number) for a type."""
    origin = get_origin(kind)
    if origin is Annotated:
        word = any(isinstance(each, NumberAsText) for each in kind.__metadata__)
        return _could_be(value, get_args(kind)[0]) or (word and type(value) is int)
    if origin is Literal:
        return value in get_args(kind)
    if dataclasses.is_dataclass(kind) or origin in (dict, Mapping):
        return isinstance(value, Mapping)
    if origin in (list, tuple, Sequence):
        return isinstance(value, (list, tuple))
    if kind in (bool, int, float):
        return isinstance(value, kind) or (kind is float and isinstance(value, int))
    return isinstance(value, str) or not isinstance(value, (Mapping, list))


def _literal_hook(kind: Any, _: Converter) -> Any:
    words = get_args(kind)
    allowed = "allowed: " + ", ".join(map(str, words))

    def structure(value: Any, _: Any) -> Any:
        if any(value == word and type(value) is type(word) for word in words):
            return value
        if all(isinstance(word, str) for word in words):
            _text(value, str)
        raise _FaultError(value, nearest(value, map(str, words)) if isinstance(value, str) and value else allowed)

    return structure


def _enum_hook(kind: Any, _: Converter) -> Any:
    values = Literal.__getitem__(tuple(member.value for member in kind))
    check = _literal_hook(values, _)
    return lambda value, _: kind(check(value, values))


def _annotated_hook(kind: Any, converter: Converter) -> Any:
    inner, rules = get_args(kind)[0], kind.__metadata__
    hook = converter.get_structure_hook(inner)
    as_text = any(isinstance(rule, NumberAsText) for rule in rules)

    def structure(value: Any, _: Any) -> Any:
        result = hook(str(value) if as_text and type(value) is int else value, inner)
        for rule in rules:
            refusal = rule.refusal(result) if isinstance(rule, (Bounds, Length)) else None
            if refusal is not None:
                raise _FaultError(value, refusal)
        return result

    return structure


def _meaning(kind: Any, many: bool = False) -> str:
    """Return the name of a type for error messages: ``a finite number``, ``a list of 2 numbers``."""
    origin, items = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _meaning(items[0], many)
    if origin in (Union, types.UnionType):
        return _meaning(next(item for item in items if item is not type(None)), many)
    if origin in (list, tuple, Sequence):
        count = f"{len(items)} " if origin is tuple and items[-1] is not Ellipsis else ""
        return f"{'lists' if many else 'a list'} of {count}{_meaning(items[0], many=True)}"
    if origin is Literal:
        return "one of " + ", ".join(map(str, items))
    names = {
        bool: ("true or false", "booleans"),
        int: ("a whole number", "whole numbers"),
        float: ("a finite number", "numbers"),
        str: ("a string", "strings"),
        Path: ("a path", "paths"),
        datetime.datetime: ("a date and time", "dates and times"),
        datetime.date: ("a date", "dates"),
    }
    single, plural = names.get(kind, ("a table", "tables") if kind is not Any else ("a value", "values"))
    return plural if many else single
