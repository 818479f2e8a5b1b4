"""The tolerances of the formats: --tolerance applies to STL and 3MF, --step-tolerance applies to STEP."""

from __future__ import annotations

from pathlib import Path

import pytest

from tacbench_cad import Block, InputError, Request, SampleGrid, Tolerance, check, export
from tacbench_cad.making.printset import plan


def names(**changes: object) -> dict[str, str]:
    (source,) = plan(Request(textures=(4,), parts=("blocks",), formats=("stl", "3mf", "step"), **changes)).sources  # type: ignore[arg-type]
    return source.files


def test_each_tolerance_changes_only_the_names_of_its_own_formats() -> None:
    pytest.importorskip("OCP")
    assert names() == {name: f"texture-4_paper_x1.{name}" for name in ("stl", "3mf", "step")}
    fine = names(sampling=Tolerance(mm=0.005))
    assert fine["step"] == "texture-4_paper_x1.step"
    assert fine["stl"] == "texture-4_paper_x1_tol0.005.stl" and fine["3mf"] == "texture-4_paper_x1_tol0.005.3mf"
    for tolerance in (0.002, 0.0005):
        solid = names(step_tolerance_mm=tolerance)
        assert solid["stl"] == "texture-4_paper_x1.stl"
        assert solid["step"] == f"texture-4_paper_x1_tol{tolerance}.step"
    with pytest.raises(InputError, match="step tolerance"):
        names(step_tolerance_mm=1.5)


@pytest.mark.parametrize("preset", ["paper", "released"])
def test_the_mesh_tolerance_does_not_change_the_solid(preset: str) -> None:
    block = Block.of(2, preset)
    for tolerance in (0.05, 0.002):
        other = Block.of(2, preset, sampling=Tolerance(mm=tolerance))
        assert other.solid_datum_mm == block.solid_datum_mm and other.solid_name == block.solid_name
    assert Block.of(2, step_tolerance_mm=0.002).datum_mm == Block.of(2).datum_mm


@pytest.mark.parametrize(
    ("texture", "tolerance"), [(2, 0.01), *(pytest.param(3, mm, marks=pytest.mark.long) for mm in (0.0005, 0.01))]
)
def test_the_checks_follow_the_tolerance_of_a_step_file(texture: int, tolerance: float, tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    block = Block.of(texture, scale=0.5, step_tolerance_mm=tolerance)
    path = tmp_path / "block.step"
    report = export(block, path)
    assert report.ok and (report.deviation_mm or 1.0) <= tolerance
    assert check(path, block).ok and check(path).ok
    if tolerance < 0.001:
        return
    assert (report.deviation_mm or 0.0) > 0.001
    relief = next(finding for finding in check(path, Block.of(texture, scale=0.5)).checks if finding.name == "relief")
    assert not relief.ok, "the check must fail with a finer tolerance"


def test_names_of_files_are_short_and_unique() -> None:
    odd = [Block.of(1, mm_per_unit=(3.7083101740411615 + i * 1e-9, 4.7746482927568605, 0.3)) for i in range(2)]
    stems = [
        plan(Request(textures=(1,), parts=("blocks",), formats=("stl",), mm_per_unit=block.mm_per_unit)).sources[0]
        for block in odd
    ]
    files = [source.files["stl"] for source in stems]
    assert files[0] != files[1] and all(file.startswith("texture-1_paper_x1_mm3.708x4.775x0.3_") for file in files)
    assert all(len(file) < 60 for file in files)
    plain = Block.of(1, mm_per_unit=(1.2344, 1.5, 0.3), sampling=SampleGrid(nx=20, ny=30))
    assert plain.name == "texture-1_paper_x1_mm1.2344x1.5x0.3_grid20x30"
