"""Hold-out levels: the division into training and test presses, from the easiest claim to the hardest.

- ``press``: other presses of the same prints, at the same positions;
- ``position``: positions on the block that were never pressed in training;
- ``force``: a contact force that training has not seen;
- ``copy``: another print of the same texture from the same printer and filament;
- ``printer-filament``: prints of a combination that training has not seen.

A further level, ``session``, holds out recordings of another session; it is for data whose sessions are known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.study_design import Design, keyed, unknown_facts
from tacbench_cad.lab.runs.press_table import STEP
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import natural_unique
from tacbench_cad.util.types import Ints

#: The units of each level's intervals, by which held-out groups differ: their name, and their column of the table of
#: presses. The levels are in order, the easiest first; the level of sessions is last.
UNITS = {
    "press": ("prints", "run"),
    "position": ("positions", "position"),
    "force": ("force levels", "level"),
    "copy": ("prints", "run"),
    "printer-filament": ("printer-filament combinations", "combination"),
    "session": ("sessions", "session"),
}
#: The facts that must be known for every press at a level, in words of ``Design.has``.
NEEDS = {name: name for name in ("position", "force", "session")}
NEEDS |= {"copy": "print", "printer-filament": "printer or filament"}
#: The hold-out levels that are computed for every study, from the easiest claim to the hardest.
HOLD_OUT_LEVELS = tuple(level for level in UNITS if level != "session")
#: The levels that hold out no group of similar samples, and the words for the first of them if groups are unknown.
_WITHIN_GROUPS = ("press", "position", "force")
MAY_LEAK = "random split, may leak"
#: The names of the held-out groups; presses and positions are held out in random groups without names.
_NAMES = {"force": "force level {}", "copy": "copy {}", "printer-filament": "{}", "session": "session {}"}
#: The number of folds for levels with many groups: presses and positions.
FOLDS = 5


def unit_name(level: str, unknown_groups: Sequence[str]) -> str:
    """Return the name of the units of the intervals at a hold-out level: ``prints``.

    If prints are unknown, the unit is the recording; if recordings are unknown too, it is the sample.

    Args:
        level: The hold-out level, or a column of the paper's protocols.
        unknown_groups: See :attr:`.Design.unknown_groups`.
    """
    name, column = UNITS.get(level, UNITS["copy"])
    if column != "run" or "prints" not in unknown_groups:
        return name
    return "samples" if "sessions" in unknown_groups else "recordings"


def units_of(design: Design, level: str) -> NDArray[Any]:
    """Return the unit to which each press belongs at a hold-out level, (n,)."""
    if unit_name(level, design.unknown_groups) == "samples":
        return np.arange(len(design))
    return design.first_steps[UNITS.get(level, UNITS["copy"])[1]].to_numpy()


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """A training set and its test set.

    Args:
        hold_out: The hold-out level.
        group: The name of the held-out group, ``copy 2``; empty for a random group of presses or positions.
        train: The indices of the training presses.
        test: The indices of the test presses; no group is in both sets.
    """

    hold_out: str
    group: str
    train: Ints
    test: Ints


@dataclass(frozen=True, kw_only=True)
class Folds:
    """The folds of one trial.

    Args:
        folds: The folds of every level that the data support.
        notes: The levels and presses that are left out, each with the reason.
    """

    folds: tuple[Fold, ...]
    notes: tuple[str, ...]

    @property
    def levels(self) -> tuple[str, ...]:
        """The hold-out levels that have folds."""
        present = {fold.hold_out for fold in self.folds}
        return tuple(level for level in UNITS if level in present)


def levels_of(design: Design) -> tuple[str, ...]:
    """Return the default hold-out levels of a study. They include sessions only if these are known."""
    return (*HOLD_OUT_LEVELS, "session") if design.has("session") else HOLD_OUT_LEVELS


def shown_level(level: str, unknown_groups: Sequence[str]) -> str:
    """Return the name of a hold-out level for readers; it says whether the level may leak.

    Args:
        level: The hold-out level, or a column of the paper's protocols.
        unknown_groups: See :attr:`.Design.unknown_groups`.
    """
    if not unknown_groups or level not in _WITHIN_GROUPS:
        return level
    return MAY_LEAK if level == _WITHIN_GROUPS[0] else f"{level}, may leak"


def quoted_level(level: str, unknown_groups: Sequence[str]) -> str:
    """Return the name of a level for a number to quote, as :func:`shown_level`, with the unknown groups beside it."""
    shown = shown_level(level, unknown_groups)
    return f"{shown}, {' and '.join(unknown_groups)} unknown" if unknown_groups and shown == level else shown


def leak_warning(unknown_groups: Sequence[str]) -> str:
    """Return the note that a random split may leak if groups are unknown."""
    return (
        f"{' and '.join(unknown_groups)} are unknown: if samples of one object or one session are similar, a random "
        "split leaks: its accuracy is too high, and its interval too narrow; import the samples with a column for "
        "each, such as --columns session=COLUMN"
    )


class HoldOut:
    """A splitter of scikit-learn that holds out groups of presses completely.

    It splits a table of presses, so it can be given as ``cv`` to scikit-learn's functions, with the table as X.

    Args:
        level: The hold-out level: ``press``, ``position``, ``force``, ``copy``, ``printer-filament`` or ``session``.
        folds: The number of folds of presses and positions; fewer if there are fewer presses or positions. The other
            levels hold out one group after another.
        seed: The seed that assigns presses and positions to folds, and that chooses prints.
        copies: The number of prints of each texture and combination that are kept in training; None for all.
    """

    def __init__(self, level: str, *, folds: int = FOLDS, seed: int = 0, copies: int | None = None) -> None:
        self.level = level
        self.folds = folds
        self.seed = seed
        self.copies = copies

    def __repr__(self) -> str:
        return f"HoldOut({self.level!r}, folds={self.folds}, seed={self.seed}, copies={self.copies})"

    def split(self, X: pd.DataFrame, y: object = None, groups: object = None) -> Iterator[tuple[Ints, Ints]]:  # noqa: N803 (scikit-learn names it so)
        """Yield the indices of the training presses and of the test presses of each fold.

        Args:
            X: The table of presses.
            y: Not used: the texture is a column of the table.
            groups: Not used: so are the groups.

        Raises:
            InputError: The level is unknown, or the presses do not support it. The message says why.
        """
        divided = self.divided(X)
        if not divided.folds:
            raise InputError("hold-out", self.level, "; ".join(divided.notes))
        for fold in divided.folds:
            yield fold.train, fold.test

    def get_n_splits(self, X: pd.DataFrame, y: object = None, groups: object = None) -> int:  # noqa: N803
        """Return the number of folds.

        Raises:
            InputError: Same as for :meth:`split`.
        """
        return len(list(self.split(X)))

    def divided(self, presses: pd.DataFrame) -> Folds:
        """Return the folds with the names of their held-out groups, and the reasons for what is left out.

        Raises:
            InputError: The level is unknown, there are fewer than two folds or textures, or the table has series.
        """
        if STEP in presses:
            raise InputError("hold-out", self.level, "divides presses, but the table has the frames of their series")
        return self.divided_keyed(keyed(presses), unknown_facts(presses))

    def divided_keyed(self, table: pd.DataFrame, unknown: frozenset[str]) -> Folds:
        """Return the folds of a table from :func:`~tacbench_cad.lab.analysis.study_design.keyed`.

        Args:
            table: The table, one row for each press.
            unknown: The unknown facts, see :class:`tacbench_cad.lab.analysis.study_design.Design`.

        Raises:
            InputError: Same as for :meth:`divided`.
        """
        one_of("hold-out", self.level, UNITS)
        if self.folds < 2:
            raise InputError("folds", self.folds, "must be at least 2")
        textures = natural_unique(table["texture"].to_numpy(str))[0].tolist()
        if len(textures) < 2:
            raise InputError("textures", textures, "must be at least two for a classification")
        groups, reason, notes = pd.Series(dtype=object), "", list[str]()
        needed = NEEDS.get(self.level, "")
        if needed and unknown.issuperset(needed.split(" or ")):
            column = needed.partition(" ")[0]
            reason = f"the {needed} is unknown; import with a column for it: --columns {column}=COLUMN"
        else:
            groups, reason = _groups(table, self.level, self.seed, self.folds)
        folds = [] if reason else _folds(table, self.level, groups, notes)
        if self.copies is not None:
            cut = [_with_copies(table, fold, self.copies, self.seed) for fold in folds]
            if None in cut:
                reason = f"there are fewer than {self.copies} prints of some texture in training"
            folds = [] if reason else [fold for fold in cut if fold is not None]
        if not folds:
            why = reason or "no held-out texture is left in any training set"
            notes.append(f"hold-out level {self.level} is left out: {why}")
        return Folds(folds=tuple(folds), notes=tuple(notes))


def folds_of(
    design: Design,
    levels: Sequence[str] = HOLD_OUT_LEVELS,
    *,
    seed: int,
    folds: int = FOLDS,
    copies: int | None = None,
) -> Folds:
    """Return the folds of several hold-out levels.

    Args:
        design: The design of the study.
        levels: The hold-out levels.
        seed: See :class:`HoldOut`.
        folds: See :class:`HoldOut`.
        copies: See :class:`HoldOut`.

    Raises:
        InputError: A level is unknown, there are fewer than two folds or textures, or no level is left.
    """
    of_levels = [
        HoldOut(level, folds=folds, seed=seed, copies=copies).divided_keyed(design.first_steps, design.unknown)
        for level in dict.fromkeys(levels)
    ]
    found = tuple(fold for divided in of_levels for fold in divided.folds)
    notes = tuple(note for divided in of_levels for note in divided.notes)
    if not found:
        raise InputError("hold-out", ", ".join(levels), "the data support none of them; " + "; ".join(notes))
    return Folds(folds=found, notes=notes)


def _groups(presses: pd.DataFrame, level: str, seed: int, folds: int) -> tuple[pd.Series[Any], str]:
    """Return the held-out group of each press (missing: always training), and the reason if there are no folds."""
    random = np.random.default_rng([seed, list(UNITS).index(level)])
    if level == "press":  # each texture is spread evenly over the folds
        order = [random.permutation(of.index) for _, of in presses.groupby("texture")]
        smallest = min(map(len, order))
        drawn = np.arange(len(presses)) % max(1, min(folds, smallest))
        return pd.Series(drawn, index=np.concatenate(order)).sort_index(), "a texture has only one press" * (
            smallest < 2
        )
    groups = presses["copy" if level == "copy" else UNITS[level][1]].astype(object)
    if level == "copy":
        groups = groups.where(presses.groupby(["combination", "texture"])["copy"].transform("nunique") > 1)
        reason = "no texture has two copies from one printer and filament"
        return groups, reason * bool(groups.isna().all())
    known = np.unique(groups)
    if level == "position":
        drawn = random.permutation(len(known)) % min(folds, len(known))
        groups = groups.map(dict(zip(known, drawn, strict=True)))
    what = {"force": "force level", "printer-filament": f"printer-filament combination, {known[0]}"}.get(level, level)
    return groups, f"there is only one {what}" * (len(known) < 2)


def _folds(presses: pd.DataFrame, level: str, groups: pd.Series[Any], notes: list[str]) -> list[Fold]:
    """Make folds whose tested textures are all in the training set."""
    folds = []
    texture = presses["texture"].to_numpy(str)
    for group in np.unique(groups.dropna()):
        train, test = np.flatnonzero(groups != group), np.flatnonzero(groups == group)
        name = _NAMES.get(level, "").format(group)
        known = np.isin(texture[test], np.unique(texture[train]))
        if not known.all():
            missing = ", ".join(np.unique(texture[test[~known]]).tolist())
            notes.append(
                f"hold-out level {level}, {name or 'a fold'}: {missing} is not tested, because no other group has it"
            )
            test = test[known]
        if len(test) and len(np.unique(texture[train])) > 1:
            folds.append(Fold(hold_out=level, group=name, train=train, test=test))
    return folds


def _with_copies(presses: pd.DataFrame, fold: Fold, copies: int, seed: int) -> Fold | None:
    """Reduce the number of prints in the training set of a fold.

    Args:
        presses: All presses.
        fold: The complete fold.
        copies: The number of prints of each texture and combination that are kept.
        seed: The seed of the random choice.

    Returns:
        The reduced fold; None if some texture of a training combination has fewer prints.
    """
    random = np.random.default_rng([seed, copies, list(UNITS).index(fold.hold_out)])
    kept: list[Ints] = []
    for _, mine in presses.iloc[fold.train].groupby(["combination", "texture"], sort=False):
        prints = np.unique(mine["copy"])
        if len(prints) < copies:
            return None
        kept.append(mine.index[mine["copy"].isin(random.permutation(prints)[:copies])].to_numpy())
    return replace(fold, train=np.sort(np.concatenate(kept)))
