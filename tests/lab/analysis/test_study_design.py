"""Test the design of a study: its groups in their order, what is unknown, and which runs do not belong together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.printers import PRINTER, measured
from helpers.studies import GRID, Plan, write_run, write_study

from tacbench_cad import lab
from tacbench_cad.extensions.printer_models.correction import corrected_for
from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.lab.analysis.study_design import Design, at_level
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError


@pytest.fixture(scope="module")
def presses(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    folder = tmp_path_factory.mktemp("study")
    write_study(folder, levels=(1, 3))
    return lab.read(folder)


def opened(*folders: Path) -> Design:
    return Design.of(lab.read(folders))


def test_the_design_of_planned_presses(presses: pd.DataFrame) -> None:
    design = Design.of(presses)
    assert len(design) == len(presses) and len(design.runs) == 8
    assert design.combinations == ("ender-3_pla-plus", "bambu-p1p_pla-minus")
    assert design.textures == ("texture-1", "texture-2") and design.levels == (1, 3) and design.repeats == 2
    assert np.array_equal(design.positions_mm, GRID.positions_mm) and design.grid == GRID
    assert design.planned and design.contact == "force" and design.in_counts and not design.steps
    assert design.level_name(1) == "0.08 N" and design.level_name("all") == "mean of all forces"
    assert len(Design.of(presses.sample(frac=1.0, random_state=1))) == len(presses)
    for table in (presses, design.presses):
        high = Design.of(at_level(table, 3))
        assert high.levels == (3,) and len(high) == len(presses) // 2
        with pytest.raises(InputError, match="must be a level of the runs: 1, 3"):
            at_level(table, 2)


def test_unknown_facts_of_other_peoples_presses(presses: pd.DataFrame) -> None:
    own = presses[["frame", "texture", "copy"]].assign(frame=presses["frame"])
    design = Design.of(own)
    assert design.has("label") and design.has("print") and not design.has("position")
    assert design.levels == (0,) and design.level_name(0) == "force unknown" and design.unknown_groups == ("sessions",)
    assert design.grid is None and not design.planned and not design.runs
    with pytest.raises(InputError, match=r"needs the position of every sample.*--columns position=COLUMN"):
        design.require("the variance table", "position", "print or repeat")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.head(0), "must be at least one press"),
        (lambda table: table.drop(columns="frame"), "has no column frame"),
        (lambda table: pd.concat([table, table.head(1)]), "is in the table twice"),
    ],
)
def test_a_table_that_is_not_one_of_presses_is_refused(
    presses: pd.DataFrame, change: Callable[[pd.DataFrame], pd.DataFrame], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Design.of(change(presses))


def test_runs_that_must_not_be_mixed_are_refused_by_name(tmp_path: Path) -> None:
    printed = PrintedBlock(block=Block.of(1), printer="ender-3", filament="petg")
    first = write_run(tmp_path / "a", printed, Plan())
    with pytest.raises(InputError, match="same print"):
        opened(first, write_run(tmp_path / "b", printed, Plan()))
    other = PrintedBlock(block=Block.of(2), printer="ender-3", filament="petg")
    wide = PrintedBlock(block=Block.of(2, "released"), printer="ender-3", filament="petg")
    grid = PressGrid(x_mm=(4.0, 8.0), y_mm=(18.0, 23.0))
    for folder, block, plan, message in (
        ("c", other, Plan(grid=grid), "grid"),
        ("d", other, Plan(units="kPa"), "sensor units"),
        ("e", wide, Plan(), "block size"),
    ):
        with pytest.raises(InputError, match=message):
            opened(first, write_run(tmp_path / folder, block, plan))


def test_prints_of_files_that_differ_from_the_block_do_not_mix_with_others(tmp_path: Path) -> None:
    def write(folder: str, model: PrinterModel | None, copy: int, printer: str = "ender-3") -> None:
        block = Block.of(1)
        file = None if model is None else corrected_for(block, model).file
        printed = PrintedBlock(block=block, printer=printer, filament="pla-plus", copy=copy, file=file)
        write_run(tmp_path / folder / printed.name, printed, Plan())

    write("plain", None, 1)
    write("corrected", PRINTER, 1)
    # The file for each printer may be corrected by the model of that printer.
    write("corrected", replace(PRINTER, scale_x=measured(0.99)), 1, "bambu-p1p")
    design = opened(tmp_path / "corrected")
    assert "texture-1_paper_x1_from-t1-corr_ender-3_pla-plus_copy01" in set(design.presses["run"])
    files = [getattr(run.info.printed, "file", None) for run in design.runs]
    assert corrected_for(Block.of(1), PRINTER).file in files
    with pytest.raises(InputError, match=r"printed file = 'that of the block': in .*plain.*, but 'another than that"):
        opened(tmp_path / "corrected", tmp_path / "plain")
    write("remade", replace(PRINTER, scale_x=measured(0.98)), 2)
    with pytest.raises(InputError, match=r"printed file = 't1-corr': of .*remade.* differs from that of .*corrected"):
        opened(tmp_path / "corrected", tmp_path / "remade")
    # The same printer, and another printer, with the other rule for the relief.
    for printer in ("ender-3", "bambu-p1p", "form-3"):
        write(f"free-{printer}", replace(PRINTER, relief_rule="free"), 3, printer)
        with pytest.raises(InputError, match=r"printed file = 't1-free': of .*free.* differs from that of"):
            opened(tmp_path / "corrected", tmp_path / f"free-{printer}")
