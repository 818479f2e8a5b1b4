"""Test analyses of imported runs, in which some information is unknown."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from tacbench_cad import lab
from tacbench_cad.lab.analysis.report.facts import unknown_names
from tacbench_cad.lab.analysis.report.page import write_files
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.cells import name_of
from tacbench_cad.util.errors import InputError

#: Label, print, position and repeat of each image.
DESIGN = [(label, copy, place, repeat) for label in "ab" for copy in (1, 2, 3) for place in "xyz" for repeat in (1, 2)]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., pd.DataFrame]:
    """Return a function that imports 36 images with a table of the given columns."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "frames").mkdir()
    for number in range(len(DESIGN)):
        image = np.random.default_rng(number).integers(0, 256, (16, 24), dtype=np.uint8)
        cv2.imwrite(str(folder / "frames" / f"{number}.png"), image)

    def make(*columns: str) -> pd.DataFrame:
        out = folder / ("-".join(columns) or "nothing")
        if not out.exists():
            names = ("label", "print", "position", "repeat")
            rows = [",".join(["image", *columns])]
            for number, values in enumerate(DESIGN):
                known = dict(zip(names, map(str, values), strict=True))
                rows.append(",".join([f"{number}.png", *(known[name] for name in columns)]))
            (folder / "labels.csv").write_text("\n".join(rows))
            assert lab.import_samples([folder / "frames", folder / "labels.csv"], out, lab.ImportOptions()).ok
        return lab.read(out)

    return make


def test_variance_equals_that_of_the_images(study: Any) -> None:
    presses = study("label", "print", "position")
    result = lab.variance(presses)
    for label, of_label in presses.groupby("texture"):
        images = (lab.frames(of_position).astype(float) for _, of_position in of_label.groupby("position"))
        expected = np.mean([of_position.var(axis=0).mean() for of_position in images])
        names = ["printer", "filament", "texture", "force_level"]
        (cell,) = result.table[(result.table[names] == ["unknown", "unknown", label, "all"]).all(axis=1)].itertuples()
        assert abs(cell.variance - expected) < 1e-9 * expected
        assert (cell.prints, cell.presses) == (3, 18)
    assert sorted(set(result.design.presses["repeat"])) == [1, 2]
    assert name_of("unknown_unknown") == "unknown printer" and name_of("unknown_petg") == "petg"
    assert not any("paper" in text for text in result.warnings)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (("label",), r"needs the position of every sample.*--columns position=COLUMN"),
        (("label", "print"), "needs the position"),
        (("label", "position"), "needs the print or repeat of every sample"),
    ],
)
def test_variance_reports_missing_information(columns: tuple[str, ...], message: str, study: Any) -> None:
    with pytest.raises(InputError, match=message):
        lab.variance(study(*columns))


def test_a_grade_needs_the_force_and_textures_of_the_paper(study: Any) -> None:
    with pytest.raises(InputError, match="needs the force"):
        lab.grade(study("label", "print", "position"))


def test_a_report_contains_only_known_information(study: Any, tmp_path: Path) -> None:
    def methods(presses: pd.DataFrame) -> str:
        page = write_files(Results(design=Design.of(presses)), tmp_path / "files")
        return " ".join(re.findall(r'id="design">.*?<p>(.*?)</p>', page, re.DOTALL)[0].split())

    presses = study("label")
    text = methods(presses)
    assert "36 samples were imported from images with a table, with 2 labels" in text
    unknown = "session, print, printer, filament, position, force, repeat, formula, size"
    assert f"Not recorded, and therefore unknown: {unknown}." in text
    assert unknown_names(Design.of(presses)) == unknown.split(", ")
    for word in ("preset", " N", " mm", "rim", "stage", "gauge"):
        assert word not in text.replace("Not recorded", "")
    assert "The samples show 3 prints of 2 textures." in methods(study("label", "print"))
