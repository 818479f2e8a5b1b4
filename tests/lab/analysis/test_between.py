"""Compare the matrix between textures with a computation on all pixels of all frames at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.studies import PRINTERS, write_run, write_study

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.tables import records
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.lab.analysis.variance.view import VarianceView


def union(collection: Collection, combination: str, level: int, textures: tuple[str, str], ddof: int) -> float:
    """Return the variance of each pixel over both textures' frames, averaged over pixels and positions."""
    variances = []
    for position in np.unique(collection.position):
        mine = (collection.combination == combination) & (collection.level == level)
        mine &= (collection.position == position) & np.isin(collection.texture, textures)
        stack = np.stack([collection.frame(int(i)).astype(np.float64) for i in np.flatnonzero(mine)])
        variances.append(stack.var(axis=0, ddof=ddof).mean())
    return float(np.mean(variances))


@pytest.mark.parametrize("ddof", [0, 1])
def test_each_pair_is_the_variance_over_both_textures(tmp_path: Path, ddof: int) -> None:
    write_study(tmp_path, textures=(1, 2, 4), levels=(1, 2))
    collection = Collection.open([tmp_path])
    result = variance_table(collection, ddof=ddof)
    matrices = {(matrix.combination, matrix.force_level): matrix for matrix in result.matrices}
    assert set(matrices) == {(c, level) for c in collection.combinations for level in (1, 2, "all")}
    for combination in collection.combinations:
        for level in (1, 2):
            matrix = matrices[combination, level]
            for i, first in enumerate(collection.textures):
                for j, second in enumerate(collection.textures):
                    expected = union(collection, combination, level, (first, second), ddof)
                    assert matrix.variance[i, j] == pytest.approx(expected, rel=1e-9)
                    assert matrix.presses[i, j] == (16 if i == j else 32)
        pooled = np.mean([matrices[combination, level].variance for level in (1, 2)], axis=0)
        np.testing.assert_allclose(matrices[combination, "all"].variance, pooled)


def test_the_diagonal_is_the_table_and_each_pair_is_written_once(tmp_path: Path) -> None:
    write_study(tmp_path, textures=(1, 2, 3))
    result = variance_table(Collection.open([tmp_path]))
    rows = records(VarianceView.of(result).tables["between_textures"])
    assert len(rows) == 2 * 2 * (3 + 3)
    for row in rows:
        if row["texture"] == row["other_texture"]:
            cell = result.cell(row["force_level"], f"{row['printer']}_{row['filament']}", row["texture"])
            assert cell is not None and cell.variance == row["variance"] and cell.presses == row["presses"]


def test_a_texture_without_prints_of_a_printer_has_no_entry(tmp_path: Path) -> None:
    from helpers.studies import Plan

    from tacbench_cad.lab.study.spec import PrintedBlock
    from tacbench_cad.spec.block import Block

    write_study(tmp_path, prints=PRINTERS[:1])
    printer, filament = PRINTERS[1]
    write_run(tmp_path / "one", PrintedBlock(block=Block.of(2), printer=printer, filament=filament), Plan())
    result = variance_table(Collection.open([tmp_path]))
    incomplete = next(matrix for matrix in result.matrices if matrix.combination == f"{printer}_{filament}")
    assert np.isnan(incomplete.variance).tolist() == [[True, True], [True, False]]
    assert incomplete.presses.tolist() == [[0, 0], [0, 8]]
    assert any("texture-1 is missing" in line for line in VarianceView.of(result).warnings)
