"""Test hold-out levels: held-out data are never used for training, and impossible levels are reported."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.dummy import DummyClassifier
from sklearn.model_selection import cross_val_score

from tacbench_cad.lab.analysis.classification.hold_out import HOLD_OUT_LEVELS, Fold, HoldOut, folds_of
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.errors import InputError

#: The columns whose values a level holds out completely.
GROUPS = {
    "press": ["run", "press"],
    "position": ["position"],
    "force": ["force_level"],
    "copy": ["run"],
    "printer-filament": ["printer", "filament"],
}


def table(
    prints: list[tuple[str, str, int]], levels: tuple[int, ...] = (1, 2), positions: int = 4, repeats: int = 2
) -> pd.DataFrame:
    """Return presses of (texture, printer, copy) prints at all levels and positions."""
    places = list(itertools.product(levels, range(1, positions + 1), range(1, repeats + 1)))
    rows = [
        (f"{texture}{printer}{copy}", number, "frame.png", texture, printer, "pla", copy, *place)
        for texture, printer, copy in prints
        for number, place in enumerate(places, start=1)
    ]
    columns = ["run", "press", "frame", "texture", "printer", "filament", "copy", "force_level", "position", "repeat"]
    return pd.DataFrame(rows, columns=columns)


def prints(textures: str = "abc", printers: str = "XY", copies: int = 2) -> list[tuple[str, str, int]]:
    return list(itertools.product(textures, printers, range(1, copies + 1)))


def groups(presses: pd.DataFrame, level: str) -> pd.Series:
    return presses[GROUPS[level]].astype(str).agg(" ".join, axis=1)


def require_leak_free(presses: pd.DataFrame, fold: Fold) -> None:
    """Check that no group is on both sides, and that every tested texture was trained."""
    group, (train, test) = groups(presses, fold.hold_out), (presses.iloc[fold.train], presses.iloc[fold.test])
    assert len(test) and not set(group.iloc[fold.train]) & set(group.iloc[fold.test])
    assert set(test["texture"]) <= set(train["texture"])
    if fold.hold_out == "copy":
        kinds = [set(zip(side["texture"], side["printer"], strict=True)) for side in (train, test)]
        assert kinds[1] <= kinds[0]


@pytest.mark.parametrize("level", HOLD_OUT_LEVELS)
def test_every_level_tests_each_press_once_and_never_divides_a_group(level: str) -> None:
    presses = table(prints())
    splitter = HoldOut(level, seed=3)
    folds = splitter.divided(presses).folds
    assert sorted(np.concatenate([fold.test for fold in folds])) == list(range(len(presses)))
    for fold, (train, test) in zip(folds, splitter.split(presses), strict=True):
        assert np.array_equal(fold.train, train) and np.array_equal(fold.test, test)
        assert len(train) + len(test) == len(presses)
        require_leak_free(presses, fold)
    assert splitter.get_n_splits(presses) == len(folds)
    names = {"copy": ["copy 1", "copy 2"], "force": ["force level 1", "force level 2"]}
    assert [fold.group for fold in folds] == names.get(level, [fold.group for fold in folds])


def test_scikit_learn_takes_it_as_a_splitter() -> None:
    presses = table(prints())
    cv = HoldOut("copy")
    scores = cross_val_score(DummyClassifier(strategy="constant", constant="a"), presses, presses["texture"], cv=cv)
    assert scores.tolist() == pytest.approx([1 / 3, 1 / 3])
    assert repr(cv) == "HoldOut('copy', folds=5, seed=0, copies=None)" and clone(cv, safe=False) is not cv
    with pytest.raises(InputError, match="divides presses, but the table has the frames of their series"):
        next(cv.split(presses.assign(step=1)))


def test_folds_have_equal_numbers_of_presses_of_each_texture() -> None:
    presses = table(prints())
    for _, test in HoldOut("press").split(presses):
        counts = presses["texture"].iloc[test].value_counts()
        assert len(counts) == 3 and counts.max() - counts.min() <= 1


def test_the_seed_affects_only_presses_and_positions() -> None:
    presses = table(prints(), positions=9)
    for level in HOLD_OUT_LEVELS:
        first, again, other = ([t.tolist() for _, t in HoldOut(level, seed=n).split(presses)] for n in (1, 1, 2))
        assert first == again and (first != other) == (level in ("press", "position"))


@pytest.mark.parametrize(
    ("presses", "level", "reason"),
    [
        (table(prints(copies=1)), "copy", "no texture has two copies"),
        (table(prints(printers="X")), "printer-filament", "one printer-filament combination, X_pla"),
        (table(prints(), levels=(2,)), "force", "one force level"),
        (table(prints(), positions=1), "position", "one position"),
        (table(prints()).drop(columns="position"), "position", "the position is unknown; import with a column for it"),
    ],
)
def test_a_level_without_enough_data_is_left_out_with_a_reason(presses: pd.DataFrame, level: str, reason: str) -> None:
    result = folds_of(Design.of(presses), seed=0)
    assert set(result.levels) == set(HOLD_OUT_LEVELS) - {level}
    (note,) = result.notes
    assert level in note and reason in note
    with pytest.raises(InputError, match=reason):
        next(HoldOut(level).split(presses))


def test_a_single_copy_always_trains_and_is_not_tested_for_its_copy() -> None:
    presses = table([*prints("abc", "X", 3), *prints("abc", "Y", 1)])
    folds = HoldOut("copy").divided(presses).folds
    assert [fold.group for fold in folds] == ["copy 1", "copy 2", "copy 3"]
    for fold in folds:
        assert set(presses["printer"].iloc[fold.test]) == {"X"} and "Y" in set(presses["printer"].iloc[fold.train])


def test_a_texture_of_only_the_held_out_printer_is_reported_and_not_tested() -> None:
    presses = table([*prints("ab", "XY"), *prints("c", "Y")])
    result = HoldOut("printer-filament").divided(presses)
    assert [set(presses["texture"].iloc[fold.test]) for fold in result.folds] == [{"a", "b"}] * 2
    assert any("c is not tested" in note and "Y" in note for note in result.notes)


def test_one_texture_one_fold_and_an_unknown_level_are_refused() -> None:
    with pytest.raises(InputError, match="must be at least two for a classification"):
        next(HoldOut("copy").split(table(prints("a"))))
    with pytest.raises(InputError, match="at least 2"):
        next(HoldOut("copy", folds=1).split(table(prints())))
    with pytest.raises(InputError, match='did you mean "copy"'):
        next(HoldOut("copi").split(table(prints())))


def test_fewer_training_copies_do_not_change_the_test_set() -> None:
    presses = table(prints(copies=4))
    for level in ("copy", "printer-filament"):
        whole, less = (HoldOut(level, seed=5, copies=copies).split(presses) for copies in (None, 2))
        for (train, test), (fewer, same) in zip(whole, less, strict=True):
            assert np.array_equal(test, same) and set(fewer) < set(train)
            assert set(presses.iloc[fewer].groupby(["texture", "printer"])["copy"].nunique()) == {2}
    with pytest.raises(InputError, match="there are fewer than 4 prints of some texture in training"):
        next(HoldOut("copy", copies=4).split(presses))


@settings(max_examples=40, deadline=None)
@given(
    there=st.lists(
        st.tuples(st.sampled_from("abc"), st.sampled_from("XYZ"), st.integers(1, 3)),
        min_size=2,
        max_size=14,
        unique=True,
    ),
    levels=st.sampled_from([(1,), (1, 3)]),
    positions=st.integers(1, 4),
    seed=st.integers(0, 9),
)
def test_any_design_has_leak_free_folds_or_a_reason(
    there: list[tuple[str, str, int]], levels: tuple[int, ...], positions: int, seed: int
) -> None:
    presses = table(there, levels, positions)
    if presses["texture"].nunique() < 2:
        return
    for level in HOLD_OUT_LEVELS:
        result = HoldOut(level, seed=seed).divided(presses)
        assert result.folds or any(f"hold-out level {level} is left out" in note for note in result.notes)
        for fold in result.folds:
            require_leak_free(presses, fold)
