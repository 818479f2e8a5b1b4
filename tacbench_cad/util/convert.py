"""Strict conversion between dataclasses and the plain values of TOML and JSON files, in both directions.

:func:`from_plain` makes a dataclass from a parsed document, with the help of pydantic. It converts nothing silently:
``"3"`` is not accepted as 3, and ``true`` is not accepted as 1. The only exception is a whole number where a number
with decimals is expected. An unknown key is refused. The allowed values of a dataclass follow from its types
(``Literal``, ``tuple[float, float]``, ``float | None``), from the annotations of ``annotated_types``, and from its own
``__post_init__``. The message of an error names the table, the key and the value::

    @dataclass(frozen=True, kw_only=True)
    class Holder:
        rim_mm: Annotated[float, Interval(ge=-50.0, le=50.0)] = 2.0
        gap_mm: Annotated[float, Ge(0.0)]

    @dataclass(frozen=True, kw_only=True)
    class Document:
        holder: Holder

    document = read_toml(path, Document, "study")

``field(metadata={"alias": "N"})`` gives a field another key, and ``field(metadata=NOT_STORED)`` gives it none.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError, nearest

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails, SchemaValidator

T = TypeVar("T")

#: The metadata of a field of a dataclass that no document has.
NOT_STORED = {"exclude": True}


#: The meaning of pydantic's kinds of errors, where its own words are those of a Python programmer.
_MEANINGS = {
    "missing": "is missing",
    "unexpected_keyword_argument": "unknown key",
    "bool_type": "must be true or false",
    "int_type": "must be a whole number",
    "float_type": "must be a finite number",
    "string_type": "must be a string",
    "too_short": "must have at least {min_length} items",
    "too_long": "may have at most {max_length} items",
    **dict.fromkeys(("literal_error", "enum"), "must be {expected}"),
    "union_tag_invalid": "must be one of {expected_tags}",
    "union_tag_not_found": "is missing",
    "greater_than_equal": "must be at least {ge}",
    "less_than_equal": "must be at most {le}",
    **dict.fromkeys(("path_type", "path_str"), "must be a path"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
    **dict.fromkeys(("dataclass_type", "dict_type", "mapping_type", "model_attributes_type"), "must be a table"),
}


class Unchecked:
    """Metadata of a field with any object, for protocols: ``surface: Annotated[Surface, Unchecked()]``."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> dict[str, str]:
        return {"type": "any"}


def from_plain(cls: type[T], data: Any, where: str = "") -> T:
    """Make a dataclass (or a value of any type that a field may have) from the values of a parsed document.

    Args:
        cls: The dataclass.
        data: The values that a TOML or JSON parser returned.
        where: The beginning of every error message: ``"run.toml: "``, ``"[gauge] "``.

    Raises:
        InputError: A key is unknown or missing, or a value is not allowed.
    """
    result: T = _validated(cls, False, {"": data}, where)[""]
    return result


def check_fields(value: Any) -> None:
    """Check that the fields of a dataclass have values that their types allow; to be called in ``__post_init__``.

    :func:`from_plain` checks values that come from a file. This function also checks objects made in Python code.

    Raises:
        InputError: A field has a value that is not allowed.
    """
    _validated(type(value), True, {field.name: getattr(value, field.name) for field in _stored_fields(type(value))})


class Checked:
    """Base class of dataclasses that check their fields when they are created; see :func:`check_fields`."""

    def __post_init__(self) -> None:
        check_fields(self)


def _validated(kind: Any, is_of_fields: bool, values: dict[str, Any], where: str = "") -> dict[str, Any]:
    from pydantic import ValidationError  # imported here, so that commands that read no document start faster

    validator, keys = _validator(kind, is_of_fields)
    try:
        result: dict[str, Any] = validator.validate_python(values)
    except ValidationError as error:
        raise _input_error(error.errors(include_url=False), values, keys, where) from None
    return result


@cache
def _validator(kind: Any, is_of_fields: bool) -> tuple[SchemaValidator, set[str]]:
    """Return the validator of a table with a single value, or with the fields of a dataclass, and all its keys."""
    from pydantic import ConfigDict, TypeAdapter
    from pydantic_core import SchemaValidator
    from typing_extensions import TypedDict

    hints = get_type_hints(kind, include_extras=True) if is_of_fields else {"": kind}
    names = [field.name for field in _stored_fields(kind)] if is_of_fields else [""]
    table = TypedDict("table", {name: hints[name] for name in names})  # type: ignore[misc]
    table.__pydantic_config__ = ConfigDict(  # type: ignore[attr-defined]
        extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )
    keys: set[str] = set()
    return SchemaValidator(_strict(TypeAdapter(table).core_schema, keys)), keys


def _strict(schema: Any, keys: set[str]) -> Any:
    """Return a schema of pydantic that accepts tables, lists and paths as documents have them, but no other number.

    Args:
        schema: The schema, or a part of it.
        keys: The keys of all dataclasses of the schema are added to it.
    """
    if isinstance(schema, (list, tuple)):
        return type(schema)(_strict(part, keys) for part in schema)
    if not isinstance(schema, dict):
        return schema
    if schema.get("type") == "dataclass-field":
        keys.add(str(schema.get("validation_alias", schema["name"])))
    strict = {"strict": True} if schema.get("type") in ("bool", "int", "float") else {}
    not_stored = {"init": False} if schema.get("serialization_exclude") else {}
    return {name: _strict(part, keys) for name, part in schema.items()} | strict | not_stored


def _input_error(errors: Sequence[ErrorDetails], values: Any, keys: set[str], where: str) -> InputError:
    """Return the most useful error as one line: about an unknown key, or the one that is deepest in the document."""

    def rank(error: ErrorDetails) -> tuple[bool, int]:
        return error["type"] == "unexpected_keyword_argument", len(_path(error, values))

    worst = max(errors, key=rank)
    path, kind, context = _path(worst, values), worst["type"], worst.get("ctx", {})
    own = context.get("error")
    if isinstance(own, InputError):  # a dataclass itself has refused its values
        return InputError(f"{where}{_place(path, True)}{own.field}".rstrip(" :"), own.value, own.allowed)
    same = [error for error in errors if rank(error) == rank(worst) and _path(error, values) == path]
    allowed = " or ".join(dict.fromkeys(_meaning(error) for error in same))  # several types in a union
    if kind == "missing" and path and isinstance(path[-1], int):
        allowed = "has too few items"
    if kind.startswith("union_tag"):
        path.append(context["discriminator"].strip("'"))
    if kind == "unexpected_keyword_argument" and path[-1] in keys:
        allowed = "is a key of another table"
    elif kind == "unexpected_keyword_argument" and not (hint := nearest(str(path[-1]), keys)).startswith("allowed"):
        allowed = f"{allowed}; {hint}"
    is_table = isinstance(worst["input"], Mapping) or kind in ("unexpected_keyword_argument", "dataclass_type")
    place = _place(path, allowed == "must be a table")
    return InputError(f"{where}{place}".rstrip(" :"), None if is_table else worst["input"], allowed)


def _meaning(error: ErrorDetails) -> str:
    allowed = _MEANINGS.get(error["type"])
    return allowed.format(**error.get("ctx", {})) if allowed else error["msg"].replace("Input should", "must")


def _path(error: ErrorDetails, values: Any) -> list[str | int]:
    """Return the keys and indices that lead to a value; pydantic also lists the types in a union that it has tried."""
    path: list[str | int] = []
    for step in error["loc"]:
        if (isinstance(values, Mapping) and step in values) or (
            isinstance(values, (list, tuple)) and isinstance(step, int) and step < len(values)
        ):
            values = values[step]  # type: ignore[index]
            path.append(step)
        elif error["type"] == "missing" and step == error["loc"][-1]:
            path.append(step)
    return path[1:] if path[:1] == [""] else path


def _place(path: list[str | int], is_table: bool = False) -> str:
    """Return a place in a document: ``[protocol] depth_mm``, ``[study.prints 2] copies``; a table ends in a blank."""
    while path and isinstance(path[-1], int) and not is_table:  # a number in a list
        path = path[:-1]
    tables = "".join(
        f".{step}" if isinstance(step, str) else f" {step + 1}" for step in (path if is_table else path[:-1])
    )
    return (f"[{tables.lstrip('.')}] " if tables else "") + ("" if is_table or not path else str(path[-1]))


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

    - A dataclass becomes a table with a key for each field, without the fields that are :data:`NOT_STORED`.
    - Tuples and sets become lists.
    - Paths, enums and dates become strings.
    - NumPy numbers and arrays become Python numbers and lists.

    Args:
        value: The object.
        without_none: Leave out fields that are None (TOML has no such value).
        without_defaults: Leave out fields that have their default value.

    Raises:
        AttributeError: A value cannot be written as plain values.
    """
    from pydantic_core import to_jsonable_python

    def plain(inner: Any) -> Any:
        return to_plain(inner, without_none=without_none, without_defaults=without_defaults)

    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        items = ((field, getattr(value, field.name)) for field in _stored_fields(type(value)))
        return {
            field.metadata.get("alias", field.name): plain(inner)
            for field, inner in items
            if not (without_none and inner is None) and not (without_defaults and _is_default(field, inner))
        }
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(inner) for inner in value]
    return to_jsonable_python(value, fallback=lambda array: array.tolist())


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
    default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
    return default is not dataclasses.MISSING and bool(value == default)


def _stored_fields(cls: Any) -> Iterator[dataclasses.Field[Any]]:
    """Yield the fields of a dataclass that are part of its plain form."""
    return (field for field in dataclasses.fields(cls) if field.init and not field.metadata.get("exclude"))
