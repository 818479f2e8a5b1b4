"""Hold-out levels: the division into training and test presses, from the easiest claim to the hardest.

- ``press``: other presses of the same prints, at the same positions;
- ``position``: positions on the block that were never pressed in training;
- ``force``: a contact force that training has not seen;
- ``copy``: another print of the same texture from the same printer and filament;
- ``printer-filament``: prints of a combination that training has not seen.

A further level, ``session``, holds out recordings of another session; it is for data whose sessions are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import natural_unique
from tacbench_cad.util.types import Bools, Ints, Strings

#: The units of each level's intervals, by which held-out groups differ: their name, and their attribute of
#: :class:`PressTable`. The levels are in order, the easiest first; the level of sessions is last.
UNITS = {
    "press": ("prints", "run"),
    "position": ("positions", "position"),
    "force": ("force levels", "level"),
    "copy": ("prints", "run"),
    "printer-filament": ("printer-filament combinations", "combination"),
    "session": ("sessions", "session"),
}
#: The facts that must be known for every press at a level, in words of ``Collection.has``.
NEEDS = {name: name for name in ("position", "force", "session")}
NEEDS |= {"copy": "print", "printer-filament": "printer or filament"}
#: The hold-out levels that are computed for every study, from the easiest claim to the hardest.
HOLD_OUT_LEVELS = tuple(level for level in UNITS if level != "session")
#: The levels that hold out no group of similar samples, and the words for the first of them if groups are unknown.
_WITHIN_GROUPS = ("press", "position", "force")
MAY_LEAK = "random split, may leak"
#: The number of folds for levels with many groups: presses and positions.
FOLDS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class PressTable:
    """The facts about presses that splits need, as plain arrays, (n,) each, which can be sent to another process.

    Args:
        run: The number of the print.
        texture: The name of the texture.
        combination: The printer and the filament.
        copy: The number of the copy.
        level: The force level.
        position: The number of the position.
        session: The name of the session.
        unknown: The facts of :data:`NEEDS` that are unknown for some press.
    """

    run: Ints
    texture: Strings
    combination: Strings
    copy: Ints
    level: Ints
    position: Ints
    session: Strings
    unknown: frozenset[str] = frozenset()

    @property
    def textures(self) -> list[str]:
        """The names of the textures in natural order."""
        return [str(name) for name in natural_unique(self.texture)[0]]

    @classmethod
    def of(cls, collection: Collection) -> PressTable:
        """Make the table of a collection."""
        columns = {field.name: getattr(collection, field.name) for field in fields(cls) if field.name != "unknown"}
        unknown = {need for need in NEEDS.values() if not any(collection.has(word) for word in need.split(" or "))}
        return cls(**columns, unknown=frozenset(unknown))

    def units(self, hold_out: str) -> tuple[str, NDArray[Any]]:
        """Return the unit of the intervals at a hold-out level: its name, and the unit of each press, (n,).

        If prints are unknown, the unit is the recording; if recordings are unknown too, it is the sample.
        """
        name, array = UNITS.get(hold_out, UNITS["copy"])
        if array == "run" and NEEDS["copy"] in self.unknown:
            if "session" in self.unknown:
                return "samples", np.arange(len(self.run))
            return "recordings", self.run
        return name, getattr(self, array)


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


def levels_of(collection: Collection) -> tuple[str, ...]:
    """Return the default hold-out levels of a study. They include sessions only if these are known."""
    return (*HOLD_OUT_LEVELS, "session") if collection.has("session") else HOLD_OUT_LEVELS


def shown_level(level: str, unknown_groups: Sequence[str]) -> str:
    """Return the name of a hold-out level for readers; it says whether the level may leak.

    Args:
        level: The hold-out level, or a column of the paper's protocols.
        unknown_groups: See :attr:`.Collection.unknown_groups`.
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


def folds_of(presses: PressTable, levels: Sequence[str] = HOLD_OUT_LEVELS, *, seed: int, folds: int = FOLDS) -> Folds:
    """Make the folds of a trial.

    Args:
        presses: The presses.
        levels: The hold-out levels.
        seed: The seed that assigns presses and positions to folds. The other levels hold out one group after another.
        folds: The number of folds of presses and positions; fewer if there are fewer presses or positions.

    Raises:
        InputError: A level is unknown, there are fewer than two folds or textures, or no level is left.
    """
    if folds < 2:
        raise InputError("folds", folds, "must be at least 2")
    if len(presses.textures) < 2:
        raise InputError("textures", presses.textures, "must be at least two for a classification")
    result: list[Fold] = []
    notes: list[str] = []
    for level in dict.fromkeys(levels):
        one_of("hold-out", level, UNITS)
        groups, names, reason = _groups(presses, level, seed, folds)
        supported = [] if reason else _folds(presses, level, groups, names, notes)
        if not supported:
            notes.append(
                f"hold-out level {level} is left out: {reason or 'no held-out texture is left in any training set'}"
            )
        result += supported
    if not result:
        raise InputError("hold-out", ", ".join(levels), "the data support none of them; " + "; ".join(notes))
    return Folds(folds=tuple(result), notes=tuple(notes))


def _groups(presses: PressTable, level: str, seed: int, folds: int) -> tuple[Ints, list[str], str]:
    """Return the fold of each press (-1: always training), the folds' names, and the reason if there are no folds."""
    random = np.random.default_rng([seed, list(UNITS).index(level)])
    if NEEDS.get(level) in presses.unknown:
        column = NEEDS[level].partition(" ")[0]
        reason = f"the {NEEDS[level]} is unknown; import with a column for it: --columns {column}=COLUMN"
        return np.zeros(len(presses.run), dtype=np.int64), [], reason
    if level == "press":
        _, counts = np.unique(presses.texture, return_counts=True)
        smallest = int(counts.min())
        reason = "a texture has only one press" * (smallest < 2)
        return _stratified(presses.texture, min(folds, smallest), random), [], reason
    if level == "position":
        places, index = np.unique(presses.position, return_inverse=True)
        drawn = random.permutation(len(places)) % min(folds, len(places))
        return drawn[index], [], "there is only one position" * (len(places) < 2)
    if level == "force":
        levels, index = np.unique(presses.level, return_inverse=True)
        return (
            index,
            [f"force level {number}" for number in levels],
            "there is only one force level" * (len(levels) < 2),
        )
    if level == "copy":
        several = np.zeros(len(presses.copy), dtype=np.bool_)
        for where in _same_kind(presses):
            several |= where & (len(np.unique(presses.copy[where])) > 1)
        copies = np.unique(presses.copy[several])
        reason = "no texture has two copies from one printer and filament" * (not len(copies))
        groups = np.where(several, np.searchsorted(copies, presses.copy), -1)
        return groups, [f"copy {number}" for number in copies], reason
    if level == "session":
        names, index = np.unique(presses.session, return_inverse=True)
        return index, [f"session {name}" for name in names], "there is only one session" * (len(names) < 2)
    names, index = np.unique(presses.combination, return_inverse=True)
    reason = f"there is only one printer-filament combination, {names[0]}" * (len(names) < 2)
    return index, [str(name) for name in names], reason


def _stratified(texture: Strings, folds: int, random: np.random.Generator) -> Ints:
    """Assign presses to folds, so that each texture is spread evenly over them."""
    groups = np.empty(len(texture), dtype=np.int64)
    start = 0
    for name in np.unique(texture):
        where = np.flatnonzero(texture == name)
        groups[random.permutation(where)] = (start + np.arange(len(where))) % max(folds, 1)
        start += len(where)
    return groups


def _same_kind(presses: PressTable) -> list[Bools]:
    """Return a mask of the presses for each texture of each combination."""
    pairs = dict.fromkeys(zip(presses.combination.tolist(), presses.texture.tolist(), strict=True))
    return [(presses.combination == combination) & (presses.texture == texture) for combination, texture in pairs]


def _folds(presses: PressTable, level: str, groups: Ints, names: list[str], notes: list[str]) -> list[Fold]:
    """Make folds whose tested textures are all in the training set."""
    folds = []
    for group in range(int(groups.max()) + 1):
        train, test = np.flatnonzero(groups != group), np.flatnonzero(groups == group)
        name = names[group] if names else ""
        known = np.isin(presses.texture[test], np.unique(presses.texture[train]))
        if not known.all():
            missing = ", ".join(str(texture) for texture in np.unique(presses.texture[test[~known]]))
            notes.append(
                f"hold-out level {level}, {name or 'a fold'}: {missing} is not tested, because no other group has it"
            )
            test = test[known]
        if len(test) and len(np.unique(presses.texture[train])) > 1:
            folds.append(Fold(hold_out=level, group=name, train=train, test=test))
    return folds


def with_copies(presses: PressTable, fold: Fold, copies: int, seed: int) -> Fold | None:
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
    for where in _same_kind(presses):
        inside = fold.train[where[fold.train]]
        prints = np.unique(presses.copy[inside])
        if not len(prints):
            continue
        if len(prints) < copies:
            return None
        kept.append(inside[np.isin(presses.copy[inside], random.permutation(prints)[:copies])])
    return replace(fold, train=np.sort(np.concatenate(kept)))
