"""Hold-out levels: which presses train and which are tested, from the easiest claim to the hardest.

- ``press``: other presses of the same prints, at the same positions;
- ``position``: positions on the block that were never pressed in training;
- ``force``: a contact force that training has not seen;
- ``copy``: another print of the same texture from the same printer and filament;
- ``printer-filament``: prints of a combination that training has not seen.

Beside them stands ``session``: recordings of another session, for data that know theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.types import Bools, Ints, Strings

#: The units of each level's intervals, which are what differs between one held-out group and the next: their name, and
#: where :class:`PressTable` has them. The levels stand in order, from the easiest; sessions stand beside them.
UNITS = {
    "press": ("prints", "run"),
    "position": ("positions", "position"),
    "force": ("force levels", "level"),
    "copy": ("prints", "run"),
    "printer-filament": ("printer-filament combinations", "combination"),
    "session": ("sessions", "session"),
}
#: What must be known of every press for a level, in words of ``Collection.has``.
NEEDS = {name: name for name in ("position", "force", "session")}
NEEDS |= {"copy": "print", "printer-filament": "printer or filament"}
#: Names of the hold-out levels that every study is asked for, from the easiest claim to the hardest.
HOLD_OUT_LEVELS = tuple(level for level in UNITS if level != "session")
#: Folds of the levels whose groups are many: presses and positions.
FOLDS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class PressTable:
    """What of a collection a split needs as plain arrays, (n,) each, that can be sent to a process.

    Args:
        run: The print's number.
        texture: Name of the texture.
        combination: Printer and filament.
        copy: Number of the copy.
        level: Force level.
        position: Number of the position.
        session: Name of the session.
        unknown: What is unknown of some press, of :data:`NEEDS`.
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
        """The textures, sorted."""
        return [str(name) for name in np.unique(self.texture)]

    @classmethod
    def of(cls, collection: Collection) -> PressTable:
        """That of a collection."""
        columns = {field.name: getattr(collection, field.name) for field in fields(cls) if field.name != "unknown"}
        unknown = {need for need in NEEDS.values() if not any(collection.has(word) for word in need.split(" or "))}
        return cls(**columns, unknown=frozenset(unknown))

    def units(self, hold_out: str) -> tuple[str, NDArray[Any]]:
        """What an interval of a hold-out level counts as one: its name, and which of them each press is of, (n,).

        Where prints are unknown, recordings stand for them, and samples where these are unknown too.
        """
        name, array = UNITS.get(hold_out, UNITS["copy"])
        if array == "run" and NEEDS["copy"] in self.unknown:
            if "session" in self.unknown:
                return "samples", np.arange(len(self.run))
            return "recordings", self.run
        return name, getattr(self, array)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """One training set and what is tested with it.

    Args:
        hold_out: Of :data:`HOLD_OUT_LEVELS`.
        group: The held-out group by name, ``copy 2``; empty for a draw of presses or positions.
        train: Indices of presses.
        test: Likewise; never of a group that trains.
    """

    hold_out: str
    group: str
    train: Ints
    test: Ints


@dataclass(frozen=True, kw_only=True)
class Folds:
    """The folds of one trial.

    Args:
        folds: Those of every level that the data support.
        notes: Levels and presses that are left out, each with the reason.
    """

    folds: tuple[Fold, ...]
    notes: tuple[str, ...]

    @property
    def levels(self) -> tuple[str, ...]:
        """The hold-out levels that have folds."""
        present = {fold.hold_out for fold in self.folds}
        return tuple(level for level in UNITS if level in present)


def levels_of(collection: Collection) -> tuple[str, ...]:
    """The hold-out levels that a study is asked for where nothing is said: sessions only if they are known."""
    return (*HOLD_OUT_LEVELS, "session") if collection.has("session") else HOLD_OUT_LEVELS


def folds_of(presses: PressTable, levels: Sequence[str] = HOLD_OUT_LEVELS, *, seed: int, folds: int = FOLDS) -> Folds:
    """The folds of a trial.

    Args:
        presses: The presses.
        levels: Hold-out levels.
        seed: Draws presses and positions into folds; the other levels hold out each of their groups in turn.
        folds: Folds of presses and positions; fewer where there are fewer.

    Raises:
        InputError: A level is unknown, there are fewer than two folds or textures, or no level is left.
    """
    if folds < 2:
        raise InputError("folds", folds, "must be at least 2")
    if len(presses.textures) < 2:
        raise InputError("textures", presses.textures, "classifying needs at least two textures")
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
    """To which fold each press belongs (-1: it always trains), names of the folds, and why there are none."""
    random = np.random.default_rng([seed, list(UNITS).index(level)])
    if NEEDS.get(level) in presses.unknown:
        column = NEEDS[level].partition(" ")[0]
        reason = f"the {NEEDS[level]} is unknown; import with a column for it: --columns {column}=COLUMN"
        return np.zeros(len(presses.run), dtype=np.int64), [], reason
    if level == "press":
        _, counts = np.unique(presses.texture, return_counts=True)
        fewest = int(counts.min())
        return _stratified(presses.texture, min(folds, fewest), random), [], "a texture has one press" * (fewest < 2)
    if level == "position":
        places, index = np.unique(presses.position, return_inverse=True)
        drawn = random.permutation(len(places)) % min(folds, len(places))
        return drawn[index], [], "there is one position" * (len(places) < 2)
    if level == "force":
        levels, index = np.unique(presses.level, return_inverse=True)
        return index, [f"force level {number}" for number in levels], "there is one force level" * (len(levels) < 2)
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
        return index, [f"session {name}" for name in names], "there is one session" * (len(names) < 2)
    names, index = np.unique(presses.combination, return_inverse=True)
    reason = f"there is one printer-filament combination, {names[0]}" * (len(names) < 2)
    return index, [str(name) for name in names], reason


def _stratified(texture: Strings, folds: int, random: np.random.Generator) -> Ints:
    """Presses dealt out to folds, each texture evenly."""
    groups = np.empty(len(texture), dtype=np.int64)
    start = 0
    for name in np.unique(texture):
        where = np.flatnonzero(texture == name)
        groups[random.permutation(where)] = (start + np.arange(len(where))) % max(folds, 1)
        start += len(where)
    return groups


def _same_kind(presses: PressTable) -> list[Bools]:
    """The presses of each texture of each combination."""
    pairs = dict.fromkeys(zip(presses.combination.tolist(), presses.texture.tolist(), strict=True))
    return [(presses.combination == combination) & (presses.texture == texture) for combination, texture in pairs]


def _folds(presses: PressTable, level: str, groups: Ints, names: list[str], notes: list[str]) -> list[Fold]:
    """Folds whose every tested texture, and for copies its combination too, is in the training set."""
    folds = []
    for group in range(int(groups.max()) + 1):
        train, test = np.flatnonzero(groups != group), np.flatnonzero(groups == group)
        name = names[group] if names else ""
        known = np.isin(presses.texture[test], np.unique(presses.texture[train]))
        if not known.all():
            missing = ", ".join(str(texture) for texture in np.unique(presses.texture[test[~known]]))
            notes.append(
                f"hold-out level {level}, {name or 'a fold'}: {missing} is not tested, as no other group has it"
            )
            test = test[known]
        if len(test) and len(np.unique(presses.texture[train])) > 1:
            folds.append(Fold(hold_out=level, group=name, train=train, test=test))
    return folds


def with_copies(presses: PressTable, fold: Fold, copies: int, seed: int) -> Fold | None:
    """A fold whose training set has fewer prints.

    Args:
        presses: All presses.
        fold: The whole fold.
        copies: Prints of each texture and combination that are kept.
        seed: What they are drawn by.

    Returns:
        None where some texture of a combination that trains has fewer.
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
