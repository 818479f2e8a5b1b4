"""Test the virtual load cell's stream and the force that it measures."""

from __future__ import annotations

from typing import Any

import pytest

from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.loadcell import (
    FULL_SCALE,
    BlockUnderDome,
    CellSettings,
    EmulatedLoadCell,
)
from tacbench_cad.util.errors import InputError

QUIET = CellSettings(noise_n=0.0, drift_n_per_min=0.0, offset_counts=1000.0, counts_per_n=10_000.0, rate_hz=100.0)


def counts(data: bytes) -> list[int]:
    return [int(word) for word in data.split()]


def test_force_becomes_counts_and_changes_linearly_within_a_batch() -> None:
    cell = EmulatedLoadCell(QUIET)
    cell.read(0.0, lambda: 0.0)
    assert counts(cell.read(0.0401, lambda: 2.0)) == [6000, 11000, 16000, 21000]
    assert counts(cell.read(0.0501, lambda: 2.0)) == [21000]


def test_output_in_newtons_noise_and_drift() -> None:
    cell = EmulatedLoadCell(CellSettings(newtons=True, noise_n=0.01, drift_n_per_min=1.0), seed=3)
    values = [float(word) for word in cell.read(1.0, lambda: 0.5).split()][-40:]
    cell = EmulatedLoadCell(CellSettings(newtons=True, noise_n=0.01, drift_n_per_min=1.0), seed=3)
    cell.skip_to(120.0)
    cell.read(120.0, lambda: 0.5)
    later = [float(word) for word in cell.read(120.9, lambda: 0.5).split()]
    mean = sum(later) / len(later)
    assert 2.4 < mean < 2.6
    assert 0.003 < (sum((value - mean) ** 2 for value in later) / len(later)) ** 0.5 < 0.03
    assert len(set(values)) > 10


def test_faults_of_the_gauge() -> None:
    cell = EmulatedLoadCell(QUIET)
    cell.inject(Fault(kind="saturated", seconds=0.05), 0.0)
    assert set(counts(cell.read(0.045, lambda: 1.0))) == {FULL_SCALE}
    cell.read(0.1, lambda: 1.0)
    cell.inject(Fault(kind="stuck", seconds=0.1), 0.1)
    assert set(counts(cell.read(0.19, lambda: 3.0))) == {11000}
    cell.read(0.3, lambda: 3.0)
    cell.inject(Fault(kind="noise", n=1.0), 0.3)
    assert len(set(counts(cell.read(0.5, lambda: 3.0)))) > 10
    cell.inject(Fault(kind="drop", where="gauge", chance=1.0), 0.5)
    assert cell.read(0.6, lambda: 3.0) == b""
    assert EmulatedLoadCell(QUIET).read(0.0, lambda: 1e9) == b"%d\n" % FULL_SCALE


def test_block_as_stimulus() -> None:
    from tacbench_cad.lab.simulate.contact import contact_for
    from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, WorkFrame
    from tacbench_cad.spec.block import Block

    printed = PrintedBlock(block=Block.of("1"), printer="bambu-p1p", filament="pla-minus")
    frame = WorkFrame(origin_mm=(80.0, 80.0, -60.0))
    stimulus = BlockUnderDome(printed=printed, holder=HolderRim(rim_mm=1.18, gap_mm=0.2), frame=frame)
    contact = contact_for(printed, HolderRim())
    z = contact.z_for_force(6.0, 20.0, 1.913)
    assert stimulus.force_n((86.0, 100.0, -60.0 + z)) == pytest.approx(1.913, abs=0.01)
    assert stimulus.force_n((86.0, 100.0, -30.0)) == 0.0


@pytest.mark.parametrize(
    "wrong", [{"rate_hz": 0.0}, {"counts_per_n": 0.0}, {"noise_n": float("nan")}, {"rate_hz": "fast"}]
)
def test_invalid_cells_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        CellSettings(**wrong)
