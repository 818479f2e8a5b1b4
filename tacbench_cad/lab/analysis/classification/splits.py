"""The ladder of held-out groups: which presses train and which are tested, from the easiest claim to the hardest.

- ``press``: other presses of the same prints, at the same positions;
- ``position``: positions on the block that were never pressed in training;
- ``force``: a contact force that training has not seen;
- ``copy``: another print of the same texture from the same printer and filament;
- ``printer-filament``: prints of a combination that training has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.types import Bools, Ints, Strings

#: The rungs, from the easiest.
RUNGS = ("press", "position", "force", "copy", "printer-filament")
#: What each rung's intervals count as one: what differs between one held-out group and the next.
UNITS = {
    "press": "prints",
    "position": "positions",
    "force": "force levels",
    "copy": "prints",
    "printer-filament": "printer-filament combinations",
}
#: Folds of the rungs whose groups are many: presses and positions.
FOLDS = 5


class Presses(Protocol):
    """What of a collection a split needs, one entry a press."""

    @property
    def run(self) -> Ints:
        """The print's number."""

    @property
    def texture(self) -> Strings:
        """Name of the texture."""

    @property
    def combination(self) -> Strings:
        """Printer and filament."""

    @property
    def copy(self) -> Ints:
        """Number of the copy."""

    @property
    def level(self) -> Ints:
        """Force level."""

    @property
    def position(self) -> Ints:
        """Position."""


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
    """

    run: Ints
    texture: Strings
    combination: Strings
    copy: Ints
    level: Ints
    position: Ints

    @classmethod
    def of(cls, presses: Presses) -> PressTable:
        """That of a collection."""
        return cls(
            run=presses.run,
            texture=presses.texture,
            combination=presses.combination,
            copy=presses.copy,
            level=presses.level,
            position=presses.position,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """One training set and what is tested with it.

    Args:
        rung: Of :data:`RUNGS`.
        held_out: The held-out group by name, ``copy 2``; empty for a draw of presses or positions.
        train: Indices of presses.
        test: Likewise; never of a group that trains.
    """

    rung: str
    held_out: str
    train: Ints
    test: Ints


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """The folds of one trial.

    Args:
        folds: Those of every rung that the data support.
        notes: Rungs and presses that are left out, each with the reason.
    """

    folds: tuple[Fold, ...]
    notes: tuple[str, ...]

    def of(self, rung: str) -> tuple[Fold, ...]:
        """The folds of a rung."""
        return tuple(fold for fold in self.folds if fold.rung == rung)

    @property
    def rungs(self) -> tuple[str, ...]:
        """The rungs that have folds."""
        return tuple(rung for rung in RUNGS if self.of(rung))


def units_of(presses: Presses, rung: str) -> Ints | Strings:
    """To which unit of a rung's interval each press belongs, (n,)."""
    by_rung: dict[str, Ints | Strings] = {
        "position": presses.position,
        "force": presses.level,
        "printer-filament": presses.combination,
    }
    return by_rung.get(rung, presses.run)


def ladder(presses: Presses, rungs: Sequence[str] = RUNGS, *, seed: int, folds: int = FOLDS) -> Ladder:
    """The folds of a trial.

    Args:
        presses: The presses.
        rungs: Which rungs.
        seed: Draws presses and positions into folds; the other rungs hold out each of their groups in turn.
        folds: Folds of presses and positions; fewer where there are fewer.

    Raises:
        InputError: A rung is unknown, there are fewer than two folds or textures, or no rung is left.
    """
    if folds < 2:
        raise InputError("folds", folds, "must be at least 2")
    textures = np.unique(presses.texture)
    if len(textures) < 2:
        raise InputError("textures", [str(one) for one in textures], "classifying needs at least two textures")
    made: list[Fold] = []
    notes: list[str] = []
    for rung in dict.fromkeys(rungs):
        one_of("rungs", rung, RUNGS)
        groups, names, reason = _groups(presses, rung, seed, folds)
        found = [] if reason else _folds(presses, rung, groups, names, notes)
        if not found:
            notes.append(f"rung {rung} is left out: {reason or 'no held-out texture is left in any training set'}")
        made += found
    if not made:
        raise InputError("rungs", ", ".join(rungs), "the data support none of them; " + "; ".join(notes))
    return Ladder(folds=tuple(made), notes=tuple(notes))


def _groups(presses: Presses, rung: str, seed: int, folds: int) -> tuple[Ints, list[str], str]:
    """To which fold each press belongs (-1: it always trains), names of the folds, and why there are none."""
    random = np.random.default_rng([seed, RUNGS.index(rung)])
    if rung == "press":
        _, counts = np.unique(presses.texture, return_counts=True)
        least = int(counts.min())
        return _stratified(presses.texture, min(folds, least), random), [], "a texture has one press" * (least < 2)
    if rung == "position":
        places = np.unique(presses.position)
        drawn = random.permutation(len(places)) % min(folds, len(places))
        return drawn[np.searchsorted(places, presses.position)], [], "there is one position" * (len(places) < 2)
    if rung == "force":
        levels, index = np.unique(presses.level, return_inverse=True)
        return index, [f"force level {one}" for one in levels], "there is one force level" * (len(levels) < 2)
    if rung == "copy":
        prints = {pair: np.unique(presses.copy[where]) for pair, where in _prints(presses).items()}
        several = np.array([len(prints[pair]) > 1 for pair in _pairs(presses)])
        copies = np.unique(presses.copy[several])
        groups = (
            np.where(several, np.searchsorted(copies, presses.copy), -1) if len(copies) else np.full(len(several), -1)
        )
        reason = "no texture has two copies from one printer and filament" * (not several.any())
        return groups, [f"copy {one}" for one in copies], reason
    names, index = np.unique(presses.combination, return_inverse=True)
    reason = f"there is one printer-filament combination, {names[0]}" * (len(names) < 2)
    return index, [str(one) for one in names], reason


def _stratified(texture: Strings, folds: int, random: np.random.Generator) -> Ints:
    """Presses dealt out to folds, each texture evenly."""
    groups = np.empty(len(texture), dtype=np.int64)
    start = 0
    for name in np.unique(texture):
        where = np.flatnonzero(texture == name)
        groups[random.permutation(where)] = (start + np.arange(len(where))) % max(folds, 1)
        start += len(where)
    return groups


def _pairs(presses: Presses) -> list[tuple[str, str]]:
    return list(zip(presses.combination.tolist(), presses.texture.tolist(), strict=True))


def _prints(presses: Presses) -> dict[tuple[str, str], Bools]:
    """The presses of each texture of each combination."""
    pairs = dict.fromkeys(_pairs(presses))
    return {pair: (presses.combination == pair[0]) & (presses.texture == pair[1]) for pair in pairs}


def _folds(presses: Presses, rung: str, groups: Ints, names: list[str], notes: list[str]) -> list[Fold]:
    """Folds whose every tested texture, and for copies its combination too, is in the training set."""
    made = []
    for group in range(int(groups.max()) + 1):
        train, test = np.flatnonzero(groups != group), np.flatnonzero(groups == group)
        name = names[group] if names else ""
        known = np.isin(presses.texture[test], np.unique(presses.texture[train]))
        if not known.all():
            missing = ", ".join(str(one) for one in np.unique(presses.texture[test[~known]]))
            notes.append(f"rung {rung}, {name or 'a fold'}: {missing} is not tested, as no other group has it")
            test = test[known]
        if len(test) and len(np.unique(presses.texture[train])) > 1:
            made.append(Fold(rung=rung, held_out=name, train=train, test=test))
    return made


def with_copies(presses: Presses, fold: Fold, copies: int, seed: int) -> Fold | None:
    """A fold whose training set has fewer prints.

    Args:
        presses: All presses.
        fold: The whole fold.
        copies: Prints of each texture and combination that are kept.
        seed: What they are drawn by.

    Returns:
        None where some texture of a combination that trains has fewer.
    """
    random = np.random.default_rng([seed, copies, RUNGS.index(fold.rung)])
    kept: list[Ints] = []
    for where in _prints(presses).values():
        inside = fold.train[where[fold.train]]
        prints = np.unique(presses.copy[inside])
        if not len(prints):
            continue
        if len(prints) < copies:
            return None
        kept.append(inside[np.isin(presses.copy[inside], random.permutation(prints)[:copies])])
    return Fold(rung=fold.rung, held_out=fold.held_out, train=np.sort(np.concatenate(kept)), test=fold.test)
