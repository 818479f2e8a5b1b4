"""What a reader of the variance table must know about the data behind it, a sentence each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import POSITIONS, PRINTS
from tacbench_cad.lab.analysis.published import REPEATS as PAPER_REPEATS
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, REPEATS, Cell
from tacbench_cad.util.text import counted

K = TypeVar("K")


def variance_warnings(collection: Collection, cells: Sequence[Cell], left_out: Sequence[str]) -> tuple[str, ...]:
    """Everything that stands in the way of reading the table as the paper's.

    Args:
        collection: The study.
        cells: The table.
        left_out: Readings that could not be used.
    """
    of_level = [one for one in cells if one.force_level != ALL_LEVELS]
    found = []
    if left_out:
        found.append(
            f"{counted(len(left_out), 'reading')} could not be used and left out: {left_out[0]}{_more(left_out)}"
        )
    most = {combination: max(one.prints for one in members) for combination, members in _by(of_level, _combination)}
    fullest = [one for one in of_level if one.prints == most[one.combination]]
    found += _prints(of_level, fullest)
    found += _floors(cells)
    found += _counts(collection, fullest)
    found += _holes(collection, of_level)
    constant = [one for one in of_level if one.variance == 0.0]
    if constant:
        found.append(
            f"{_where(constant)}: all readings are equal, so the variance is 0; check that the sensor was alive"
        )
    return tuple(found)


def _prints(cells: Sequence[Cell], fullest: Sequence[Cell]) -> list[str]:
    """What too few prints do.

    Args:
        cells: All cells of single levels.
        fullest: Of each combination those with the most prints.
    """
    found = []
    for prints, members in _by(fullest, lambda one: one.prints):
        where = _where(members)
        if prints == 1:
            found.append(
                f"{where}: one print of each texture; its variance holds noise and re-approach but nothing of how "
                "prints differ, and has no interval"
            )
        elif prints < PRINTS:
            wide = "; with two, an interval can only be very wide" if prints == 2 else ""
            found.append(f"{where}: {prints} prints of each texture, the paper has {PRINTS}{wide}")
    mixed = [one for _, members in _by(cells, _combination) if len({c.prints for c in members}) > 1 for one in members]
    if mixed:
        counts = _listed(sorted({one.prints for one in mixed}))
        found.append(
            f"{_where(mixed)}: the force levels have different numbers of prints ({counts}); the pooled column "
            "averages what is not alike and has no interval"
        )
    return found


def _floors(cells: Sequence[Cell]) -> list[str]:
    found = []
    bound = [one for one in cells if one.floor_from == REPEATS]
    if bound:
        found.append(
            f"{_where(bound)}: no stationary frames in contact; the floor comes from repeats on one print and is only "
            "an upper bound, because re-approach is in it"
        )
    without = [one for one in cells if not one.floor_from]
    if without:
        found.append(
            f"{_where(without)}: no noise floor (no stationary frames in contact and no second repeat); how much of "
            "the variance is noise is not known"
        )
    return found


def _counts(collection: Collection, cells: Sequence[Cell]) -> list[str]:
    protocol = collection.info.protocol
    positions, repeats = len(protocol.grid.positions_mm), protocol.repeats
    paper = PRINTS * POSITIONS * PAPER_REPEATS
    return [
        f"{_where(members)}: {counted(presses, 'press')} in a cell ({prints} x {counted(positions, 'position')} x "
        f"{counted(repeats, 'repeat')}), the paper's table has {paper} ({PRINTS} x {POSITIONS} x {PAPER_REPEATS})"
        for (presses, prints), members in _by(cells, lambda one: (one.presses, one.prints))
        if (prints, positions, repeats) != (PRINTS, POSITIONS, PAPER_REPEATS)
        and presses == prints * positions * repeats
    ]


def _holes(collection: Collection, cells: Sequence[Cell]) -> list[str]:
    found = []
    protocol = collection.info.protocol
    places = len(protocol.grid.positions_mm) * protocol.repeats
    short = [one for one in cells if one.presses < one.prints * places]
    if short:
        found.append(
            f"{_where(short)}: presses are missing; the estimates allow for it, the paper's plain mean does not"
        )
    there = {(one.combination, one.texture) for one in cells}
    for combination in collection.combinations:
        missing = [texture for texture in collection.textures if (combination, texture) not in there]
        if missing:
            found.append(f"{combination}: no {_listed(missing)}")
    if len(collection.combinations) == 1:
        found.append("one printer-filament only: nothing can be said about differences between printers")
    if len(collection.textures) == 1:
        found.append("one texture only: nothing can be said about differences between textures")
    return found


def _combination(cell: Cell) -> str:
    return cell.combination


def _by(cells: Iterable[Cell], key: Callable[[Cell], K]) -> list[tuple[K, list[Cell]]]:
    groups: dict[K, list[Cell]] = {}
    for one in cells:
        groups.setdefault(key(one), []).append(one)
    return list(groups.items())


def _where(cells: Sequence[Cell]) -> str:
    """The combinations of some cells: by name up to three."""
    names = list(dict.fromkeys(one.combination for one in cells))
    return _listed(names) if len(names) <= 3 else f"{len(names)} printer-filaments"


def _listed(words: Iterable[object]) -> str:
    return ", ".join(str(word) for word in words)


def _more(lines: Sequence[str]) -> str:
    return f", and {len(lines) - 1:,} more" if len(lines) > 1 else ""
