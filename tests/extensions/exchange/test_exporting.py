"""Test ``tacbench export-runs --to huggingface|webdataset|imagefolder|zarr|npz``: complete, streamed and unchanged."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
import tarfile
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.cli import main
from tacbench_cad.extensions.exchange.exporting import export_formats, npz, web_dataset
from tacbench_cad.extensions.exchange.exporting.export_formats import ExportFormat, export_runs
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples
from tacbench_cad.extensions.exchange.exporting.image_folder import folder_names
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.util import entries as entry_points
from tacbench_cad.util.entries import entries
from tacbench_cad.util.errors import CheckFailedError, InputError

Capture = pytest.CaptureFixture[str]
PACKAGES = {"huggingface": "pyarrow", "zarr": "zarr"}
SIMULATED = "stage: stage model"

FORMATS = tuple(entries("tacbench.export_formats"))


def needs(to: str) -> None:
    if to in PACKAGES:
        pytest.importorskip(PACKAGES[to])


def rows_of(folder: Path) -> list[Any]:
    return sorted(Run.open(folder).rows, key=lambda row: row.number)


def test_the_tar_contains_each_images_bytes_and_a_document(run_folder: Path, tmp_path: Path) -> None:
    samples = export_runs([run_folder], "webdataset", tmp_path / "out")
    assert len(samples) == 16
    with tarfile.open(tmp_path / "out" / "frames-000000.tar") as shard:
        assert "simulated data" in shard.pax_headers["comment"]
        members = {member.name: shard.extractfile(member).read() for member in shard}  # type: ignore[union-attr]
    assert len(members) == 32
    for number, row in enumerate(rows_of(run_folder), start=1):
        assert members[f"{number:08d}.png"] == (run_folder / row.path).read_bytes()
        document = json.loads(members[f"{number:08d}.json"])
        assert document["measured_force_n"] == row.measured_force_n
        assert (document["run"], document["label"], document["simulated"]) == ("run", "texture-4", SIMULATED)
        assert document["time_utc"].endswith("Z") and document["in_band"] is row.in_band


def test_tar_files_are_divided_at_the_given_size(run_folder: Path, tmp_path: Path) -> None:
    web_dataset.write(Samples([run_folder]), tmp_path, shard_bytes=20_000)
    names = []
    for path in sorted(tmp_path.glob("*.tar")):
        with tarfile.open(path) as shard:
            names.append(shard.getnames())
    assert len(names) > 1 and sum(map(len, names)) == 32
    assert all(len(shard) % 2 == 0 for shard in names)


def test_the_folder_of_each_label_contains_the_unchanged_images(run_folder: Path, tmp_path: Path) -> None:
    export_runs([run_folder], "imagefolder", tmp_path / "out")
    with (tmp_path / "out" / "metadata.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    assert [row["file_name"] for row in table] == [f"texture-4/{number:08d}.png" for number in range(1, 17)]
    for line, row in zip(table, rows_of(run_folder), strict=True):
        assert (tmp_path / "out" / line["file_name"]).read_bytes() == (run_folder / row.path).read_bytes()
        assert float(line["pose_x"]) == row.pose_x and line["simulated"] == SIMULATED


@pytest.mark.parametrize("label", ["..", "a/b", "../../x", " ", "a\\b", ".hidden", "ß" * 300])
def test_a_label_that_is_not_a_folder_name_stays_inside_the_output(label: str, tmp_path: Path) -> None:
    names = folder_names([label, label + "x", label.upper()])
    for name in names.values():
        path = (tmp_path / name).resolve()
        assert path.parent == tmp_path.resolve() and not path.name.startswith(".")
        path.mkdir()
    assert len({name.lower() for name in names.values()}) == len(names)


def test_numpy_reads_frames_and_columns(run_folder: Path, tmp_path: Path) -> None:
    export_runs([run_folder], "npz", tmp_path / "out")
    run, rows = Run.open(run_folder), rows_of(run_folder)
    with np.load(tmp_path / "out" / npz.FILE, allow_pickle=False) as data:
        assert np.array_equal(data["frames"], [run.frame(row) for row in rows])
        assert data["label"].tolist() == ["texture-4"] * 16
        assert data["measured_force_n"].tolist() == [row.measured_force_n for row in rows]
        assert data["in_band"].dtype == bool and data["repeat"].dtype == int and data["copy"].tolist() == ["2"] * 16
        assert data["simulated"].tolist() == [SIMULATED] * 16


def test_an_empty_column_has_no_array_and_a_missing_number_is_nan(run_folder: Path, tmp_path: Path) -> None:
    table = run_folder / "targets.csv"
    with table.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for index, row in enumerate(rows):
        row["force_after_n"] = ""
        row["in_band"] = row["in_band"] if index else ""
    with table.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    export_runs([run_folder], "npz", tmp_path / "out")
    with np.load(tmp_path / "out" / npz.FILE) as data:
        assert "force_after_n" not in data
        assert data["in_band"].dtype == float and np.isnan(data["in_band"]).sum() == 1
    page = (tmp_path / "out" / "README.md").read_text()
    assert "Unknown for 1 of 16." in page and "force_after_n" not in page


def test_zarr_reads_frames_columns_and_attributes(run_folder: Path, tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    export_runs([run_folder], "zarr", tmp_path / "out")
    run, rows = Run.open(run_folder), rows_of(run_folder)
    group = zarr.open_group(tmp_path / "out" / "frames.zarr", mode="r")
    assert group.metadata.zarr_format == 3
    assert np.array_equal(group["frames"][:], [run.frame(row) for row in rows])
    assert group["frames"].metadata.dimension_names == ("sample", "y", "x")
    assert list(group["label"][:]) == ["texture-4"] * 16
    assert group["pose_x"][:].tolist() == [row.pose_x for row in rows]
    assert group.attrs["simulated"] == [SIMULATED] and group.attrs["runs"] == ["run"]


def test_parquet_contains_the_images_bytes_and_typed_columns(run_folder: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    export_runs([run_folder], "huggingface", tmp_path / "out")
    table = parquet.read_table(tmp_path / "out" / "data" / "train-00000.parquet")
    rows = rows_of(run_folder)
    assert [image["bytes"] for image in table["image"].to_pylist()] == [
        (run_folder / row.path).read_bytes() for row in rows
    ]
    assert table["time_utc"].to_pylist() == [row.time_utc for row in rows]
    assert table["repeat"].to_pylist() == [row.repeat for row in rows]
    assert table.schema.metadata[b"simulated"] == SIMULATED.encode()


@pytest.mark.parametrize("to", FORMATS)
def test_a_readme_is_written_next_to_the_data(to: str, run_folder: Path, tmp_path: Path) -> None:
    needs(to)
    export_runs([run_folder], to, tmp_path / "out")
    page = (tmp_path / "out" / "README.md").read_text()
    assert "16 frames" in page and "simulated data" in page and "| texture-4 | 16 |" in page
    assert page.startswith("---\n") is (to == "huggingface")


@pytest.mark.parametrize("to", FORMATS)
def test_a_changed_frame_stops_the_export_and_leaves_nothing(to: str, run_folder: Path, tmp_path: Path) -> None:
    needs(to)
    (run_folder / "sensor_images" / "image_9.png").write_bytes(
        (run_folder / "sensor_images" / "image_4.png").read_bytes()
    )
    with pytest.raises(CheckFailedError, match=r"image_9.png: was changed"):
        export_runs([run_folder], to, tmp_path / "new" / "out")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


@pytest.mark.parametrize("to", FORMATS)
def test_an_interruption_leaves_nothing(to: str, run_folder: Path, tmp_path: Path) -> None:
    needs(to)

    def stop(done: int, count: int) -> None:
        assert count == 16
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_runs([run_folder], to, tmp_path / "out", stop)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run"]


def test_remains_of_a_killed_export_are_removed_by_the_next(run_folder: Path, tmp_path: Path) -> None:
    program = "import os, sys, pathlib; from tacbench_cad.util.files import replacing_folder\n"
    program += "with replacing_folder(pathlib.Path(sys.argv[1])) as left: (left / 'x').touch(); os.abort()"
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "out")])
    (left,) = tmp_path.glob(".tacbench-unfinished-folder-*")
    assert (left / "x").exists()
    export_runs([run_folder], "npz", tmp_path / "out")
    assert not left.exists()


def test_existing_output_is_not_overwritten(run_folder: Path, tmp_path: Path, capsys: Capture) -> None:
    words = ["export-runs", str(run_folder), "--to", "npz", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    assert "1 run, 16 frames" in capsys.readouterr().out
    before = (tmp_path / "out" / npz.FILE).read_bytes()
    assert main(words) == 2
    assert "already exists; remove it or choose another folder" in capsys.readouterr().err
    assert (tmp_path / "out" / npz.FILE).read_bytes() == before


def test_frames_of_another_shape_are_refused_as_arrays(
    run_folder: Path, tmp_path: Path, make_info: Any, filled: Any
) -> None:
    with RunWriter.open(tmp_path / "wide", make_info(shape=(24, 40))) as writer:
        filled(writer)
    with pytest.raises(InputError, match="export each sensor separately"):
        export_runs([run_folder, tmp_path / "wide"], "npz", tmp_path / "out")
    assert len(export_runs([run_folder, tmp_path / "wide"], "webdataset", tmp_path / "tar")) == 32


def test_frames_that_are_not_images_are_exported_to_arrays_and_tars(
    tmp_path: Path, make_info: Any, filled: Any
) -> None:
    with RunWriter.open(tmp_path / "run", make_info(shape=(16,))) as writer:
        filled(writer)
    for to in ("huggingface", "imagefolder"):
        needs(to)
        with pytest.raises(InputError, match="is for images"):
            export_runs([tmp_path / "run"], to, tmp_path / "out")
    export_runs([tmp_path / "run"], "npz", tmp_path / "arrays")
    with np.load(tmp_path / "arrays" / npz.FILE) as data:
        assert data["frames"].shape == (16, 16) and data["frames"].dtype == float
    export_runs([tmp_path / "run"], "webdataset", tmp_path / "tar")
    with tarfile.open(tmp_path / "tar" / "frames-000000.tar") as shard:
        member = shard.extractfile("00000001.npy")
        assert member is not None and np.load(io.BytesIO(member.read())).shape == (16,)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "hugging-face"], 'did you mean "huggingface"?'),
        (["--to", "npz"], "--out DIR: is missing; --to npz needs a new folder"),
        (["--to", "npz", "-o", "x", "--size", "64x64"], "size: is only for --to tactile-data"),
        (["--to", "npz", "-o", "x", "--colour"], "colour: is only for --to tactile-data"),
    ],
)
def test_invalid_options_are_refused(words: list[str], message: str, run_folder: Path, capsys: Capture) -> None:
    assert main(["export-runs", str(run_folder), *words]) == 2
    assert message in capsys.readouterr().err


def _write_keys(samples: Samples, folder: Path) -> None:
    (folder / "keys.txt").write_text("".join(f"{sample.key} {sample.values['label']}\n" for sample in samples))


#: A format as another package would have it.
KEYS = ExportFormat(write=_write_keys, loading='open("keys.txt").read()')


def test_another_package_adds_a_format(run_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("keys", f"{__name__}:KEYS", export_formats.GROUP)
    monkeypatch.setattr(entry_points, "entries", lambda group: {"keys": entry})
    samples = export_runs([run_folder], "keys", tmp_path / "out")
    assert len((tmp_path / "out" / "keys.txt").read_text().splitlines()) == len(samples)
    assert KEYS.loading in (tmp_path / "out" / "README.md").read_text()
