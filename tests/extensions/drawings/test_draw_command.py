"""The command ``tacbench draw`` writes a drawing to the given path."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.cases import mostly_long

pytest.importorskip("matplotlib")

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]
FORMATS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.mark.parametrize("suffix", mostly_long(FORMATS, ".pdf"))
def test_the_ending_chooses_the_format(suffix: str, tmp_path: Path) -> None:
    """A drawing in each format has the same bytes on every run, and no date."""
    paths = [tmp_path / f"{run}{suffix}" for run in "ab"]
    for path in paths:
        assert main(["draw", "1", "-o", str(path)]) == 0
    content = paths[0].read_bytes()
    assert content.startswith(FORMATS[suffix]) and content == paths[1].read_bytes()
    assert b"CreationDate" not in content and b"<dc:date>" not in content and b"atplotlib v" not in content


def test_each_texture_has_its_own_drawing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["draw", "2,3"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {f"texture-{number}_paper_x1_drawing.pdf" for number in (2, 3)}


def test_a_drawing_shows_the_part_that_make_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The options have the same meaning as for ``make``: the drawing has the name of the file that is printed."""
    monkeypatch.chdir(tmp_path)
    assert main(["draw", "1", "--key", "4", "--scale", "1.5", "--label"]) == 0
    assert (
        main(
            [
                "make",
                "--texture",
                "1",
                "--key",
                "4",
                "--scale",
                "1.5",
                "--label",
                "--parts",
                "blocks",
                "--formats",
                "stl",
            ]
        )
        == 0
    )
    part = next((tmp_path / "stl_out").glob("*.stl")).stem
    assert (tmp_path / f"{part}_drawing.pdf").read_bytes().startswith(b"%PDF")
    assert main(["draw", "1", "--press", "-o", "block.svg"]) == 0
    assert main(["draw", "1", "-o", "plain.svg"]) == 0
    assert (tmp_path / "block.svg").read_bytes() != (tmp_path / "plain.svg").read_bytes()


def test_fixtures_are_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("build123d", reason="fixtures need the extra cad")
    monkeypatch.chdir(tmp_path)
    for argv in (["holder", "--slots", "2", "--fit", "loose"], ["jig"], ["coupon"]):
        assert main(["draw", "1", "--part", *argv]) == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "holder_paper_x1_slots2_fit0.3_drawing.pdf",
        "jig_paper_x1_drawing.pdf",
        "coupon_drawing.pdf",
    }


@pytest.mark.parametrize(
    ("argv", "needle"),
    [
        (["draw", "1", "--fit", "slip"], "fit = 'slip': is an option of holder, jig"),
        (["draw", "1", "--part", "jigg"], 'did you mean "jig"'),
        (["draw", "1", "-o", "block.stl"], "must end in .png, .pdf or .svg"),
        (["draw", "1", "-o", "nowhere/block.pdf"], "nowhere"),
        (["draw", "1,2", "-o", "both.pdf"], "is the name of one picture, but there are 2"),
        (["draw", "1", "--part", "jig", "--press"], "is only for the drawing of a block"),
        (["draw", "1", "--scale", "0"], "scale"),
        (["draw", "1", "--key", "0.2", "--size", "9,"], "size = '9,'"),
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
