"""Test ``tacbench variance``: its output, its files and its exit codes."""

from __future__ import annotations

import contextlib
import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import PRINTERS, SHAPE, write_study

from tacbench_cad import lab
from tacbench_cad.cli import main
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock

FIGURES = ("variance", "variance_pixels", "variance_positions", "between_textures", "components")
TABLES = (
    *("printer_answers", "variance", "components", "between_textures", "positions", "permutation"),
    *("print_distances", "registration"),
)
#: A combination with figures in the paper.
PAPERS = ("bambu-p1p", "pla-minus")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("printed")
    write_study(folder, prints=(PRINTERS[0], PAPERS), levels=(1, 2), simulated="simulated TacTip")
    return folder


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture(scope="module")
def written(study: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Run the command and return its output folder and its printed output."""
    out, screen = tmp_path_factory.mktemp("written") / "results", io.StringIO()
    with contextlib.redirect_stdout(screen):
        assert main(["variance", str(study), "-o", str(out), "--register", "--jobs", "1"]) == 0
    return out, screen.getvalue()


def test_everything_is_written_and_printed(written: tuple[Path, str]) -> None:
    out, shown = written
    expected = {f"{name}.csv" for name in TABLES}
    expected |= {"variance_settings.json"} | {f"{name}.{kind}" for name in FIGURES for kind in ("png", "pdf")}
    assert {path.name for path in out.iterdir()} == expected
    for name in FIGURES:
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")
    result = rows(out / "variance.csv")
    assert len(result) == 3 * 2 * 2
    assert {row["force_level"] for row in result} == {"1", "2", "all"}
    for name in TABLES:
        heads = list(rows(out / f"{name}.csv")[0])
        assert heads[-1] == "simulated" and len(set(heads)) == len(heads)
    assert list(result[0]) == [
        *("printer", "filament", "texture", "force_level", "variance", "low", "high", "floor", "floor_from"),
        *("noise_alone", "unbiased", "floor_removed", "floor_removed_low", "floor_removed_high", "prints", "presses"),
        *("quantity", "published", "simulated"),
    ]
    assert len(rows(out / "positions.csv")) == 2 * 2 * 2 * 4
    for words in (
        "simulated: sensor (see run.json)\n",
        "variance, 0.08 N (counts^2; grey, full size, ddof 0)",
        "variance, mean of all forces",
        "noise alone",
        "95 % interval",
        "floor removed (ddof 1)",
        "The paper's printed figures are another quantity",
        '"tacbench variance --protocol as-published"',
        "reproducibility SD (counts)",
        "permutation test",
        "registration",
        "warning: ",
        "and 300 (6 x 25 x 2) in the paper's text",
    ):
        assert words in shown, words


def test_json_equals_the_csv(study: Path, written: tuple[Path, str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["variance", str(study), "--json", "--jobs", "1"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["ddof"] == 0 and document["colour"] is False and document["units"] == "counts^2"
    assert document["simulated"] == ["sensor: simulated TacTip"] and document["left_out"] == document["files"] == []
    for ours, theirs in zip(document["variance"], rows(written[0] / "variance.csv"), strict=True):
        assert theirs.pop("simulated") == "true"
        assert {name: "" if ours[name] is None else str(ours[name]) for name in theirs} == theirs


@pytest.mark.usefixtures("no_figures")
def test_the_function_gives_the_tables_of_the_command(study: Path, written: tuple[Path, str], tmp_path: Path) -> None:
    result = lab.variance(lab.read(study))
    texts = [" ".join(row).split() for _, table in result.shown() for row in table.texts]
    lines = [line.split() for line in written[1].splitlines()]
    assert len(texts) > 20 and all(text in lines for text in texts)
    assert all(f"warning: {text}" in written[1].splitlines() for text in result.warnings)
    assert (tmp_path / "variance.csv") in result.save(tmp_path)
    assert rows(tmp_path / "variance.csv") == rows(written[0] / "variance.csv")
    assert [axes.get_visible() for axes in result.figure().axes] == [True, True, True, False]


def test_a_damaged_image_is_reported_and_the_exit_code_is_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = write_study(tmp_path / "runs", textures=(1, 2))
    (folders[2] / "sensor_images" / "image_4.png").write_bytes(b"\x89PNG")
    assert main(["variance", str(tmp_path / "runs"), "--json", "--jobs", "1"]) == 1
    captured = capsys.readouterr()
    assert f"{folders[2].name}/sensor_images/image_4.png: is not a readable image" in captured.err
    assert "Traceback" not in captured.err and captured.err.count("left out") == 1
    document = json.loads(captured.out)
    assert len(document["variance"]) == 2 * 2 * 2 and len(document["left_out"]) == 1


@pytest.mark.usefixtures("no_figures")
def test_other_sensors_are_analysed_in_their_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return 1e-4 * rng.standard_normal((4, 4))

    write_study(tmp_path / "runs", image=image, shape=(4, 4), units="kPa", prints=(PAPERS,))
    out = tmp_path / "results"
    assert main(["variance", str(tmp_path / "runs"), "-o", str(out), "--jobs", "1"]) == 0
    shown = capsys.readouterr().out
    assert "variance, 0.08 N (kPa^2, ddof 0)" in shown
    assert shown.endswith(f"\nNext: tacbench classify {tmp_path / 'runs'}\n")
    assert "paper's printed" not in shown  # the paper's counts are of another unit
    assert len(list(out.glob("*.png"))) == len(FIGURES)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--ddof", "2"], "ddof = 2: must be 0 or 1"),
        (["--ddof", "x"], "ddof = 'x'"),
        (["--jobs", "0"], "jobs = 0"),
        (["--seed", "-1"], "seed = -1"),
    ],
)
def test_invalid_options_are_reported(
    study: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["variance", str(study), *options]) == 2
    assert capsys.readouterr().err.startswith(f"error: {message}")


def test_missing_runs_and_an_unwritable_folder_are_reported(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["variance", str(tmp_path)]) == 2
    assert "contains no run folder" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert main(["variance", str(study), "-o", str(tmp_path / "file"), "--jobs", "1"]) == 2
    assert "is not a folder" in capsys.readouterr().err


def test_registration_of_single_prints_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_study(tmp_path / "runs", copies=1)
    assert main(["variance", str(tmp_path / "runs"), "--register", "--jobs", "1"]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: register") and not captured.out


def test_figures_are_drawn_for_the_smallest_possible_study(tmp_path: Path) -> None:
    def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return np.full(SHAPE, 9, dtype=np.uint8)

    write_study(tmp_path / "runs", image=image, textures=(1,), prints=PRINTERS[:1], copies=1, still=0)
    assert main(["variance", str(tmp_path / "runs"), "-o", str(tmp_path / "out"), "--jobs", "1"]) == 0
    assert len(list((tmp_path / "out").glob("*.png"))) == len(FIGURES)
