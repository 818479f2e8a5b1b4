"""The command ``tacbench draw`` writes a drawing to the given path."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from tacbench_cad.cli import main

Capture = pytest.CaptureFixture[str]


def test_a_block_and_a_fixture_are_drawn_under_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("build123d", reason="fixtures need the extra cad")
    monkeypatch.chdir(tmp_path)
    assert main(["draw", "1,5", "--key", "4", "--scale", "1.5", "--label"]) == 0
    assert main(["draw", "1", "--part", "holder", "--slots", "2", "--fit", "loose"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        "texture-1_paper_x1.5_key4_label_drawing.pdf",
        "texture-5_paper_x1.5_key4_label_drawing.pdf",
        "holder_paper_x1_slots2_fit0.3_drawing.pdf",
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
