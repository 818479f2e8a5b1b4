"""The command ``tacbench show`` writes a picture to the given path."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest
from helpers.cases import mostly_long

pytest.importorskip("matplotlib")
from PIL import Image

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]


def test_the_picture_is_written_to_the_given_path(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "four.png"
    assert main(["show", "4", "-o", str(path)]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "four.png" in err
    with Image.open(path) as picture:
        assert picture.format == "PNG" and min(picture.size) > 300


FORMATS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
#: The options, and the endings of quick cases.
KINDS = {"": (".png",), "--press": tuple(FORMATS)}


@pytest.mark.parametrize(
    ("option", "suffix"),
    mostly_long(product(KINDS, FORMATS), *((kind, suffix) for kind in KINDS for suffix in KINDS[kind])),
)
def test_the_ending_chooses_the_format(option: str, suffix: str, tmp_path: Path) -> None:
    """Each kind of picture in each format has the same bytes on every run, and no date."""
    options = [option] if option else []
    paths = [tmp_path / f"{run}{suffix}" for run in "ab"]
    for path in paths:
        assert main(["show", "1", *options, "-o", str(path)]) == 0
    content = paths[0].read_bytes()
    assert content.startswith(FORMATS[suffix]) and content == paths[1].read_bytes()
    assert b"CreationDate" not in content and b"<dc:date>" not in content and b"atplotlib v" not in content


def test_press_gives_another_picture_with_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["show", "1"]) == 0
    assert main(["show", "1", "--press", "--preset", "paper"]) == 0
    plain, press = tmp_path / "texture-1_paper_x1.png", tmp_path / "texture-1_paper_x1_press.png"
    assert plain.read_bytes() != press.read_bytes()
