"""The last line of a command's output is the next command to type. It exists and contains the user's own paths."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import rich_click as click

from tacbench_cad import cli
from tacbench_cad.cli import main
from tacbench_cad.cli.make import _next as next_of_make

Capture = pytest.CaptureFixture[str]


def next_line(capsys: Capture, *words: str, err: bool = False) -> str:
    """Run a command, return the next command that it prints, and check that the command and its options exist."""
    assert main(list(words)) == 0
    captured = capsys.readouterr()
    last = (captured.err if err else captured.out).splitlines()[-1]
    assert last.startswith("Next: tacbench ")
    assert (captured.out + captured.err).count("Next: ") == 1
    typed = last.split()[2:]
    command: click.Command = cli.tacbench
    while isinstance(command, click.Group):
        inner = command.get_command(click.Context(command), typed.pop(0))
        assert inner is not None
        command = inner
    options = {name for parameter in command.params for name in parameter.opts}
    assert set(re.findall(r"(?<=\s)--?[a-z][a-z-]*", f" {' '.join(typed)}")) <= options
    return last.removeprefix("Next: tacbench ")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_next_command_exists_and_repeats_the_users_words(folder: Path, capsys: Capture) -> None:
    assert next_line(capsys, "textures") == "make"
    assert next_line(capsys, "textures", "--texture", "1,4", "--scale", "1.5") == "make --texture 1,4 --scale 1.5"
    assert next_line(capsys, "plate", "--printer", "ender-3", "--texture", "1") == "acquire --init study.toml"
    assert next_line(capsys, "rig", "probe") == "acquire --init study.toml"
    assert next_line(capsys, "acquire", "--init", "my study.toml", err=True) == "rig align 'my study.toml'"
    words = ("publish", "my-runs", "--report", "report.html", "--init", "about.toml")
    assert next_line(capsys, *words, err=True) == "publish my-runs --about about.toml --report report.html -o data-set"


def test_the_next_command_of_make_depends_on_the_parts() -> None:
    request = {"textures": ("1",), "preset": "released", "scale": 1.0, "key_mm": None, "parts": None}
    request |= dict.fromkeys(("size_mm", "height_mm", "mm_per_unit"))
    assert next_of_make(request) == ["plate", "--printer", "NAME", "--texture", "1", "--preset", "released"]
    assert next_of_make(request | {"parts": ("coupon",)}) == ["make", "--fit", "FIT"]
    assert next_of_make(request | {"parts": ("holder",)}) == ["acquire", "--init", "study.toml"]


def test_json_output_has_no_next_command(capsys: Capture) -> None:
    assert main(["textures", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["textures"] and err == ""
