"""PrusaSlicer reads a plate unchanged: every block has the position and the texture that the layout states."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from helpers.outsiders import Run

from tacbench_cad.slicing.compare import compare
from tacbench_cad.slicing.gcode import read_gcode
from tacbench_cad.slicing.plates import arrange_plates
from tacbench_cad.slicing.printers import printers
from tacbench_cad.slicing.surface import Frame
from tacbench_cad.slicing.writing import write_plates
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.real


def test_every_block_is_at_its_position_in_the_layout(prusa_slicer: Run, tmp_path: Path) -> None:
    pytest.importorskip("lib3mf")
    plates = arrange_plates([Block.of(1, scale=0.5), Block.of(2, scale=0.5)], 2, printers()["form-3"])
    (files,) = write_plates(plates, "grey-v4", tmp_path)
    target = tmp_path / "plate.gcode"
    prusa_slicer(
        [
            *("--export-gcode", "--dont-arrange", "--bed-shape", "0x0,145x0,145x145,0x145", "--layer-height", "0.2"),
            *("--first-layer-height", "0.2", "--nozzle-diameter", "0.4", "--filament-diameter", "1.75"),
            *("--output", target, files.model),
        ]
    )
    sliced = read_gcode(target)
    with files.layout.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 4
    for row in rows:
        block = Block.of(row["texture"], scale=float(row["scale"]))
        frame = Frame(x_mm=float(row["x_mm"]), y_mm=float(row["y_mm"]))
        comparison = compare(sliced, block, frame, pitch_mm=0.1)
        assert comparison.rms_mm is not None and comparison.misplaced_rms_mm is not None
        assert comparison.rms_mm < 0.075 < comparison.misplaced_rms_mm
    with pytest.raises(InputError, match="--frame"):
        compare(sliced, Block.of(1, scale=0.5))
