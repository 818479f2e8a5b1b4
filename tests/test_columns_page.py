"""The page ``docs/columns.md`` names each column of a CSV file and each key of a JSON document."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.gcode_writer import write_gcode
from helpers.printers import PRINTER
from helpers.scan_documents import scan_document, write_scan
from helpers.studies import write_study

from tacbench_cad.cli import main
from tacbench_cad.extensions.scan import analysing, writing
from tacbench_cad.extensions.scan.result import WAVE_COLUMNS
from tacbench_cad.extensions.scan.roughness import Roughness
from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_scan
from tacbench_cad.extensions.slicing import plates
from tacbench_cad.lab.analysis import answers, compare
from tacbench_cad.lab.analysis.classification import result, score
from tacbench_cad.lab.analysis.classification.split_files import PRESS_COLUMNS
from tacbench_cad.lab.analysis.report import results, scans
from tacbench_cad.lab.analysis.variance import view
from tacbench_cad.lab.runs import schema
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

DOCS = Path(__file__).parent.parent / "docs"
#: Keys of tables whose keys are data: names of folds and textures, kinds of moves.
KEYED_BY_DATA = ("folds", "recall", "left_out")
#: The headers of each table, and the page that explains them.
TABLES = {
    **{f"{name}.csv": [column.name for column in columns] for name, columns in view.COLUMNS.items()},
    "classification.csv": [column.name for column in result.COLUMNS],
    "texture_answers.csv": [column.name for column in answers.COLUMNS],
    "confusion.csv": [column.name for column in result.CONFUSION_COLUMNS],
    "predictions.csv": [column.name for column in result.PREDICTION_COLUMNS],
    "sweep.csv": [column.name for column in result.SWEEP_COLUMNS],
    "comparison.csv": [column.name for column in compare.COLUMNS],
    "textures.csv": [column.name for column in results.COLUMNS],
    "scans.csv": [column.name for column in scans.COLUMNS],
    "columns of score": score.COLUMNS,
    "presses of a split": PRESS_COLUMNS,
    "series of a press": schema.columns(schema.MovingRow),
    "layout of a plate": plates.COLUMNS,
    "deviation.csv": writing.MAP_COLUMNS,
    "waves.csv": WAVE_COLUMNS,
}
Capture = pytest.CaptureFixture[str]


def named(page: str) -> set[str]:
    """Return all words that a page sets as code, outside of its code blocks."""
    text = re.sub(r"^```.*?^```", "", (DOCS / page).read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return {word for span in re.findall(r"`([^`\n]+)`", text) for word in span.replace(",", " ").split()}


def keys(document: Any) -> Iterator[str]:
    """Yield every key of a JSON document, at any depth."""
    if isinstance(document, list):
        for item in document:
            yield from keys(item)
    elif isinstance(document, dict):
        for name, value in document.items():
            yield name
            by_data = name in KEYED_BY_DATA and isinstance(value, dict)
            yield from keys(list(value.values()) if by_data else value)


@pytest.mark.parametrize("table", TABLES)
def test_every_header_of_a_table_is_explained(table: str) -> None:
    assert set(TABLES[table]) <= named("columns.md")


def test_the_run_folders_page_explains_every_column_of_a_press() -> None:
    first, last = "pose_x", "pose_Rz"
    assert first in named("runs.md") and last in named("runs.md")
    assert set(schema.COLUMNS) - set(schema.POSE_COLUMNS) - set(schema.SHEAR_COLUMNS) <= named("runs.md")


def test_every_key_of_the_parts_documents_is_explained(tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("manifold3d")
    gcode = write_gcode(tmp_path / "two.gcode", Block.of(2, scale=0.5))
    scan = write_scan(tmp_path / "scan", scan_document(Block.of(1), PRINTER))
    model = tmp_path / "my-printer.toml"
    of_block = ("--texture", "1", "--parts", "blocks", "--formats", "stl")
    for argv in (
        ["textures", "--texture", "1"],
        ["make", *of_block, "--out", str(tmp_path / "made")],
        ["make", *of_block, "--out", str(tmp_path / "grid"), "--grid"],
        ["check-part", str(tmp_path / "made" / "texture-1_paper_x1.stl")],
        ["printer-model", str(scan), "-o", str(model), "--no-picture"],
        ["make", *of_block, "--out", str(tmp_path / "corrected"), "--compensate", str(model)],
        ["plate", "--printer", "form-3", "--texture", "1", "--out", str(tmp_path / "plates")],
        ["check-gcode", str(gcode), "--texture", "2", "--scale", "0.5", "--no-picture"],
        ["simulate", "--study", str(_tiny_study(tmp_path)), "--out", str(tmp_path / "runs"), "--jobs", "1"],
    ):
        assert main([*argv, "--json"]) == 0
        assert _unexplained(capsys) == set(), argv[0]
    for folder in ("grid", "corrected"):
        manifest = json.loads((tmp_path / folder / "manifest.json").read_text(encoding="utf-8"))
        assert set(keys(manifest)) <= named("columns.md")


def test_every_key_of_a_scan_is_explained(tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("trimesh")
    # surfalize takes seconds to load
    sizes = dict.fromkeys(("sa_um", "sq_um", "sz_um", "ssk", "sku", "sdr_percent", "filled_fraction"), 1.0)
    monkeypatch.setattr(analysing, "why_missing", lambda *_: None)
    monkeypatch.setattr(analysing, "roughness", lambda _: Roughness(**sizes, area_mm=(1.0, 1.0), filters="none"))
    block, scan = Block.of(2, scale=0.5), tmp_path / "top.ply"
    writing.write_simulated(simulate_scan(block, ScanTruth(points=15_000, seed=1).with_random_pose()), scan)
    gcode = write_gcode(tmp_path / "two.gcode", block)
    words = ("--block", "2", "--scale", "0.5", "--compare", str(gcode), "--out", str(tmp_path / "out"), "--no-picture")
    main(["scan", str(scan), *words, "--json"])
    assert _unexplained(capsys) == set()


@pytest.mark.usefixtures("no_figures")
def test_every_key_of_the_analysis_documents_is_explained(tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("sklearn")
    pytest.importorskip("matplotlib")
    runs = tmp_path / "runs"
    folders = write_study(runs, grid=PressGrid(x_mm=(4.0, 9.0), y_mm=(20.0,)))
    quick = ("--trials", "1", "--hold-out", "copy", "--components", "2", "--jobs", "1", "--epochs", "100")
    splits, predictions = tmp_path / "splits", tmp_path / "predictions.csv"
    # The runs lack references, so that findings are also printed.
    assert main(["check-runs", *map(str, folders), "--json"]) == 1
    assert _unexplained(capsys) == set()
    for argv in (
        ["report", str(runs), "-o", str(tmp_path / "report.html"), "--no-classify", "--jobs", "1"],
        ["variance", str(runs), "--register", "--jobs", "1"],
        ["grade", str(runs)],
        ["classify", str(runs), "-o", str(tmp_path / "a"), *quick],
        ["classify", str(runs), "-o", str(tmp_path / "b"), *quick, "--seed", "1"],
        ["compare", str(tmp_path / "a"), str(tmp_path / "b"), "-o", str(tmp_path / "comparison")],
        ["split", str(runs), "-o", str(splits), "--hold-out", "copy"],
    ):
        assert main([*argv, "--json"]) == 0
        assert _unexplained(capsys) == set(), argv[0]
    split = json.loads((splits / "split_copy.json").read_text(encoding="utf-8"))
    assert set(keys(split)) <= named("columns.md")
    rows = [",".join(score.COLUMNS)]
    for fold in split["folds"]:
        rows += [",".join(map(str, (fold["name"], *split["presses"][i][:5]))) for i in fold["test"]]
    predictions.write_text("\n".join(rows) + "\n", encoding="utf-8")
    assert main(["score", str(predictions), str(splits / "split_copy.json"), "--json"]) == 0
    assert _unexplained(capsys) == set()


def _unexplained(capsys: Capture) -> set[str]:
    """Return the keys of the printed document that the page does not name."""
    return set(keys(json.loads(capsys.readouterr().out))) - named("columns.md")


def _tiny_study(folder: Path) -> Path:
    path = folder / "study.toml"
    path.write_text(
        '[study]\ntextures = [1]\nprints = [{ printer = "resin", filament = "resin", force_levels = [1] }]\n'
        "[protocol]\ngrid = { x_mm = [4.0], y_mm = [20.0] }\nstationary_frames = 1\nrepeats = 1\n",
        encoding="utf-8",
    )
    return path


def test_the_examples_that_teach_are_outputs_of_the_analysis_page() -> None:
    analysis, text = ((DOCS / page).read_text(encoding="utf-8") for page in ("analysis.md", "numbers.md"))
    block = re.compile(r"^```text(?: output)?\n.*?^```", re.DOTALL | re.MULTILINE)
    shown = set(re.findall(r"\d+\.\d+", " ".join(block.findall(analysis))))
    examples = block.findall(text)
    rows = {section: re.findall(r"^\|.*", body, re.MULTILINE) for section, body in _sections(text)}
    for section in ("What the numbers mean", "Variance components", "Hold-out levels", "Two sensors"):
        examples += rows[section]
    numbers = re.findall(r"\d+\.\d+", re.sub(r"^\| force level .*", "", "\n".join(examples), flags=re.MULTILINE))
    assert len(numbers) > 50
    assert set(numbers) <= shown


def _sections(text: str) -> list[tuple[str, str]]:
    """Return the headings of a page, each with the text below it."""
    return re.findall(r"^#+ (.+)\n((?:(?!#+ ).*\n)*)", text, re.MULTILINE)
