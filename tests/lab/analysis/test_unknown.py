"""Test analyses of imported runs, in which some information is unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tacbench_cad.lab import Collection, ImportOptions, import_samples, make_splits, variance_table
from tacbench_cad.lab.analysis.classification.splits import PressTable, folds_of
from tacbench_cad.lab.analysis.report.facts import open_points, unknown_in_words
from tacbench_cad.lab.analysis.report.report_html import macro
from tacbench_cad.lab.analysis.variance.cells import name_of
from tacbench_cad.lab.analysis.variance.grade import grade
from tacbench_cad.lab.analysis.variance.notes import variance_warnings
from tacbench_cad.util.errors import InputError

#: Label, print, position and repeat of each image.
DESIGN = [(label, copy, place, repeat) for label in "ab" for copy in (1, 2, 3) for place in "xyz" for repeat in (1, 2)]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Collection]:
    """Return a function that imports 36 images with a table of the given columns."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "frames").mkdir()
    for number in range(len(DESIGN)):
        image = np.random.default_rng(number).integers(0, 256, (16, 24), dtype=np.uint8)
        cv2.imwrite(str(folder / "frames" / f"{number}.png"), image)

    def make(*columns: str) -> Collection:
        out = folder / ("-".join(columns) or "nothing")
        if not out.exists():
            names = ("label", "print", "position", "repeat")
            rows = [",".join(["image", *columns])]
            for number, values in enumerate(DESIGN):
                known = dict(zip(names, map(str, values), strict=True))
                rows.append(",".join([f"{number}.png", *(known[name] for name in columns)]))
            (folder / "labels.csv").write_text("\n".join(rows))
            assert import_samples([folder / "frames", folder / "labels.csv"], out, ImportOptions()).ok
        return Collection.open([out])

    return make


def test_variance_equals_that_of_the_images(study: Any) -> None:
    collection = study("label", "print", "position")
    result = variance_table(collection)
    for label in "ab":
        images = np.array([collection.frame(i) for i in np.flatnonzero(collection.texture == label)], dtype=float)
        position = collection.position[collection.texture == label]
        expected = np.mean([images[position == place].var(axis=0).mean() for place in (1, 2, 3)])
        cell = result.cell("all", "unknown_unknown", label)
        assert cell is not None and abs(cell.variance - expected) < 1e-9 * expected
        assert (cell.prints, cell.presses) == (3, 18)
    assert sorted(set(collection.repeat.tolist())) == [1, 2]
    assert name_of("unknown_unknown") == "unknown printer" and name_of("unknown_petg") == "petg"
    assert not any("paper" in text for text in variance_warnings(collection, result.cells, ()))


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
        variance_table(study(*columns))


def test_splits_hold_out_known_properties(study: Any) -> None:
    splits, notes = make_splits(study("label"))
    assert [split.hold_out for split in splits] == ["press"] and len(splits[0].presses) == 36
    assert any("position is left out: the position is unknown" in note for note in notes)
    splits, _ = make_splits(study("label", "print", "position"))
    assert [split.hold_out for split in splits] == ["press", "position", "copy"]
    with pytest.raises(InputError, match="needs the label"):
        make_splits(study("print"))


def test_intervals_count_prints_if_known_and_samples_otherwise(study: Any) -> None:
    for columns, name, count in ((("label",), "samples", 36), (("label", "print"), "prints", 6)):
        units, unit = PressTable.of(study(*columns)).units("press")
        assert (units, len(np.unique(unit))) == (name, count)
    presses = replace(
        PressTable.of(study("label", "print")), unknown=frozenset({"print"})
    )  # only the recordings are known
    assert presses.units("copy")[0] == "recordings"


def test_sessions_are_held_out_if_known(study: Any, tmp_path: Path) -> None:
    """Every label was recorded in each session: 12 images on monday and 24 on friday."""
    source = study("label").runs[0].folder.parent.parent / "frames"
    days = {1: "monday", 2: "friday", 3: "friday"}
    rows = ["image,label,session"]
    rows += [f"{number}.png,{label},{days[copy]}" for number, (label, copy, *_) in enumerate(DESIGN)]
    (tmp_path / "labels.csv").write_text("\n".join(rows))
    assert import_samples([source, tmp_path / "labels.csv"], tmp_path / "runs", ImportOptions()).ok
    collection = Collection.open([tmp_path / "runs"])
    splits, notes = make_splits(collection)
    assert [split.hold_out for split in splits] == ["press", "session"]
    assert not any("session" in note for note in notes)
    presses = PressTable.of(collection)
    folds = folds_of(presses, ["session"], seed=0).folds
    assert [(fold.group, len(fold.test)) for fold in folds] == [("session friday", 24), ("session monday", 12)]
    for fold in folds:
        assert not set(presses.session[fold.train]) & set(presses.session[fold.test])
    assert presses.units("session")[0] == "sessions" and len(set(presses.units("session")[1])) == 2
    friday = collection.chosen(collection.session == "friday")
    with pytest.raises(InputError, match="there is only one session"):
        folds_of(PressTable.of(friday), ["session"], seed=0)
    with pytest.raises(InputError, match="the session is unknown; import with a column for it"):
        folds_of(PressTable.of(study("label")), ["session"], seed=0)


def test_a_grade_needs_the_force(study: Any) -> None:
    collection = study("label", "print", "position")
    with pytest.raises(InputError, match="needs the force"):
        grade(variance_table(collection).cells, collection)


def test_a_report_contains_only_known_information(study: Any) -> None:
    collection = study("label")
    text = str(macro("methods.j2", "design")(collection))
    assert "36 samples were imported from images with a table, with 2 labels" in text
    assert "print, printer, filament, position, force, repeat, formula, size" in unknown_in_words(collection)
    for word in ("preset", " N", " mm", "rim", "stage", "gauge"):
        assert word not in text
    with_prints = str(macro("methods.j2", "design")(study("label", "print")))
    assert "The samples show 3 prints of 2 textures." in " ".join(with_prints.split())
    assert open_points(collection, colour=False, ddof=0).frame.empty
