"""Test ``tacbench check-runs``: it reports every kind of damage and repairs only an incomplete last row."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.cli import main
from tacbench_cad.cli.check_runs import _devices
from tacbench_cad.lab.runs.checking import check_run, ranges
from tacbench_cad.lab.runs.frame_files import encoded, sha256
from tacbench_cad.lab.runs.reading import find_runs
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.util.errors import InputError

Capture = pytest.CaptureFixture[str]


def put(folder: Path, number: int, image: Any) -> None:
    """Replace an image and its checksum, as if a faulty camera had recorded it."""
    path = folder / "sensor_images" / f"image_{number}.png"
    table = folder / "targets.csv"
    old = sha256(path.read_bytes())
    path.write_bytes(encoded(image, ())[0])
    table.write_text(table.read_text().replace(old, sha256(path.read_bytes())))


def smooth() -> Any:
    """Return an image without edges: a wide bright hill."""
    y, x = np.mgrid[:24, :32]
    return (200 * np.exp(-((x - 16) ** 2 + (y - 12) ** 2) / 2 / 9.0**2)).astype(np.uint8)


def _swap(folder: Path) -> None:
    images = folder / "sensor_images"
    (images / "image_3.png").write_bytes((images / "image_4.png").read_bytes() + b"")


def _stuck(folder: Path) -> None:
    import cv2

    put(folder, 4, cv2.imread(str(folder / "sensor_images" / "image_3.png"), cv2.IMREAD_UNCHANGED))
    path = folder / "sensor_images" / "image_3.png"
    table = folder / "targets.csv"
    old, data = sha256(path.read_bytes()), (folder / "sensor_images" / "image_4.png").read_bytes()
    path.write_bytes(data)
    table.write_text(table.read_text().replace(old, sha256(data)))


def _line(number: int, text: str | None) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "targets.csv"
        lines = path.read_text().splitlines(keepends=True)
        lines[number - 1] = text if text is not None else ""
        path.write_text("".join(lines))

    return change


def _double(folder: Path) -> None:
    path = folder / "targets.csv"
    path.write_text(path.read_text() + path.read_text().splitlines(keepends=True)[3])


def _automatic(folder: Path) -> None:
    path = folder / "run.json"
    document = json.loads(path.read_text())
    document["sensor"]["settings"]["actual"]["automatic"] = ["white_balance"]
    path.write_text(json.dumps(document))


def _folder_for_image(folder: Path) -> None:
    path = folder / "sensor_images" / "image_3.png"
    path.unlink()
    path.mkdir()


CASES: dict[str, tuple[Callable[[Path], object], list[tuple[str, str]]]] = {
    "a missing image": (
        lambda folder: (folder / "sensor_images" / "image_3.png").unlink(),
        [("missing", "sensor_images/image_3.png")],
    ),
    "an extra file": (
        lambda folder: (folder / "sensor_images" / "image_99.png").write_bytes(b""),
        [("extra", "sensor_images/image_99.png")],
    ),
    "an unreadable image": (
        lambda folder: (folder / "sensor_images" / "image_3.png").write_bytes(b"PNG?"),
        [("checksum", "sensor_images/image_3.png"), ("unreadable", "sensor_images/image_3.png")],
    ),
    "an image that is a folder": (_folder_for_image, [("unreadable", "sensor_images/image_3.png")]),
    "a swapped image": (_swap, [("checksum", "sensor_images/image_3.png"), ("stuck", "sensor_images/image_4.png")]),
    "a dark image": (
        lambda folder: put(folder, 3, np.full((24, 32), 3, np.uint8)),
        [("dark", "sensor_images/image_3.png")],
    ),
    "a blurred image": (lambda folder: put(folder, 3, smooth()), [("blurred", "sensor_images/image_3.png")]),
    "a stuck camera": (_stuck, [("stuck", "sensor_images/image_4.png")]),
    "another shape": (
        lambda folder: put(folder, 3, np.random.default_rng(0).integers(0, 256, (30, 32), dtype=np.uint8)),
        [("shape", "sensor_images/image_3.png")],
    ),
    "a doubled row": (_double, [("duplicate", "targets.csv")]),
    "an incomplete row": (
        _line(4, "image_3.png,4,4.0\n"),
        [("gap", "protocol"), ("row", "targets.csv"), ("extra", "sensor_images/image_3.png")],
    ),
    "a deleted row": (
        _line(4, None),
        [("gap", "protocol"), ("extra", "sensor_images/image_3.png")],
    ),
    "no reference": (
        lambda folder: (folder / "references" / "references.csv").unlink(),
        [("gap", "references"), ("extra", "sensor_images/image_0.png")],
    ),
    "a missing stationary frame": (
        lambda folder: (folder / "stationary" / "start_free_01.png").unlink(),
        [("missing", "stationary/start_free_01.png")],
    ),
    "a wrong print record": (
        lambda folder: (folder / "print.toml").write_text("nozzle = 1"),
        [("record", "print.toml")],
    ),
    "a missing photo": (
        lambda folder: (folder / "print.toml").write_text('photos = ["top.jpg"]'),
        [("record", "print.toml")],
    ),
    "automatic control of the camera": (_automatic, [("camera", "run.json")]),
}


def test_a_valid_run_has_no_findings(run_folder: Path) -> None:
    report = check_run(run_folder)
    assert report.ok
    assert (report.presses, report.planned, report.references, report.stationary) == (16, 16, 1, 8)
    assert report.out_of_band == 1
    assert "slicer" in report.empty_fields


@pytest.mark.parametrize("case", CASES)
def test_damage_is_reported(case: str, run_folder: Path) -> None:
    damage, expected = CASES[case]
    damage(run_folder)
    before = {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()}
    report = check_run(run_folder, repair=True)
    assert [(finding.kind, finding.where) for finding in report.findings] == expected
    assert report.repaired == ()
    assert {path: path.read_bytes() for path in run_folder.rglob("*") if path.is_file()} == before


def test_frames_of_a_sensor_without_markers_are_not_reported_as_blurred(
    tmp_path: Path, make_info: Any, filled: Any
) -> None:
    settings = {"requested": {}, "actual": {}, "limits": {"dark_counts": 2.0, "blur_px": 0.0}}
    with RunWriter.open(tmp_path / "run", make_info(sensor={"settings": settings})) as writer:
        filled(writer)
    put(tmp_path / "run", 3, smooth())
    put(tmp_path / "run", 4, np.random.default_rng(0).integers(2, 6, (24, 32), dtype=np.uint8))
    assert {finding.kind for finding in check_run(tmp_path / "run").findings} <= {"brightness", "drift"}


def test_only_an_incomplete_last_row_is_repaired_and_only_on_request(run_folder: Path, capsys: Capture) -> None:
    path = run_folder / "targets.csv"
    content = path.read_bytes()
    path.write_bytes(content[:-30])
    kinds = [finding.kind for finding in check_run(run_folder).findings]
    assert kinds == ["torn", "gap", "extra"]
    assert path.read_bytes() == content[:-30]
    assert main(["check-runs", str(run_folder), "--repair"]) == 1
    assert "targets.csv: removed an incomplete last row" in capsys.readouterr().err
    assert [finding.kind for finding in check_run(run_folder).findings] == ["gap", "extra"]
    assert path.read_bytes() == b"".join(content.splitlines(keepends=True)[:-1])


def test_a_run_that_is_being_written_is_not_repaired(run_folder: Path, make_info: Any) -> None:
    path = run_folder / "targets.csv"
    with RunWriter.open(run_folder, make_info()):
        path.write_bytes(path.read_bytes()[:-30])
        report = check_run(run_folder, repair=True)
    assert any("another tacbench is writing to it" in finding.text for finding in report.findings)
    assert not report.repaired


def test_the_gaps_of_an_unfinished_run_are_listed(tmp_path: Path, make_info: Any, filled: Any) -> None:
    with RunWriter.open(tmp_path / "run", make_info()) as writer:
        assert {finding.kind for finding in check_run(tmp_path / "run").findings} == {"gap"}
        filled(writer, count=5)
    report = check_run(tmp_path / "run")
    assert [(finding.kind, finding.text) for finding in report.findings] == [
        ("gap", "is not complete: the run lacks 11 of 16 presses (6 to 16)")
    ]


def test_progress_reaches_its_end(run_folder: Path) -> None:
    updates: list[tuple[int, int]] = []
    check_run(run_folder, progress=lambda checked, total: updates.append((checked, total)))
    assert updates == [(number, 25) for number in range(1, 26)]


def test_runs_in_folders_are_found(tmp_path: Path, make_info: Any) -> None:
    for name in ("b", "a", "deep/c"):
        with RunWriter.open(tmp_path / name, make_info()):
            pass
    assert find_runs([tmp_path, tmp_path / "a"]) == [tmp_path / "a", tmp_path / "b", tmp_path / "deep" / "c"]
    with pytest.raises(InputError, match="contains no run folder"):
        find_runs([tmp_path / "a" / "stationary"])
    with pytest.raises(InputError, match="does not exist"):
        find_runs([tmp_path / "nowhere"])


@pytest.mark.parametrize(
    ("numbers", "text"),
    [([3], "3"), ([1, 2, 3, 7], "1 to 3, 7"), (list(range(1, 40, 2)), "1, 3, 5, 7, 9, 11, 13, 15, and 12 more")],
)
def test_numbers_are_joined_to_ranges(numbers: list[int], text: str) -> None:
    assert ranges(numbers) == text


@pytest.mark.parametrize(
    ("simulated", "text"),
    [
        ((), "no"),
        (("sensor: a TacTip",), "sensor"),
        (("stage: GRBL: simulated", "sensor: a TacTip"), "stage, sensor"),
        (("stage: GRBL", "gauge: a load cell", "sensor: a TacTip"), "all"),
    ],
)
def test_the_table_shows_the_simulated_devices(simulated: tuple[str, ...], text: str) -> None:
    assert _devices(simulated) == text


def test_the_command_accepts_a_valid_folder(run_folder: Path, capsys: Capture) -> None:
    assert main(["check-runs", str(run_folder.parent)]) == 0
    out = capsys.readouterr().out
    assert next(line for line in out.splitlines() if "16 of 16" in line).split()[-2:] == ["stage", "ok"]
    assert f"1 run, 16 presses: nothing wrong\nNext: tacbench variance {run_folder.parent}\n" in out
    assert "print.toml (1 run): 16 empty fields: printer_serial, filament_batch, slicer and 13 more" in out


def test_the_command_lists_findings_and_fails(run_folder: Path, capsys: Capture) -> None:
    for number in range(1, 15):
        (run_folder / "sensor_images" / f"image_{number}.png").unlink()
    assert main(["check-runs", str(run_folder)]) == 1
    out = capsys.readouterr().out
    assert "run: missing: sensor_images/image_1.png is missing, but a row refers to it" in out
    assert "run: missing: and 4 more (all with --json)" in out
    assert main(["check-runs", str(run_folder), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["ok"]
    assert len(document["runs"][0]["findings"]) == 14


def test_another_schema_version_ends_with_2_and_the_others_are_checked(
    run_folder: Path, make_info: Any, filled: Any, capsys: Capture
) -> None:
    other = run_folder.parent / "other"
    with RunWriter.open(other, make_info()) as writer:
        filled(writer)
    (other / "run.json").write_text((other / "run.json").read_text().replace('"version": 3,', '"version": 1,'))
    assert main(["check-runs", str(run_folder.parent)]) == 2
    output = capsys.readouterr()
    assert "has schema version 1, but this program reads 3" in output.err
    assert "1 run, 16 presses: nothing wrong" in output.out


def test_the_command_refuses_folders_without_runs(tmp_path: Path, capsys: Capture) -> None:
    assert main(["check-runs", str(tmp_path)]) == 2
    assert "contains no run folder" in capsys.readouterr().err
