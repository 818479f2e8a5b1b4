"""A message that lists what is allowed lists what is accepted, and the tab key offers the same words."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import click
import pytest

from tacbench_cad import cli
from tacbench_cad.cli.options import Value
from tacbench_cad.extensions.design.document import start
from tacbench_cad.extensions.scan.reading import read_scan
from tacbench_cad.extensions.slicing.printers import printer_named, printers
from tacbench_cad.lab.acquire.study_file import virtual_study
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.sweep import parsed
from tacbench_cad.lab.analysis.feature import feature_of
from tacbench_cad.lab.rig.registry import find_driver
from tacbench_cad.lab.simulate.appearances import look_named
from tacbench_cad.lab.simulate.study import study_of
from tacbench_cad.making.request import Request, plan
from tacbench_cad.spec import families
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.fits import clearance_mm
from tacbench_cad.spec.outlines import outline_of
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.spec.texture_files import find_textures
from tacbench_cad.util.errors import InputError, MissingToolError

WRONG = "qqqqqq"
#: What some words in messages stand for.
STAND_INS = {"a TOML file": "mine.toml", "1 to 6": "6", "a number of mm per side": "0.1"}
#: The functions that read the words of an option, with the command and the option if the tab key offers the words.
READERS: dict[str, Callable[[Any], object]] = {
    "make --texture": lambda word: find_textures((word,), "paper"),
    "make --preset": lambda word: Block.of(1, word),
    "make --parts": lambda word: plan(Request(textures=(1,), parts=(word,))),
    "make --formats": lambda word: plan(Request(textures=(1,), formats=(word,))),
    "make --outline": lambda word: outline_of(word, (20.0, 30.0)),
    "make --fit": clearance_mm,
    "plate --printer": lambda word: printer_named(word, printers()),
    "acquire --driver": lambda word: virtual_study(driver=word),
    "simulate --study": study_of,
    "simulate --look": look_named,
    "variance --features": feature_of,
    "classify --estimators": lambda word: ClassificationSettings(estimators=(word,)),
    "classify --hold-out": lambda word: ClassificationSettings(hold_out=(word,)),
    "classify --sweep": lambda word: parsed(f"{word}=1:3"),
    "a driver of a stage": lambda word: find_driver("stage", word),
    "a driver of a sensor": lambda word: find_driver("sensor", word),
    "the spacing of a press grid": lambda word: PressGrid.paper(spacing=word),
    "the law of a series": lambda word: families.series(word, 3),
    "the axes of harmonics": lambda word: families.harmonics([1.0], word),
    "the unit of a scan": lambda word: _before_the_file(lambda: read_scan(Path("none.ply"), unit=word)),
    "the start of a design": start,
}


def _before_the_file(call: Callable[[], object]) -> None:
    try:
        call()
    except InputError as error:
        if "none.ply" not in str(error):
            raise


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with a file that is a texture and a study."""
    monkeypatch.chdir(tmp_path)
    texture = '[texture]\nname = "mine"\nfamily = "series"\nlaw = "square"\nN = 5\n'
    (tmp_path / "mine.toml").write_text(texture, encoding="utf-8")
    return tmp_path


def refusal(read: Callable[[str], object]) -> str:
    with pytest.raises(InputError) as refused:
        read(WRONG)
    return str(refused.value)


def allowed(message: str) -> list[str]:
    """Return the words after ``allowed:`` in a message."""
    words = message.partition("llowed: ")[2].partition(";")[0]
    return [word for word in re.split(r", (?:or )?| or ", words) if word]


def options() -> Iterator[tuple[str, click.Parameter, click.Context]]:
    """Yield the arguments and the options of all commands with their names."""

    def inside(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Parameter, click.Context]]:
        for name in command.list_commands(context) if isinstance(command, click.Group) else ():
            inner = command.get_command(context, name)  # type: ignore[attr-defined]
            yield from inside(inner, click.Context(inner, info_name=name, parent=context))
        for parameter in command.params:
            yield f"{context.command_path.partition(' ')[2]} {max(parameter.opts, key=len)}", parameter, context

    yield from inside(cli.tacbench, cli.tacbench.make_context("tacbench", [], resilient_parsing=True))


def offered(parameter: click.Parameter, context: click.Context) -> list[str]:
    """Return the words that the tab key offers, without files and beginnings of values such as ``label=``."""
    items = parameter.type.shell_complete(context, parameter, "") if isinstance(parameter.type, Value) else []
    return [item.value for item in items if item.type == "plain" and not item.value.endswith((".toml", "=", ":"))]


def accepted(read: Callable[[str], Any], words: list[str]) -> list[str]:
    """Return the words that are accepted; a word that needs a package that is not installed is accepted."""

    def is_accepted(word: str) -> bool:
        try:
            read(STAND_INS.get(word, word))
        except MissingToolError:
            return True
        except InputError:
            return False
        return True

    return [word for word in words if is_accepted(word)]


@pytest.mark.parametrize("name", READERS)
def test_the_words_of_a_message_and_of_the_tab_key_are_accepted(name: str, folder: Path) -> None:
    read = READERS[name]
    words = allowed(refusal(read)) + [
        word for option, parameter, context in options() if option == name for word in offered(parameter, context)
    ]
    assert words
    assert accepted(read, words) == words


def test_an_option_that_refuses_other_words_offers_what_it_accepts() -> None:
    checked = 0
    for name, parameter, context in options():
        if not isinstance(parameter.type, Value):
            continue
        words = offered(parameter, context)
        read = partial(parameter.type.convert, param=parameter, ctx=context)
        try:
            read(WRONG)
        except InputError as error:
            words += allowed(str(error))
            assert accepted(read, words) == words, name
            checked += bool(words)
    assert checked >= 10
