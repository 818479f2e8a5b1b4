"""Test the progress that a person sees: the time left, the force and the newest image."""

from __future__ import annotations

import io
import os
from pathlib import Path

from tacbench_cad.lab.acquire.progress import ProgressLines
from tacbench_cad.lab.rig.gauge import Force


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def shown(stream: io.StringIO, out: Path, presses: int, step_s: float) -> str:
    now = 0.0
    lines = ProgressLines(out, stream=stream, now_s=lambda: now)
    image = out / "image_3.png"
    image.write_bytes(b"picture")
    lines.begin("texture-1", 0, presses)
    for press in range(1, presses + 1):
        now += step_s
        lines.pressed(press, Force(mean_n=1.91234, spread_n=0.0, samples=8), press != 3, image)
    lines.end()
    return stream.getvalue()


def test_a_terminal_shows_one_line_that_is_overwritten(tmp_path: Path) -> None:
    text = shown(Terminal(), tmp_path, 4, 2.0)
    last = text.rstrip("\n").split("\r")
    assert len(last) == 5
    assert last[1] == "texture-1  1/4  1.9123 N  image_3.png"
    assert last[2].rstrip() == "texture-1  2/4  0:00:04 left  1.9123 N  image_3.png"
    assert last[3].rstrip() == "texture-1  3/4  0:00:02 left  1.9123 N (out of band)  image_3.png"
    assert last[4].rstrip() == "texture-1  4/4  0:00:00 left  1.9123 N  image_3.png"
    assert text.count("\n") == 2


def test_other_output_gets_a_line_every_ten_seconds_and_a_last_line(tmp_path: Path) -> None:
    text = shown(io.StringIO(), tmp_path, 9, 4.0)
    counts = [line.split()[1] for line in text.splitlines()[1:]]
    assert counts == ["1/9", "4/9", "7/9", "9/9"]


def test_the_newest_image_is_a_separate_copy(tmp_path: Path) -> None:
    shown(io.StringIO(), tmp_path, 1, 1.0)
    (tmp_path / "last.png").write_bytes(b"edited in a viewer")
    assert (tmp_path / "image_3.png").read_bytes() == b"picture"
    assert not list(tmp_path.glob(".tacbench*"))


def test_an_image_that_cannot_be_copied_does_not_stop_the_run(tmp_path: Path) -> None:
    lines = ProgressLines(tmp_path / "missing", stream=io.StringIO())
    lines.begin("texture-1", 0, 1)
    lines.pressed(1, None, None, tmp_path / "image_1.png")


def test_a_lost_pipe_drops_the_lines_and_the_run_goes_on(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    with os.fdopen(writer, "w") as stream:
        progress = ProgressLines(tmp_path, stream=stream)
        progress.say("first")
        assert os.read(reader, 100) == b"first\n"
        os.close(reader)
        for _ in range(3):
            progress.begin("run", 0, 2)
            progress.end()
