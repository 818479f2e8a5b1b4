"""PrusaSlicer reads a plate unchanged: every block has the position and the texture that the layout states."""

from __future__ import annotations

import csv
import re
import shlex
from pathlib import Path

import pytest
from helpers.checkout import ROOT
from helpers.outsiders import Run

from tacbench_cad.extensions.slicing.comparison import compare, slice_check
from tacbench_cad.extensions.slicing.gcode import read_gcode
from tacbench_cad.extensions.slicing.plate_files import write_plates
from tacbench_cad.extensions.slicing.plates import arrange_plates
from tacbench_cad.extensions.slicing.printed_surface import BedPlace
from tacbench_cad.extensions.slicing.printers import printers
from tacbench_cad.making.writing import export
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.real


def sliced_rows(run: Run, folder: Path, *options: str) -> tuple[Path, list[dict[str, str]]]:
    """Slice a plate whose blocks lie far apart, near the edges of a bed of 256 mm; return the G-code and the layout."""
    pytest.importorskip("lib3mf")
    plates = arrange_plates([Block.of(1, scale=0.5), Block.of(2, scale=0.5)], 2, printers()["bambu-p1p"], 90.0)
    (files,) = write_plates(plates, "pla-plus", folder)
    target = folder / "plate.gcode"
    run(["--export-gcode", *options, *options_for("plate.gcode"), "--output", target, files.model])
    with files.layout.open(newline="") as stream:
        return target, list(csv.DictReader(stream))


def options_for(target: str) -> list[str]:
    """Return the options of the manual's slicing command for a file that say how it is sliced."""
    page = (ROOT / "docs" / "plates.md").read_text(encoding="utf-8").replace("\\\n", " ")
    (line,) = re.findall(rf"^prusa-slicer --export-gcode (.*) -o {re.escape(target)} ", page, re.MULTILINE)
    return [word for word in shlex.split(line) if word != "--dont-arrange"]


def test_the_manuals_option_keeps_the_blocks_of_a_plate_in_their_places(prusa_slicer: Run, tmp_path: Path) -> None:
    assert "--dont-arrange" in (ROOT / "docs" / "plates.md").read_text(encoding="utf-8")
    target, rows = sliced_rows(prusa_slicer, tmp_path, "--dont-arrange")
    assert max(float(row["x_mm"]) for row in rows) > 200.0, "beyond the bed of PrusaSlicer's default printer"
    sliced = read_gcode(target)
    for row in rows:
        frame = BedPlace(x_mm=float(row["x_mm"]), y_mm=float(row["y_mm"]))
        comparison = compare(sliced, Block.of(row["texture"], scale=0.5), frame, pitch_mm=0.1)
        assert comparison.rms_mm is not None and comparison.misplaced_rms_mm is not None
        assert comparison.rms_mm < 0.075 < comparison.misplaced_rms_mm


def test_without_it_the_blocks_are_moved_and_the_check_says_so(prusa_slicer: Run, tmp_path: Path) -> None:
    target, rows = sliced_rows(prusa_slicer, tmp_path)
    for row in rows:
        block = Block.of(row["texture"], scale=0.5)
        frame = BedPlace(x_mm=float(row["x_mm"]), y_mm=float(row["y_mm"]))
        with pytest.raises(InputError, match=r"without moving its blocks .*--dont-arrange"):
            slice_check(target, block, frame)


@pytest.mark.parametrize(("option", "corner"), [("--dont-arrange", (0.0, 0.0)), ("", (88.35, 85.0))])
def test_the_manuals_line_for_one_block_gives_no_warning(
    prusa_slicer: Run, tmp_path: Path, option: str, corner: tuple[float, float]
) -> None:
    """An STL file has its corner at the origin, and PrusaSlicer's own bed has 200 x 200 mm."""
    model, target = tmp_path / "texture-2_paper_x1.stl", tmp_path / "block.gcode"
    export(Block.of(2), model)
    prusa_slicer(["--export-gcode", *([option] if option else []), *options_for("block.gcode"), "-o", target, model])
    checked = slice_check(target, Block.of(2))
    assert checked.warnings == ()
    assert (checked.frame.x_mm, checked.frame.y_mm) == pytest.approx(corner, abs=0.05)
