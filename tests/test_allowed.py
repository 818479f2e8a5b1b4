"""Every message that says what is allowed is tested with each thing that it allows.

The places of such messages are found in the source (:mod:`helpers.offers`). A new one makes a test fail until it has a
row in one of the modules ``helpers.offered_...``. The words and the ranges are read from the messages themselves, so a
new word is tested without a new row.
"""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import re
import types
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import click
import pytest
from helpers import offered_blocks, offered_commands, offered_lab
from helpers.offers import sites, texture_file

import tacbench_cad
from tacbench_cad import cli
from tacbench_cad.cli.options import Value
from tacbench_cad.util.convert import Bounds, from_plain
from tacbench_cad.util.errors import InputError, MissingToolError

ROWS = {**offered_blocks.ROWS, **offered_commands.ROWS, **offered_lab.ROWS}
#: The places that are not tested with a row, and why.
ELSEWHERE = {
    "lab.simulate.prints:read_printers": "formats of extensions; tests/lab/simulate/test_prints.py",
    **dict.fromkeys(
        (
            "util.errors:require_between",
            "util.errors:one_of 2",
            "util.entries:load_named",
            "util.convert:_literal_hook",
        ),
        "their callers have rows",
    ),
    **dict.fromkeys(("util.convert:_list_hook", "util.convert:_table_hook.structure"), "names a kind of value"),
    "util.convert:_literal_hook.structure": "the test of all words of documents below",
    **dict.fromkeys(
        (
            "lab.rig.calibration:read_calibration",
            "lab.runs.info:RunInfo.__post_init__",
            "lab.runs.info:printed_from",
            "lab.runs.info:printed_block_from",
            "lab.runs.schema:Row.__post_init__",
            "lab.runs.schema:MovingRow.__post_init__",
            "lab.runs.region:stored_region",
            "extensions.scan.record:read_scan_record.number",
            "spec.storage:surface_from 2",
            "extensions.printer_models.model:PrinterModel.__post_init__",
            "extensions.virtual_rig.server:Server._order",
            "lab.analysis.variance.cells:Cell.__post_init__",
        ),
        "only this program writes these values",
    ),
    **dict.fromkeys(
        (
            "extensions.slicing.gcode:_Machine.comment 2",
            "extensions.slicing.gcode:_Machine._refuse_far",
            "extensions.slicing.gcode:_Machine.result",
        ),
        "numbers in the file of a slicer; tests/slicing/test_gcode.py",
    ),
    **dict.fromkeys(
        (
            "lab.analysis.classification.splits:folds_of",
            "lab.analysis.collection:Collection.viewed",
            "lab.analysis.comparison_sides:read_side",
            "extensions.scan.estimates:ScanFit.parameter",
            "lab.simulate.contact:DomeContact.z_for_force",
            "extensions.virtual_rig.machine:VirtualCarriage.__init__",
            "making.texturing:texture_step_file",
        ),
        "needs the results of a long calculation, or arguments that only this program makes",
    ),
    "extensions.markers.markers:MarkerFinder.find": "names the shape of the other frames",
    "lab.analysis.classification.settings:_own": "shows the error of the user's own module",
    "extensions.scan.reading:_unreadable": "advice about a file that cannot be read",
}
#: The ends of ranges that another key of the same table can forbid, with the message.
DEPENDS = dict.fromkeys(("LoadCellOptions.column", "LoadCellOptions.temperature_column"), "values on a line")
PACKAGES = [name for _, name, _ in pkgutil.walk_packages(tacbench_cad.__path__, "tacbench_cad.")]


def test_every_place_has_a_row() -> None:
    found = {site if count == 1 else f"{site} {count}" for site, count in sites().items()}
    rows = {*ROWS, *ELSEWHERE}
    assert found - rows == set(), "add a row to tests/helpers/offered_*.py"
    assert rows - found == set(), "these places have no such messages any more, or another number of them"


@pytest.mark.parametrize("site", ROWS)
def test_what_a_message_allows_is_accepted(site: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    texture_file(tmp_path)
    assert sum(offer.check() for offer in ROWS[site](tmp_path)) >= 1


# ---- the words and ranges of documents, which the converter refuses ----


def documents() -> Iterator[type]:
    """Yield the dataclasses that are read from TOML and JSON, or that check their own fields."""
    for name in PACKAGES:
        try:
            module = importlib.import_module(name)
        except ImportError:  # a package that is not installed
            continue
        for value in vars(module).values():
            if isinstance(value, type) and dataclasses.is_dataclass(value) and value.__module__ == name:
                with suppress(Exception):  # a dataclass with values that no document has
                    with suppress(InputError):
                        from_plain(value, {})
                    yield value


def parts(hint: Any) -> Iterator[Any]:
    """Yield a type and everything in its unions and annotations."""
    yield hint
    if get_origin(hint) in (Union, types.UnionType, Annotated):
        for inner in get_args(hint):
            yield from parts(inner)


def fields_of(kind: type) -> Iterator[tuple[str, str, Any]]:
    """Yield the names, the keys and the types of the fields of a dataclass that a document can have."""
    try:
        hints = get_type_hints(kind, include_extras=True)
    except (NameError, TypeError):  # a type only for type checkers: no document has this dataclass
        return
    for field in dataclasses.fields(kind):
        if field.init and (key := field.metadata.get("key", field.name)) is not None:
            yield field.name, key, hints[field.name]


def offers(hint: Any) -> tuple[list[Any], bool]:
    """Return the words or the ends of the range of a field, and whether they are words."""
    for part in parts(hint):
        if get_origin(part) is Literal:
            return [word for word in get_args(part) if word is not None], True
        if isinstance(part, Bounds):
            whole = int in parts(hint)
            return [int(end) if whole else end for end in (part.low, part.high) if abs(end) < 1e300], False
    return [], False


CASES = [
    pytest.param(
        kind, key, values, is_word, id=f"{kind.__module__.removeprefix('tacbench_cad.')}.{kind.__name__}.{key}"
    )
    for kind in dict.fromkeys(documents())
    for _, key, hint in fields_of(kind)
    for values, is_word in [offers(hint)]
    if values
]


@pytest.mark.parametrize(("kind", "key", "values", "is_word"), CASES)
def test_the_words_and_ends_of_a_field_are_accepted(kind: type, key: str, values: list[Any], is_word: bool) -> None:
    """A document with this key alone may lack others, but neither the converter nor the class refuses the key."""
    for value in values:
        try:
            from_plain(kind, {key: value})
        except InputError as error:
            other = "is missing" in str(error) or error.field.split()[-1:] != [key]
            assert other or re.search(DEPENDS.get(f"{kind.__name__}.{key}", "$^"), str(error)), error
        except MissingToolError:
            pass
    (hint,) = (hint for _, name, hint in fields_of(kind) if name == key)
    if is_word and str not in parts(hint):
        with pytest.raises(InputError, match=rf"(allowed:|one of) {re.escape(str(values[0]))}"):
            from_plain(hint, "qqqqqq")


# ---- the words that the tab key offers on the command line ----


def commands(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Command, click.Context]]:
    """Yield all commands with their names."""
    for name in command.list_commands(context) if isinstance(command, click.Group) else ():
        inner = command.get_command(context, name)  # type: ignore[attr-defined]
        yield from commands(inner, click.Context(inner, info_name=name, parent=context))
    if not isinstance(command, click.Group):
        yield context.command_path.partition(" ")[2], command, context


def words_of(parameter: click.Parameter, context: click.Context) -> list[str]:
    """Return the words that the tab key offers for an option."""
    if not isinstance(parameter.type, Value):
        return []
    items = parameter.type.shell_complete(context, parameter, "")
    return [item.value for item in items if item.type == "plain" and not item.value.endswith(".toml")]


#: Click keeps the names of the option --help from the first context, so this one has the settings of the command.
_ROOT = cli.tacbench.make_context("tacbench", [], resilient_parsing=True)
OFFERED = [
    pytest.param(f"{path} {parameter.name}", parameter, context, id=f"{path} {parameter.name}")
    for path, command, context in commands(cli.tacbench, _ROOT)
    for parameter in command.params
    if words_of(parameter, context)
]


@pytest.mark.parametrize(("name", "parameter", "context"), OFFERED)
def test_the_words_of_the_tab_key_are_accepted(
    name: str,
    parameter: click.Parameter,
    context: click.Context,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    command, _, option = name.rpartition(" ")
    words = [word + offered_commands.ENDINGS.get(word, "") for word in words_of(parameter, context)]
    values = [parameter.type.convert(word, parameter, context) for word in words]
    try:
        parameter.type.convert("qqqqqq", parameter, context)
    except InputError:  # the option itself refuses other words
        return
    read = offered_commands.READERS.get(name) or offered_commands.READERS[option]
    with pytest.raises(InputError):
        read("qqqqqq")
    for word, value in zip(words, values, strict=True):
        try:
            read(word)
        except MissingToolError:
            pass
        except InputError as error:
            raise AssertionError(f"{command}: the tab key offers {value!r}, but {error}") from None
