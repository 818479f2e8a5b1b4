"""What a reader of the variance table must know about the data behind it, a sentence each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
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
    warnings = [f"{where}: {text}" for where, text in _warnings(collection, cells) if where]
    if left_out:
        more = f", and {len(left_out) - 1:,} more" if len(left_out) > 1 else ""
        warnings.insert(0, f"{counted(len(left_out), 'reading')} could not be used and left out: {left_out[0]}{more}")
    return tuple(warnings)


def _warnings(collection: Collection, cells: Sequence[Cell]) -> Iterator[tuple[str, str]]:
    """What a warning is about, and its text; one that is about nothing does not hold."""
    positions, repeats = len(collection.pressing.positions_mm), collection.pressing.repeats
    of_level = [cell for cell in cells if cell.force_level != ALL_LEVELS]
    by_combination = _by(of_level, lambda cell: cell.combination)
    most = {combination: max(cell.prints for cell in members) for combination, members in by_combination}
    fullest = [cell for cell in of_level if cell.prints == most[cell.combination]]
    of_repeats = any(cell.quantity == "repeats of one print" for cell in cells)
    for prints, members in _by(fullest, lambda cell: cell.prints):
        if of_repeats:
            if prints == 1:
                yield _where(members), "one print of each texture, so there is no interval"
        elif prints == 1:
            yield (
                _where(members),
                "one print of each texture; its variance holds noise and re-approach but nothing of how prints differ, "
                "and has no interval",
            )
        elif prints < PRINTS and collection.beside_paper:
            wide = "; with two, an interval can only be very wide" if prints == 2 else ""
            yield _where(members), f"{prints} prints of each texture, the paper's text has {PRINTS}{wide}"
    mixed = [cell for _, members in by_combination if len({cell.prints for cell in members}) > 1 for cell in members]
    counts = _listed(sorted({cell.prints for cell in mixed}))
    yield (
        _where(mixed),
        f"the force levels have different numbers of prints ({counts}); the pooled column averages what is not alike "
        "and has no interval",
    )
    yield (
        _where(cell for cell in cells if cell.floor_from == REPEATS),
        "no stationary frames in contact; the floor comes from repeats on one print and is only an upper bound, "
        "because re-approach is in it",
    )
    yield (
        _where(cell for cell in cells if not cell.floor_from),
        f"no noise floor (no stationary frames in contact{'' if of_repeats else ' and no second repeat'}); how much of "
        "the variance is noise is not known",
    )
    for (presses, prints), members in _by(fullest, lambda cell: (cell.presses, cell.prints)):
        design = (prints, positions, repeats)
        other = not of_repeats and collection.beside_paper and design != (PRINTS, POSITIONS, PAPER_REPEATS)
        if other and presses == prints * positions * repeats:
            yield (
                _where(members),
                f"{counted(presses, 'press')} in a cell ({prints} x {counted(positions, 'position')} x "
                f"{counted(repeats, 'repeat')}), the paper's text has {PRINTS * POSITIONS * PAPER_REPEATS} "
                f"({PRINTS} x {POSITIONS} x {PAPER_REPEATS})",
            )
    yield (
        _where(cell for cell in of_level if cell.presses < cell.prints * positions * repeats),
        "presses are missing; the estimates allow for it, the paper's plain mean does not",
    )
    there = {(cell.combination, cell.texture) for cell in of_level}
    for combination in collection.combinations:
        missing = [texture for texture in collection.textures if (combination, texture) not in there]
        if missing:
            yield combination, f"no {_listed(missing)}"
    if len(collection.combinations) == 1:
        yield "one printer-filament only", "nothing can be said about differences between printers"
    if len(collection.textures) == 1:
        yield "one texture only", "nothing can be said about differences between textures"
    yield (
        _where(cell for cell in of_level if cell.variance == 0.0),
        "all readings are equal, so the variance is 0; check that the sensor was alive",
    )


def _by(cells: Iterable[Cell], key: Callable[[Cell], K]) -> list[tuple[K, list[Cell]]]:
    groups: dict[K, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(key(cell), []).append(cell)
    return list(groups.items())


def _where(cells: Iterable[Cell]) -> str:
    """The combinations of some cells: by name up to three."""
    names = list(dict.fromkeys(cell.combination for cell in cells))
    return _listed(names) if len(names) <= 3 else f"{len(names)} printer-filaments"


def _listed(words: Iterable[object]) -> str:
    return ", ".join(str(word) for word in words)
