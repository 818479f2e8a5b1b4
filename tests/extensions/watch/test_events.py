"""Test the progress file: what a reader learns from it while a session writes it, and what it ignores."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from helpers.rigs import FakeRig, printed, rig_settings, small_protocol, study_of

from tacbench_cad.extensions.watch.events import KEPT_PRESSES, ProgressReader
from tacbench_cad.lab.acquire.events import PROGRESS_FILE, ProgressFile, label_picture
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.presses import plan_presses

PROTOCOL = small_protocol(repeats=2, stationary_frames=1)


def test_a_reader_follows_a_session(tmp_path: Path) -> None:
    now, rig = 0.0, FakeRig()
    file, reader = ProgressFile(tmp_path, time_s=lambda: now), ProgressReader(tmp_path / PROGRESS_FILE)
    assert reader.read() is None
    questions = []

    def answer(prompt: str) -> str:
        progress = reader.read()
        assert progress is not None and progress.question is not None
        questions.append(progress.question)
        return str(progress.question["label"])

    person = Typing(answer, lambda _: None)
    assert rig.gauge is not None
    rig.gauge.temperature_c = 21.5
    study = study_of(PROTOCOL, 1, 4)
    acquire_study(study, rig_settings(), tmp_path, person=person, progress=file, durable=False, opener=rig.opener)
    file.write("over", outcome="done", message="2 runs complete")
    file.close()
    progress = reader.read()
    assert progress is not None
    assert [question["label"] for question in questions] == ["T1 PAPER X1 01", "T4 PAPER X1 01"]
    assert questions[1]["run"] == printed(4).name and questions[1]["slot"] is None
    assert (progress.blocks, progress.planned, progress.saved, progress.temperature_c) == (2, 32, 32, 21.5)
    assert (progress.run, progress.done, progress.total) == (printed(4).name, 16, 16)
    assert not progress.pressing and progress.question is None
    assert progress.over == {"outcome": "done", "message": "2 runs complete"}
    rows = {row.number: row for row in Run.open(tmp_path / printed(4).name).rows}
    assert [number for number, _ in progress.curves] == [row.number for row in rows.values()][-KEPT_PRESSES:]
    for number, curve in progress.curves:
        z, force = rows[number].pose_z, rows[number].measured_force_n
        assert z is not None and force is not None
        assert (pytest.approx(z, abs=1e-4), pytest.approx(force, abs=1e-5)) in curve
        assert max(height for height, _ in curve) > z
    # The next session replaces the file, and the reader begins again.
    again = ProgressFile(tmp_path, time_s=lambda: now)
    again.start(study, 7)
    again.close()
    progress = reader.read()
    assert progress is not None
    assert (progress.saved, progress.over, len(progress.curves)) == (7, None, 0)


def test_the_time_of_a_press_leaves_out_pauses_and_questions(tmp_path: Path) -> None:
    now = 0.0
    file, reader = ProgressFile(tmp_path, time_s=lambda: now), ProgressReader(tmp_path / PROGRESS_FILE)
    study = study_of(PROTOCOL, 1)
    file.start(study, 0)
    file.begin("a", 0, 16)
    for press in plan_presses(PROTOCOL, (1, 2), "a")[:6]:
        file.before(press, lambda: None)
        if press.number == 4:
            file.write("paused", paused=True)
            now += 3600.0
            file.write("paused", paused=False)
        now += 2.0
        file.pressed(press.number, None, None, tmp_path / "image.png")
    file.close()
    progress = reader.read()
    assert progress is not None
    assert progress.press_s == 2.0 and progress.time_s == now == 3612.0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_does_not_stop_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "open", lambda path, mode, buffering: io.FileIO("/dev/full", "w"))
    file = ProgressFile(tmp_path)
    file.start(study_of(PROTOCOL, 1), 0)
    file.felt(1.0, 0.0)
    file.close()


def test_incomplete_and_foreign_lines_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / PROGRESS_FILE
    reader = ProgressReader(path)
    begin = json.dumps({"event": "begin", "time": 1.0, "run": "a", "done": 0, "total": 5})
    path.write_text(f"{begin}\nnonsense\n[]\n" + '{"event":"felt"}\n{"event":"say","time":2.0,"te')
    progress = reader.read()
    assert progress is not None
    assert (progress.run, list(progress.messages)) == ("a", [])
    with path.open("a") as stream:
        stream.write('xt":"hello"}\n')
    assert reader.read() is progress
    assert list(progress.messages) == ["hello"]


def is_t(glyph: list[list[float]]) -> bool:
    """Return whether the upper quarter of a glyph is its widest part, and the lower half is in the middle."""
    (left, right), (top, bottom) = ((min(side), max(side)) for side in zip(*glyph, strict=True))
    lower = [x for x, y in glyph if y > (top + bottom) / 2.0]
    return abs(sum(lower) / len(lower) - (left + right) / 2.0) < 0.1 and max(lower) - min(lower) < 0.5 * (right - left)


def test_the_picture_of_a_label_is_upright() -> None:
    picture = label_picture(printed(4, copy=3))
    assert picture is not None
    size, points = picture["size"], picture["path"].replace("M", " ").replace("L", " ").replace("Z", " ").split()
    assert sorted(size) == [23.3, 30.0]
    assert all(0.0 < float(point.split(",")[i]) < size[i] for point in points for i in (0, 1))
    # The text is T4 PAPER X1 03, so the glyph on the left of the highest line is a T.
    glyphs = [
        [[float(x) for x in point.split(",")] for point in glyph.strip("M").split("L")]
        for glyph in picture["path"].strip("Z").split("Z")
    ]
    assert is_t(min(glyphs, key=lambda glyph: (round(min(y for _, y in glyph)), min(x for x, _ in glyph))))
