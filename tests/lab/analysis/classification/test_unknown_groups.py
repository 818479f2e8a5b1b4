"""Test classifications of imported samples, of which some facts are unknown."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tacbench_cad import lab
from tacbench_cad.lab.analysis.classification.hold_out import unit_name, units_of
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.errors import InputError

#: Label, print, position, repeat and session of each image.
DESIGN = pd.DataFrame(
    [
        (label, copy, place, repeat, "monday" if copy == 1 else "friday")
        for label in "ab"
        for copy in (1, 2, 3)
        for place in "xyz"
        for repeat in (1, 2)
    ],
    columns=["label", "print", "position", "repeat", "session"],
)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., pd.DataFrame]:
    """Return a function that reads 36 images with a table of the given columns, without importing them."""

    def make(*columns: str) -> pd.DataFrame:
        folder = tmp_path_factory.mktemp("own")
        for number in range(len(DESIGN)):
            pixels = np.random.default_rng(number).integers(0, 256, (16, 24), dtype=np.uint8)
            Image.fromarray(pixels).save(folder / f"{number}.png")
        names = pd.Series(range(len(DESIGN)), name="image").astype(str) + ".png"
        pd.concat([names, DESIGN[list(columns)]], axis=1).to_csv(folder / "labels.csv", index=False)
        return lab.read(folder)

    return make


def test_splits_hold_out_known_properties(study: Callable[..., pd.DataFrame]) -> None:
    splits, notes = lab.make_splits(study("label"))
    assert [split.hold_out for split in splits] == ["press"] and len(splits[0].presses) == 36
    assert any("position is left out: the position is unknown" in note for note in notes)
    splits, _ = lab.make_splits(study("label", "print", "position"))
    assert [split.hold_out for split in splits] == ["press", "position", "copy"]
    with pytest.raises(InputError, match="needs the label"):
        lab.make_splits(study("print"))


@pytest.mark.parametrize(
    ("columns", "level", "name", "count"),
    [
        (("label",), "press", "samples", 36),
        (("label", "print"), "press", "prints", 6),
        (("label", "session"), "session", "sessions", 2),
    ],
)
def test_intervals_count_known_groups_and_otherwise_samples(
    study: Callable[..., pd.DataFrame], columns: tuple[str, ...], level: str, name: str, count: int
) -> None:
    design = Design.of(study(*columns))
    assert (unit_name(level, design.unknown_groups), len(np.unique(units_of(design, level)))) == (name, count)
    assert unit_name("copy", ["prints"]) == "recordings"  # only the sessions are known


def test_sessions_are_held_out_if_known(study: Callable[..., pd.DataFrame]) -> None:
    """Every label was recorded in each session: 12 images on monday and 24 on friday."""
    presses = study("label", "session")
    splits, notes = lab.make_splits(presses)
    assert [split.hold_out for split in splits] == ["press", "session"] and not any("session" in note for note in notes)
    folds = lab.HoldOut("session").divided(presses).folds
    assert [(fold.group, len(fold.test)) for fold in folds] == [("session friday", 24), ("session monday", 12)]
    for fold in folds:
        assert not set(presses["session"].iloc[fold.train]) & set(presses["session"].iloc[fold.test])
    with pytest.raises(InputError, match="there is only one session"):
        next(lab.HoldOut("session").split(presses[presses["session"] == "friday"]))
    with pytest.raises(InputError, match="the session is unknown; import with a column for it"):
        next(lab.HoldOut("session").split(study("label")))
