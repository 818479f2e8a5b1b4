"""``tacbench show``: a picture is written where it was asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
from PIL import Image

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]


def test_the_picture_has_the_name_that_was_asked_for(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "four.png"
    assert main(["show", "4", "-o", str(path)]) == 0
    out, err = capsys.readouterr()
    assert out == "" and "four.png" in err
    with Image.open(path) as picture:
        assert picture.format == "PNG" and min(picture.size) > 300


def test_press_gives_another_picture_under_another_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["show", "1"]) == 0
    assert main(["show", "1", "--press", "--preset", "paper"]) == 0
    plain, press = tmp_path / "texture-1_paper_x1.png", tmp_path / "texture-1_paper_x1_press.png"
    assert plain.read_bytes() != press.read_bytes()


def test_a_texture_file_can_be_shown(tmp_path: Path) -> None:
    file = tmp_path / "hex.toml"
    file.write_text('[texture]\nname = "hex"\nfamily = "series"\nlaw = "square"\nN = 5\naxes = "x"\n')
    assert main(["show", str(file), "-o", str(tmp_path / "hex.png")]) == 0
    assert (tmp_path / "hex.png").is_file()


@pytest.mark.parametrize(
    ("argv", "needle"),
    [
        (["show", "7"], "texture = '7'"),
        (["show", "all"], "name one texture"),
        (["show", "1", "-o", "picture.stl"], "must end in .png"),
        (["show", "1", "-o", "nowhere/picture.png"], "nowhere"),
        (["show", "1", "--preset", "papers"], 'did you mean "paper"'),
    ],
)
def test_wrong_input_is_one_line(
    argv: list[str], needle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: ") and err.count("\n") == 1
    assert needle in err
    assert list(tmp_path.iterdir()) == []
