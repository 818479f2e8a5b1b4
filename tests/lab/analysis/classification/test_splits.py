"""Test hold-out levels: held-out data are never used for training, and impossible levels are reported."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacbench_cad.lab.analysis.classification.splits import (
    HOLD_OUT_LEVELS,
    UNITS,
    Fold,
    Folds,
    PressTable,
    folds_of,
    with_copies,
)
from tacbench_cad.util.errors import InputError


def table(
    prints: list[tuple[str, str, int]], levels: tuple[int, ...] = (1, 2), positions: int = 4, repeats: int = 2
) -> PressTable:
    """Return presses of (texture, combination, copy) prints at all levels and positions."""
    rows = [
        (run, *printed, level, position)
        for run, printed in enumerate(prints)
        for level, position, _ in itertools.product(levels, range(1, positions + 1), range(repeats))
    ]
    run, texture, combination, copy, level, position = zip(*rows, strict=True)
    return PressTable(
        run=np.array(run),
        texture=np.array(texture),
        combination=np.array(combination),
        copy=np.array(copy),
        level=np.array(level),
        position=np.array(position),
        session=np.full(len(run), "unknown"),
        unknown=frozenset({"session"}),
    )


def prints(textures: str = "abc", combinations: str = "XY", copies: int = 2) -> list[tuple[str, str, int]]:
    return list(itertools.product(textures, combinations, range(1, copies + 1)))


def of(result: Folds, level: str) -> list[Fold]:
    """Return the folds of a hold-out level."""
    return [fold for fold in result.folds if fold.hold_out == level]


def group(presses: PressTable, level: str) -> np.ndarray:
    """Return the group of each press; a level must not divide groups."""
    number = np.arange(len(presses.run))
    return {
        "press": number,
        "position": presses.position,
        "force": presses.level,
        "copy": presses.run,
        "printer-filament": presses.combination,
    }[level]


def test_every_level_tests_each_press_once_and_never_divides_a_group() -> None:
    presses = table(prints())
    result = folds_of(presses, seed=3)
    assert result.levels == HOLD_OUT_LEVELS and result.notes == ()
    for level in HOLD_OUT_LEVELS:
        tested = np.concatenate([fold.test for fold in of(result, level)])
        assert sorted(tested.tolist()) == list(range(len(presses.run)))
        kept = group(presses, level)
        for fold in of(result, level):
            assert len(fold.train) + len(fold.test) == len(presses.run)
            assert not set(kept[fold.train].tolist()) & set(kept[fold.test].tolist())
    assert [fold.group for fold in of(result, "copy")] == ["copy 1", "copy 2"]
    assert [fold.group for fold in of(result, "force")] == ["force level 1", "force level 2"]


def test_folds_have_equal_numbers_of_presses_of_each_texture() -> None:
    presses = table(prints())
    for fold in folds_of(presses, ["press"], seed=0).folds:
        _, counts = np.unique(presses.texture[fold.test], return_counts=True)
        assert len(counts) == 3 and counts.max() - counts.min() <= 1


def test_the_seed_affects_only_presses_and_positions() -> None:
    presses = table(prints(), positions=9)

    def tests(seed: int, level: str) -> list[list[int]]:
        return [fold.test.tolist() for fold in folds_of(presses, [level], seed=seed).folds]

    for level in HOLD_OUT_LEVELS:
        assert tests(1, level) == tests(1, level)
        assert (tests(1, level) != tests(2, level)) == (level in ("press", "position"))


@pytest.mark.parametrize(
    ("presses", "level", "reason"),
    [
        (table(prints(copies=1)), "copy", "no texture has two copies"),
        (table(prints(combinations="X")), "printer-filament", "one printer-filament combination, X"),
        (table(prints(), levels=(2,)), "force", "one force level"),
        (table(prints(), positions=1), "position", "one position"),
    ],
)
def test_a_level_without_enough_data_is_left_out_with_a_reason(presses: PressTable, level: str, reason: str) -> None:
    result = folds_of(presses, seed=0)
    assert level not in result.levels and set(result.levels) == set(HOLD_OUT_LEVELS) - {level}
    (note,) = result.notes
    assert level in note and reason in note
    with pytest.raises(InputError, match=reason):
        folds_of(presses, [level], seed=0)


def test_a_single_copy_always_trains_and_is_not_tested_for_its_copy() -> None:
    presses = table([*prints("abc", "X", 3), *prints("abc", "Y", 1)])
    folds = folds_of(presses, ["copy"], seed=0).folds
    assert [fold.group for fold in folds] == ["copy 1", "copy 2", "copy 3"]
    for fold in folds:
        assert set(presses.combination[fold.test]) == {"X"}
        assert "Y" in presses.combination[fold.train]


def test_a_texture_of_only_the_held_out_printer_is_reported_and_not_tested() -> None:
    presses = table([*prints("ab", "XY"), *prints("c", "Y")])
    result = folds_of(presses, ["printer-filament"], seed=0)
    by_name = {fold.group: fold for fold in result.folds}
    assert set(presses.texture[by_name["Y"].test]) == {"a", "b"}
    assert set(presses.texture[by_name["X"].test]) == {"a", "b"}
    assert any("c is not tested" in note and "Y" in note for note in result.notes)


def test_one_texture_one_fold_and_an_unknown_level_are_refused() -> None:
    with pytest.raises(InputError, match="must be at least two for a classification"):
        folds_of(table(prints("a")), seed=0)
    with pytest.raises(InputError, match="at least 2"):
        folds_of(table(prints()), seed=0, folds=1)
    with pytest.raises(InputError, match='did you mean "copy"'):
        folds_of(table(prints()), ["copi"], seed=0)


def test_the_units_of_an_interval_are_what_the_level_holds_out_or_repeats() -> None:
    presses = table(prints())
    sizes = {level: len(np.unique(getattr(presses, UNITS[level][1]))) for level in HOLD_OUT_LEVELS}
    assert sizes == {"press": 12, "position": 4, "force": 2, "copy": 12, "printer-filament": 2}


def test_fewer_training_copies_do_not_change_the_test_set() -> None:
    presses = table(prints(copies=4))
    for fold in folds_of(presses, ["copy", "printer-filament"], seed=0).folds:
        less = with_copies(presses, fold, 2, seed=5)
        assert less is not None and np.array_equal(less.test, fold.test)
        assert set(less.train.tolist()) < set(fold.train.tolist())
        pairs = zip(presses.texture[less.train], presses.combination[less.train], strict=True)
        chosen = {pair: set() for pair in pairs}  # type: ignore[var-annotated]
        for i in less.train:
            chosen[presses.texture[i], presses.combination[i]].add(int(presses.copy[i]))
        assert all(len(copies) == 2 for copies in chosen.values())
    assert with_copies(presses, folds_of(presses, ["copy"], seed=0).folds[0], 4, seed=5) is None


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
    if len(set(presses.texture)) < 2:
        with pytest.raises(InputError):
            folds_of(presses, seed=seed)
        return
    result = folds_of(presses, seed=seed)
    for level in HOLD_OUT_LEVELS:
        assert of(result, level) or any(f"hold-out level {level} is left out" in note for note in result.notes)
        for fold in of(result, level):
            _check_leak_free(presses, fold)


def _check_leak_free(presses: PressTable, fold: Fold) -> None:
    kept = group(presses, fold.hold_out)
    assert len(fold.test) and not set(kept[fold.train].tolist()) & set(kept[fold.test].tolist())
    assert set(presses.texture[fold.test]) <= set(presses.texture[fold.train])
    if fold.hold_out == "copy":
        pairs = set(zip(presses.texture[fold.train], presses.combination[fold.train], strict=True))
        assert set(zip(presses.texture[fold.test], presses.combination[fold.test], strict=True)) <= pairs
