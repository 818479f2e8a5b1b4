"""Test the reading of runs: lazy, typed, and without trust in the files."""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.frame_files import decoded, encoded
from tacbench_cad.lab.runs.printrecord import FIELDS, form
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_tables import read_table
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.schema import Row, TableRow, columns, parse_row
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.npyfile import array_of, mapped


@dataclass(frozen=True, kw_only=True)
class Pair(TableRow):
    """A row of a table with two columns."""

    FILE = "t.csv"
    a: str
    b: str


def edit(folder: Path, line: int, column: str, value: str) -> None:
    """Change a field of ``targets.csv``; the header is line 1."""
    path = folder / "targets.csv"
    lines = path.read_text().splitlines()
    fields = lines[line - 1].split(",")
    fields[lines[0].split(",").index(column)] = value
    lines[line - 1] = ",".join(fields)
    path.write_text("\n".join(lines) + "\n")


def test_rows_are_typed(run_folder: Path) -> None:
    row = Run.open(run_folder).rows[2]
    assert (row.number, row.position, row.target_depth_mm, row.touch_height_mm) == (3, 3, None, None)
    assert row.pose_mm == (4.0, 23.0, -1.5)
    assert row.key == (1, 1, 3)
    assert row.in_band is False
    assert row.time_utc == datetime(2026, 1, 31, 12, 0, 3, tzinfo=UTC)
    assert (row.target_force_n, row.measured_force_n, row.reference_age_s) == (0.5, 0.53, 3.0)


def test_frames_round_trip(run_folder: Path, noise: Any) -> None:
    run = Run.open(run_folder)
    assert np.array_equal(run.frame(run.rows[4], verify=True), noise(5))
    assert np.array_equal(run.reference(), noise(0))
    assert [frame.shape for frame in run.stationary("end", True)] == [(24, 32)] * 2
    assert run.by_key[(2, 2, 4)].sensor_image == "image_16.png"
    with pytest.raises(InputError, match="reference = 1"):
        run.reference(1)


def test_opening_reads_only_run_json(run_folder: Path) -> None:
    (run_folder / "targets.csv").write_bytes(b"\xff\xfe\n")
    run = Run.open(run_folder)
    assert run.info.printed.texture == "texture-4"
    with pytest.raises(InputError, match="is not UTF-8 text"):
        _ = run.rows


def test_a_run_is_read_without_pandas_opencv_or_cad(run_folder: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from tacbench_cad.lab.runs.reading import Run;"
        f"assert len(Run.open(Path({str(run_folder)!r})).rows) == 16;"
        "print([name for name in ('pandas', 'cv2', 'scipy', 'OCP', 'cadquery', 'serial') if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("sensor_image", "image_0.png", "sensor_image = 'image_0.png'"),
        ("sensor_image", "../image_1.png", "sensor_image"),
        ("sensor_image", "image_17.png", "the protocol has 16 presses"),
        ("sensor_image", "image_5.png", "contradicts the protocol"),
        ("position", "4", "contradicts the protocol"),
        ("position", "x", "position = 'x': must be a whole number"),
        ("measured_force_n", "nan", "measured_force_n = nan: must be a finite number"),
        ("target_force_n", "1e999", "target_force_n"),
        ("pose_x", "", "pose_x = '': must not be empty"),
        ("in_band", "yes", "in_band = 'yes': must be true or false"),
        ("time_utc", "yesterday", "time_utc = 'yesterday'"),
        ("time_utc", "2026-01-31T12:00:00", "must have a time zone"),
        ("image_sha256", "abc", "image_sha256"),
        ("repeat", "1,2", "fields, but the header has 14"),
    ],
)
def test_a_bad_row_is_reported_with_its_line(column: str, value: str, message: str, run_folder: Path) -> None:
    edit(run_folder, 4, column, value)
    with pytest.raises(InputError, match=message) as caught:
        _ = Run.open(run_folder).rows
    assert "targets.csv line 4" in str(caught.value)


def test_a_repeated_row_is_refused(run_folder: Path) -> None:
    path = run_folder / "targets.csv"
    path.write_text(path.read_text() + path.read_text().splitlines(keepends=True)[3])
    with pytest.raises(InputError, match=r"line 18: sensor_image = 'image_3.png': is already in line 4"):
        _ = Run.open(run_folder).rows


def test_an_incomplete_last_row_is_ignored(run_folder: Path) -> None:
    path = run_folder / "targets.csv"
    path.write_bytes(path.read_bytes()[:-30])
    assert [row.number for row in Run.open(run_folder).rows] == list(range(1, 16))


def test_a_path_outside_the_run_is_refused(run_folder: Path) -> None:
    path = run_folder / "references" / "references.csv"
    path.write_text(path.read_text().replace("sensor_images/image_0.png", "../../secret.png"))
    with pytest.raises(InputError, match="must be a file in one of the folders sensor_images"):
        _ = Run.open(run_folder).references


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "cannot be read"),
        (lambda path: path.write_bytes(path.read_bytes()[:200]), "is not a readable"),
        (lambda path: path.write_bytes(b"GIF89a"), "is not a readable"),
        (lambda path: path.write_bytes(b""), "is not a readable"),
        (lambda path: path.write_bytes(encoded(np.zeros((8, 8), np.uint8), ())[0]), r"has shape \(8, 8\)"),
        (lambda path: (path.unlink(), path.mkdir()), "is a folder"),
    ],
)
def test_damaged_images_are_reported(damage: Callable[[Path], object], message: str, run_folder: Path) -> None:
    damage(run_folder / "sensor_images" / "image_5.png")
    run = Run.open(run_folder)
    with pytest.raises(CheckFailedError, match=f"image_5.png: {message}"):
        run.frame(run.rows[4])


def _outside(path: Path) -> None:
    """Replace a frame by a link to a copy outside the run."""
    path.rename(path.parents[2] / path.name)
    path.symlink_to(path.parents[2] / path.name)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders, and links need permissions")
@pytest.mark.parametrize(
    ("replace", "message"),
    [
        (_outside, "is a link to a file outside"),
        (lambda path: (path.unlink(), os.mkfifo(path)), "is a pipe, a socket or a device"),
        (lambda path: (path.unlink(), path.symlink_to("/dev/zero")), "is a pipe, a socket or a device"),
        (lambda path: (path.unlink(), path.symlink_to(path)), "cannot be read"),
    ],
)
def test_links_and_pipes_are_refused_without_waiting(
    replace: Callable[[Path], object], message: str, run_folder: Path
) -> None:
    replace(run_folder / "sensor_images" / "image_5.png")
    run = Run.open(run_folder)
    with pytest.raises(CheckFailedError, match=f"image_5.png: {message}"):
        run.frame(run.rows[4])
    (finding,) = check_run(run_folder).findings
    assert finding.kind == "unreadable" and message in finding.text


@pytest.mark.skipif(sys.platform == "win32", reason="links need permissions on Windows")
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("targets.csv", lambda run: run.rows),
        ("references/references.csv", lambda run: run.references),
        ("stationary/stationary.csv", lambda run: run.stationary_frames),
        ("print.toml", lambda run: run.print_record),
        ("run.json", lambda run: run),
    ],
)
def test_links_out_of_a_run_are_refused_for_every_file(
    name: str, read: Callable[[Run], object], run_folder: Path
) -> None:
    path = run_folder / name
    path.rename(run_folder.parent / path.name)
    path.symlink_to(run_folder.parent / path.name)
    with pytest.raises(InputError, match=f"{path.name}: is a link to a file outside|{path.name}.: is a link to"):
        read(Run.open(run_folder))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_a_table_that_is_a_pipe_or_too_large_is_refused(run_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = Run.open(run_folder)
    monkeypatch.setenv("TACBENCH_LIMITS", "1e-6")
    with pytest.raises(InputError, match=r"targets.csv.*MB, more than the .* allowed"):
        _ = run.rows
    monkeypatch.delenv("TACBENCH_LIMITS")
    (run_folder / "targets.csv").unlink()
    os.mkfifo(run_folder / "targets.csv")
    with pytest.raises(InputError, match=r"targets.csv.*is a pipe, a socket or a device"):
        _ = run.rows


def test_a_png_with_a_damaged_length_allocates_no_memory() -> None:
    data = bytearray(encoded(np.arange(600, dtype=np.uint8).reshape(20, 30), ("a",))[0])
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = (2**31 - 1).to_bytes(4, "big")
    tracemalloc.start()
    with pytest.raises(CheckFailedError, match="is not a readable PNG image"):
        decoded(bytes(data))
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


def test_a_changed_image_is_detected_on_request(run_folder: Path) -> None:
    images = run_folder / "sensor_images"
    (images / "image_5.png").write_bytes((images / "image_6.png").read_bytes())
    run = Run.open(run_folder)
    assert run.frame(run.rows[4]).shape == (24, 32)
    with pytest.raises(CheckFailedError, match="its checksum differs"):
        run.frame(run.rows[4], verify=True)


class Bomb:
    """An object that runs code when it is unpickled."""

    def __reduce__(self) -> Any:
        return (pytest.fail, ("it was unpickled",))


def npy(array: Any, **options: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, **options)
    return stream.getvalue()


def long_header(shape: str) -> bytes:
    text = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (npy(np.arange(16.0))[:-1], "is truncated"),
        (npy(np.arange(16.0)) + b"\0", "is too long"),
        (npy(np.arange(16.0))[:20], "its header is damaged"),
        (b"", "is not a NumPy file"),
        (pickle.dumps([1, 2]), "is pickled"),
        (npy(np.array([Bomb()], dtype=object), allow_pickle=True), "contains pickled objects"),
        (pickle.dumps(Bomb()), "is pickled"),
        (long_header("(1000000000000000,)"), "is truncated"),
        (long_header("(-1,)"), "its header is damaged"),
        (long_header("(" * 3000), "its header is damaged"),
    ],
)
def test_damaged_numpy_files_are_refused_and_never_unpickled(data: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / "reading.npy"
    path.write_bytes(data)
    with pytest.raises(InputError, match=message):
        mapped(path)
    with pytest.raises(CheckFailedError, match=message):
        array_of(data)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros(15), r"has shape \(15,\), but the frames of the sensor have shape \(16,\)"),
        (np.zeros(16, dtype="U4"), "must contain real numbers"),
        (np.zeros(16, dtype=complex), "must contain real numbers"),
    ],
)
def test_frames_of_another_shape_or_type_are_refused(
    array: Any, message: str, tmp_path: Path, make_info: Any, filled: Any
) -> None:
    with RunWriter.open(tmp_path / "run", make_info(shape=(16,))) as writer:
        filled(writer, count=1)
    (tmp_path / "run" / "sensor_data" / "reading_1.npy").write_bytes(npy(array))
    run = Run.open(tmp_path / "run")
    with pytest.raises(CheckFailedError, match=message):
        run.frame(run.rows[0])


def test_arrays_in_either_memory_order_round_trip() -> None:
    for array in (np.arange(12).reshape(3, 4), np.asfortranarray(np.arange(12).reshape(3, 4)), np.array(3.5)):
        assert np.array_equal(array_of(npy(array)), array)


class TestArbitraryBytes:
    """Arbitrary bytes give a result or one of the project's errors."""

    quietly = settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)

    @quietly
    @given(data=st.binary(max_size=300))
    def test_tables(self, data: bytes, tmp_path: Path) -> None:
        path = tmp_path / "t.csv"
        path.write_bytes(data)
        try:
            table = read_table(tmp_path, Pair)
        except InputError:
            return
        assert table.whole_bytes + len(table.torn) == len(data)

    @quietly
    @given(rows=st.lists(st.tuples(st.text(max_size=5), st.text(max_size=5)), max_size=4), cut=st.integers(0, 60))
    def test_tables_cut_anywhere(self, rows: list[tuple[str, str]], cut: int, tmp_path: Path) -> None:
        path = tmp_path / "t.csv"
        text = "a,b\n" + "".join(f"{hash(a) % 1000},{hash(b) % 1000}\n" for a, b in rows)
        path.write_bytes(text.encode()[: len(text) - cut] if cut < len(text) else b"")
        lines = path.read_bytes().count(b"\n")
        assert len(read_table(tmp_path, Pair).rows) == max(lines - 1, 0)

    @quietly
    @given(
        data=st.binary(max_size=200), begin=st.sampled_from([b"", b"\x93NUMPY\x01\x00", b"\x93NUMPY\x02\x00", b"\x80"])
    )
    def test_numpy_files(self, data: bytes, begin: bytes) -> None:
        try:
            array_of(begin + data)
        except CheckFailedError:
            return

    @quietly
    @given(at=st.integers(0, 700), byte=st.integers(0, 255))
    def test_images(self, at: int, byte: int) -> None:
        data = bytearray(encoded(np.arange(600, dtype=np.uint8).reshape(20, 30), ("a",))[0])
        data[at % len(data)] = byte
        try:
            assert decoded(bytes(data)).size
        except CheckFailedError:
            return

    @quietly
    @given(values=st.fixed_dictionaries({column: st.text(max_size=12) for column in columns(Row)}))
    def test_rows(self, values: dict[str, str]) -> None:
        with pytest.raises(InputError):
            parse_row(Row, values)


def test_the_print_record_is_a_form_with_empty_fields(run_folder: Path) -> None:
    record = Run.open(run_folder).print_record
    assert record.values == {"printer": "bambu-p1p", "filament": "pla-minus"}
    assert set(record.empty) == set(FIELDS) - {"printer", "filament"}
    for word in ("serial", "batch", "slicer", "profile", "nozzle", "layer", "temperature", "infill", "orientation"):
        assert any(word in name for name in FIELDS)
    text = (run_folder / "print.toml").read_text()
    assert text.count("#   0: ") == text.count("#   3: ") == 2
    name = Run.open(run_folder).info.printed.name
    assert text == form(f"Record of the print {name}.", printer="bambu-p1p", filament="pla-minus")


def test_a_filled_print_record_is_read(run_folder: Path) -> None:
    path = run_folder / "print.toml"
    text = path.read_text().replace('nozzle_mm = ""', "nozzle_mm = 0.4").replace('peaks_score = ""', "peaks_score = 0")
    path.write_text(text.replace('date = ""', "date = 2026-01-31").replace("photos = []", 'photos = ["top.jpg"]'))
    record = Run.open(run_folder).print_record
    assert (record.values["nozzle_mm"], record.values["peaks_score"]) == (0.4, 0)
    assert not {"nozzle_mm", "peaks_score", "date", "photos"} & set(record.empty)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('peaks_score = ""', "peaks_score = 4", "peaks_score = 4: must be at most 3"),
        ('nozzle_mm = ""', 'nozzle_mm = "big"', "nozzle_mm = 'big'"),
        ('slicer = ""', 'slizer = ""', 'unknown key; did you mean "slicer"'),
        ('slicer = ""', "slicer = ", "is not valid TOML"),
        ('slicer = ""', "slicer = [1]", "must be a string"),
    ],
)
def test_a_wrong_print_record_is_reported(old: str, new: str, message: str, run_folder: Path) -> None:
    path = run_folder / "print.toml"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        _ = Run.open(run_folder).print_record
