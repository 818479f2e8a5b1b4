"""Test the import of images: with a table, by classes and from TacTip toolchains, and the images that are left out."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tacbench_cad.cli import import_frames, main
from tacbench_cad.extensions.exchange.exporting.export_formats import export_runs
from tacbench_cad.extensions.exchange.exporting.image_folder import UNLABELLED
from tacbench_cad.extensions.exchange.exporting.tactile_data import export_tactile_data
from tacbench_cad.lab import ImportOptions, Run, check_run, find_runs, import_samples
from tacbench_cad.lab.runs import run_writer
from tacbench_cad.lab.runs.importing.import_formats import CORE
from tacbench_cad.util.errors import InputError

Capture = pytest.CaptureFixture[str]
HEADER = ("file", "material", "block_id", "place", "newtons")
OPTIONS = ImportOptions(columns={"label": "material", "print": "block_id", "position": "place", "force": "newtons"})


def rows_of(count: int) -> list[tuple[object, ...]]:
    """Return rows for two materials, two blocks of each, three positions and two forces; further rows are repeats."""
    return [
        (f"{i}.png", ("cork", "felt")[i % 2], f"b{i // 2 % 2}", "abc"[i // 4 % 3], (0.5, 2)[i // 12 % 2])
        for i in range(count)
    ]


def test_a_folder_with_a_table_becomes_one_run_for_each_print(images: Any, table: Any, tmp_path: Path) -> None:
    folder = images(24)
    labels = table(tmp_path / "labels.csv", HEADER, rows_of(24))
    report = import_samples([folder, labels], tmp_path / "out", OPTIONS)
    assert report.ok and len(report.runs) == 4 and sum(run.imported for run in report.runs) == 24
    assert report.notes == ("labels.csv: image=file, label=material, print=block_id, position=place, force=newtons",)
    run = Run.open(tmp_path / "out" / "cork_b0")
    info = run.info
    assert (info.printed.texture, info.printed.copy, info.printed.printer, info.printed.block) == (
        "cork",
        "b0",
        None,
        None,
    )
    assert (info.protocol, info.holder, info.frame, info.slot, info.grid_spacing) == (None,) * 5
    assert info.levels == (1, 2) and info.frame_shape == (24, 32, 3)
    document = json.loads((run.folder / "run.json").read_text())
    assert document["version"] == 3 and document["block"]["geometry"] is None and document["protocol"] is None
    assert document["source"]["codes"]["position"] == {"a": 1, "b": 2, "c": 3}
    row = run.rows[1]
    assert (row.position, row.force_level, row.target_force_n, row.repeat) == (2, 1, 0.5, None)
    assert (row.pose_x, row.pose_rx, row.measured_force_n, row.time_utc) == (None,) * 4
    head = (run.folder / "targets.csv").read_text().splitlines()[0]
    assert head == "sensor_image,pose_x,pose_y,pose_z,position,force_level,repeat,target_force_n,image_sha256"
    for row in run.rows:
        index = 4 * (row.position or 0) - 4 + 12 * (row.force_level or 0) - 12
        assert (run.folder / row.path).read_bytes() == (folder / f"{index}.png").read_bytes()
        assert np.array_equal(run.frame(row, verify=True), cv2.imread(str(folder / f"{index}.png")))
    assert all(check_run(folder).ok for folder in find_runs([tmp_path / "out"]))


@pytest.mark.parametrize("prints", ["0 1 2", "1 2 12", "1001 1002 20240131", "007 7 8", "+1 -1 1.0", "1_0 10 ١"])
def test_prints_are_named_by_numbers_of_any_kind(prints: str, images: Any, table: Any, tmp_path: Path) -> None:
    """Counted from 0, from 1, or the numbers of an inventory: every run can be read, and has the name of its print."""
    names = prints.split()
    rows = [(f"{i}.png", "cork", names[i % 3]) for i in range(6)]
    folder, labels = images(6), table(tmp_path / "labels.csv", ("file", "label", "print"), rows)
    assert import_samples([folder, labels], tmp_path / "out").ok
    runs = [Run.open(folder) for folder in find_runs([tmp_path / "out"])]
    assert sorted(str(run.info.printed.copy) for run in runs) == sorted(names)
    for run in runs:
        assert len(run.rows) == 2
        assert not [f for f in check_run(run.folder).findings if f.kind not in ("contrast", "blurred", "identical")]


def test_everything_is_optional(images: Any, table: Any, tmp_path: Path) -> None:
    folder = images(4)
    report = import_samples([folder], tmp_path / "a")
    assert [run.folder.name for run in report.runs] == ["unknown"]
    table(folder / "names.csv", ("file",), [(f"{i}.png",) for i in range(4)])
    report = import_samples([folder], tmp_path / "b")
    assert report.ok and Run.open(tmp_path / "b" / "unknown").info.printed.texture is None
    table(folder / "names.csv", ("file", "class"), [(f"{i}.png", "") for i in range(4)])
    assert import_samples([folder], tmp_path / "c").runs[0].folder.name == "unknown"


def test_jpeg_files_are_copied_unchanged(images: Any, tmp_path: Path) -> None:
    folder = images(3, suffix=".jpg")
    content = (folder / "2.jpg").read_bytes()
    (folder / "2.jpg").write_bytes(content[: len(content) // 2])
    report = import_samples([folder], tmp_path / "out")
    assert [sample.reason for sample in report.left_out] == [
        "is not a readable JPEG image; the file is incomplete or damaged"
    ]
    run = Run.open(tmp_path / "out" / "unknown")
    assert [row.path for row in run.rows] == ["sensor_images/image_1.jpg", "sensor_images/image_2.jpg"]
    for number, row in enumerate(run.rows):
        assert (run.folder / row.path).read_bytes() == (folder / f"{number}.jpg").read_bytes()
        assert np.array_equal(run.frame(row, verify=True), cv2.imread(str(folder / f"{number}.jpg")))
    assert not [
        finding for finding in check_run(run.folder).findings if finding.kind in ("unreadable", "shape", "checksum")
    ]
    export_runs([run.folder], "imagefolder", tmp_path / "exported")
    names = [path.name for path in sorted((tmp_path / "exported" / UNLABELLED).iterdir())]
    assert names == ["00000001.jpg", "00000002.jpg"]
    (run.folder / run.rows[0].path).write_bytes(content)
    assert [finding.kind for finding in check_run(run.folder).findings if finding.kind == "checksum"] == ["checksum"]


@pytest.mark.parametrize("suffix", [".bmp", ".tif"])
def test_other_images_are_stored_without_loss(suffix: str, images: Any, tmp_path: Path) -> None:
    folder = images(3, suffix=suffix)
    assert import_samples([folder], tmp_path / "out").ok
    run = Run.open(tmp_path / "out" / "unknown")
    for number, row in enumerate(run.rows):
        assert np.array_equal(run.frame(row), cv2.imread(str(folder / f"{number}{suffix}"), cv2.IMREAD_UNCHANGED))


def test_images_of_16_bits_and_of_opaque_pixels(tmp_path: Path, noise: Any) -> None:
    for name, array in (
        ("deep", np.random.default_rng(0).integers(0, 2**16, (12, 16), dtype=np.uint16)),
        ("opaque", np.dstack([noise(1, (12, 16, 3)), np.full((12, 16), 255, np.uint8)])),
    ):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "a.png"), array)
        assert import_samples([tmp_path / name], tmp_path / f"{name}-out").ok
        run = Run.open(tmp_path / f"{name}-out" / "unknown")
        assert np.array_equal(run.frame(run.rows[0]), array if name == "deep" else array[..., :3])
    clear = np.dstack([noise(1, (12, 16, 3)), noise(2, (12, 16))])
    cv2.imwrite(str(tmp_path / "opaque" / "a.png"), clear)
    assert "transparent" in import_samples([tmp_path / "opaque"], tmp_path / "out").left_out[0].reason


def test_one_folder_for_each_class(images: Any, tmp_path: Path) -> None:
    for name in ("classes/cork", "classes/felt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        images(3, name)
    (tmp_path / "classes/felt/notes.txt").write_text("by hand")
    report = import_samples([tmp_path / "classes"], tmp_path / "out")
    assert [(run.folder.name, run.imported) for run in report.runs] == [("cork", 3), ("felt", 3)]
    assert report.ok and report.notes == ("classes: 1 other file not imported: 1 .txt",)


def test_folders_of_a_split_are_not_classes(images: Any, tmp_path: Path) -> None:
    for name in ("split/train/cork", "split/train/felt", "split/test/cork"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        images(2, name)
    report = import_samples([tmp_path / "split"], tmp_path / "out")
    assert [(run.folder.name, run.imported) for run in report.runs] == [("cork", 4), ("felt", 2)]
    assert report.notes == ("split: test, train are parts of a split; the folders within them are the classes",)


def test_a_table_of_a_german_spreadsheet(images: Any, tmp_path: Path) -> None:
    folder = images(4)
    lines = ["image;label;print;force;x_mm", *(f"{i}.png;Kork;{i // 2};{1 + i % 2},5;-0,25" for i in range(4))]
    (folder / "labels.csv").write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode() + b"\r\n")
    report = import_samples([folder], tmp_path / "out")
    assert report.ok and [run.folder.name for run in report.runs] == ["Kork_0", "Kork_1"]
    rows = Run.open(report.runs[0].folder).rows
    assert [(row.target_force_n, row.pose_x) for row in rows] == [(1.5, -0.25), (2.5, -0.25)]


def test_absolute_paths_inside_the_folder_are_accepted(images: Any, table: Any, tmp_path: Path) -> None:
    folder = images(3)
    paths = [folder / "0.png", folder / "1.png", tmp_path / "2.png"]
    labels = table(tmp_path / "labels.csv", ("image", "label"), [(path, "cork") for path in paths])
    report = import_samples([folder, labels], tmp_path / "out")
    assert report.runs[0].imported == 2
    assert [sample.reason for sample in report.left_out] == ["is a path outside the folder"]


def test_a_toolchains_folder_round_trips(run_folder: Path, tmp_path: Path) -> None:
    export_tactile_data(run_folder, tmp_path / "exported")
    report = import_samples([tmp_path / "exported"], tmp_path / "out")
    assert report.ok and report.runs[0].kind == "a TacTip toolchain's folder" and report.runs[0].imported == 16
    original, again = Run.open(run_folder), Run.open(report.runs[0].folder)
    assert again.info.simulated
    for row in again.rows:
        first = original.by_key[row.key]
        assert (row.position, row.force_level, row.repeat) == (first.position, first.force_level, first.repeat)
        assert row.pose_mm == first.pose_mm and row.measured_force_n == first.measured_force_n


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-30])


def other_size(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((10, 12, 3), np.uint8))


def huge(path: Path) -> None:
    head = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(b"")), (b"IEND", b"")]
    packed = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(packed))


def link_out(path: Path) -> None:
    path.rename(path.parent.parent / "secret.png")
    path.symlink_to(path.parent.parent / "secret.png")


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (truncated, "not a readable PNG"),
        (other_size, r"has shape \(10, 12, 3\), but the run has \(24, 32, 3\)"),
        (huge, "megapixels"),
        (Path.unlink, "No such file"),
        (link_out, "is a link to a file outside"),
        (pipe, "pipe"),
        (lambda path: path.write_text("no image"), "not a readable image"),
        (lambda path: path.write_bytes(b"\xff\xd8\xff\xe0"), "not a readable JPEG"),
        (lambda path: path.write_bytes(b""), "not a readable image"),
    ],
)
@pytest.mark.parametrize("number", [0, 5])
def test_a_bad_image_is_left_out_with_a_message_of_one_line(
    damage: Callable[[Path], object],
    message: str,
    number: int,
    images: Any,
    table: Any,
    tmp_path: Path,
    capsys: Capture,
) -> None:
    folder = images(8)
    labels = table(tmp_path / "labels.csv", ("image", "label"), [(f"{i}.png", "cork") for i in range(8)])
    damage(folder / f"{number}.png")
    assert main(["import-frames", str(folder), str(labels), "-o", str(tmp_path / "out")]) == 1
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("left out")]
    assert len(lines) == 1 and f"labels.csv line {number + 2} ({number}.png)" in lines[0]
    assert re.search(message, lines[0])
    assert len(Run.open(tmp_path / "out" / "cork").rows) == 7
    assert main(["check-runs", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize("name", ["../x.png", "/etc/passwd", "a/../../x.png", "..\\x.png", ""])
def test_a_path_outside_the_folder_is_left_out(name: str, images: Any, table: Any, tmp_path: Path) -> None:
    labels = table(tmp_path / "labels.csv", ("image", "label"), [("0.png", "a"), (name, "a"), ("0.png", "b")])
    report = import_samples([images(1), labels], tmp_path / "out")
    assert len(report.left_out) == 2 and sum(run.imported for run in report.runs) == 1
    assert "outside the folder" in report.left_out[0].reason or not name
    assert "has the same image as labels.csv line 2" in report.left_out[1].reason


@pytest.mark.parametrize(
    ("header", "rows", "columns", "message"),
    [
        (
            ("image", "label"),
            [("0.png", "Cork"), ("1.png", "cork")],
            {},
            r"labels.csv line 3 \(1.png\): label = 'cork'",
        ),
        (("image", "label"), [("0.png", "a")], {"lable": "label"}, 'did you mean "label"'),
        (("image", "label"), [("0.png", "a")], {"print": "blok"}, "no such column"),
        (("image", "image"), [("0.png", "a")], {}, "name of two columns"),
        (("image", "printer"), [("0.png", "ender 3"), ("1.png", "Ender_3")], {}, "would both become ender-3"),
        (("image", "force"), [(f"{i}.png", f"0.{i}1") for i in range(30)], {}, "measured forces"),
    ],
)
def test_contradictions_are_refused_before_anything_is_written(
    header: Any, rows: Any, columns: Any, message: str, images: Any, table: Any, tmp_path: Path
) -> None:
    labels = table(tmp_path / "labels.csv", header, rows)
    options = ImportOptions(columns=columns)
    try:
        with pytest.raises(InputError, match=message):
            report = import_samples([images(2), labels], tmp_path / "out", options)
            # A contradiction of a single sample raises no error; it only leaves the sample out.
            raise InputError("left out", None, report.left_out[0].reason)
    finally:
        assert not (tmp_path / "out").exists()


def test_names_translate_words(images: Any, table: Any, tmp_path: Path, capsys: Capture) -> None:
    rows = [("0.png", "Bambu", "PLAminus", "z0"), ("1.png", "bambu", "plaminus", "Z0"), ("2.png", "other", "", "z1")]
    labels = table(tmp_path / "labels.csv", ("image", "printer", "filament", "label"), rows)
    names = tmp_path / "names.toml"
    names.write_text('[printers]\nBAMBU = "bambu-p1p"\n[labels]\nz0 = "texture-1"\n')
    assert main(["import-frames", str(images(3)), str(labels), "--names", str(names), "-o", str(tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["texture-1_bambu-p1p_plaminus", "z1_other"]
    names.write_text('[printer]\nbambu = "bambu-p1p"\n')
    assert main(["import-frames", str(images(3)), str(labels), "--names", str(names), "-o", str(tmp_path / "b")]) == 2
    assert 'did you mean "printers"' in capsys.readouterr().err


def test_an_interrupted_import_is_resumed(
    images: Any, table: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, out = images(24), tmp_path / "out"
    labels = table(tmp_path / "labels.csv", HEADER, rows_of(24))
    real = run_writer.RunWriter.sample

    def interrupted(self: Any, number: int, *rest: Any, **values: Any) -> None:
        if number == 4:
            raise KeyboardInterrupt
        real(self, number, *rest, **values)

    monkeypatch.setattr(run_writer.RunWriter, "sample", interrupted)
    with pytest.raises(KeyboardInterrupt):
        import_samples([folder, labels], out, OPTIONS)
    assert len((out / "cork_b0" / "source.csv").read_text().splitlines()) == 1 + 3
    monkeypatch.undo()
    report = import_samples([folder, labels], out, OPTIONS)
    assert report.ok and [(run.present, run.imported) for run in report.runs] == [(3, 3), (0, 6), (0, 6), (0, 6)]
    complete = import_samples([folder, labels], tmp_path / "whole", OPTIONS)
    for run in complete.runs:
        ours = out / run.folder.name
        for name in ("targets.csv", "source.csv"):
            assert (ours / name).read_bytes() == (run.folder / name).read_bytes()
    shutil.copy(folder / "0.png", folder / "new.png")
    table(labels, HEADER, [*rows_of(24), ("new.png", "cork", "b0", "a", 0.5)])
    changed = import_samples([folder, labels], out, OPTIONS)
    assert [sample.where for sample in changed.left_out] == ["cork_b0"] and len(changed.runs) == 3


def test_two_samples_of_the_same_position_and_repeat(images: Any, table: Any, tmp_path: Path) -> None:
    rows = [(f"{i}.png", "cork", 1, 1, repeat) for i, repeat in enumerate((1, 2, 2))]
    labels = table(tmp_path / "labels.csv", ("image", "label", "print", "position", "repeat"), rows)
    report = import_samples([images(3), labels], tmp_path / "out")
    assert "has the same print, position, force and repeat as labels.csv line 3" in report.left_out[0].reason


def test_memory_does_not_grow_with_the_images(tmp_path: Path, noise: Any) -> None:
    (tmp_path / "frames").mkdir()
    for number in range(40):
        cv2.imwrite(str(tmp_path / "frames" / f"{number}.png"), noise(number, (120, 160, 3)))
    import_samples([tmp_path / "frames"], tmp_path / "warm")
    tracemalloc.start()
    assert import_samples([tmp_path / "frames"], tmp_path / "out").runs[0].imported == 40
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 * 120 * 160 * 3 / 2


def test_the_command_reports_the_result(images: Any, table: Any, tmp_path: Path, capsys: Capture) -> None:
    folder = images(24)
    labels = table(tmp_path / "labels.csv", HEADER, rows_of(24))
    columns = "label=material,copy=block_id,position=place,force=newtons"
    words = ["import-frames", str(folder), str(labels), "--columns", columns, "-o", str(tmp_path / "out")]
    assert main(words) == 0
    output = capsys.readouterr()
    assert "24 samples in 4 runs" in output.out and "Next: tacbench check-runs" in output.out
    (folder / "7.png").unlink()
    shutil.rmtree(tmp_path / "out")
    assert main([*words, "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["ok"] and len(document["left_out"]) == 1 and len(document["runs"]) == 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "does not exist"),
        (["--kind", "image"], 'did you mean "images"'),
        (["--columns", "label"], "must be NAME=VALUE"),
        (["--columns", "label=a,label=b"], "has label twice"),
        ([], "Missing argument"),
    ],
)
def test_unknown_words_are_refused(words: list[str], message: str, tmp_path: Path, capsys: Capture) -> None:
    assert main(["import-frames", *words, "-o", str(tmp_path / "out")]) != 0
    output = capsys.readouterr()
    assert message in output.out + output.err
    assert not (tmp_path / "out").exists()


def test_the_command_accepts_every_kind() -> None:
    assert tuple(CORE) == import_frames.KINDS


def test_a_run_keeps_the_checksum_of_the_file_that_was_imported(images: Any, tmp_path: Path) -> None:
    folder = images(2)
    run = Run.open(import_samples([folder], tmp_path / "out").runs[0].folder)
    digests = [hashlib.sha256((folder / f"{number}.png").read_bytes()).hexdigest() for number in range(2)]
    assert [row.image_sha256 for row in run.rows] == digests
