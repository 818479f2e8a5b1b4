"""The warnings of the variance table about its data, one sentence each, and its relation to the paper's figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import FLOOR, PAPER_FLOORS, POSITIONS, PRINTS
from tacbench_cad.lab.analysis.published import REPEATS as PAPER_REPEATS
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, REPEATS, Cell
from tacbench_cad.lab.analysis.variance.result import Protocol
from tacbench_cad.util.text import counted

K = TypeVar("K")


def variance_warnings(collection: Collection, cells: Sequence[Cell], left_out: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings: every reason why the table cannot simply be compared with the paper's.

    Args:
        collection: The study.
        cells: The cells of the table.
        left_out: The frames that could not be used.
    """
    warnings = [f"{where}: {text}" for where, text in _warnings(collection, cells) if where]
    if left_out:
        more = f", and {len(left_out) - 1:,} more" if len(left_out) > 1 else ""
        verb = "was" if len(left_out) == 1 else "were"
        warnings.insert(
            0, f"{counted(len(left_out), 'frame')} could not be used and {verb} left out: {left_out[0]}{more}"
        )
    return tuple(warnings)


def _warnings(collection: Collection, cells: Sequence[Cell]) -> Iterator[tuple[str, str]]:
    """Yield the subject and the text of every possible warning; a warning with an empty subject does not apply."""
    positions, repeats = len(collection.pressing.positions_mm), collection.pressing.repeats
    of_level = [cell for cell in cells if cell.force_level != ALL_LEVELS]
    by_combination = _by(of_level, lambda cell: cell.combination)
    max_prints = {combination: max(cell.prints for cell in members) for combination, members in by_combination}
    fullest = [cell for cell in of_level if cell.prints == max_prints[cell.combination]]
    of_repeats = any(cell.quantity == "repeats of one print" for cell in cells)
    for prints, members in _by(fullest, lambda cell: cell.prints):
        if of_repeats:
            if prints == 1:
                yield _where(members), "there is only one print of each texture, so there is no interval"
        elif prints == 1:
            yield (
                _where(members),
                "there is only one print of each texture; its variance contains sensor noise and differences between "
                "repeats, but no differences between prints, and it has no interval",
            )
        elif prints < PRINTS and collection.beside_paper:
            wide = "; with two prints, intervals are very wide" if prints == 2 else ""
            yield (
                _where(members),
                f"there are {prints} prints of each texture, and {PRINTS} in the paper's text{wide}",
            )
    mixed = [cell for _, members in by_combination if len({cell.prints for cell in members}) > 1 for cell in members]
    counts = _listed(sorted({cell.prints for cell in mixed}))
    yield (
        _where(mixed),
        f"the force levels have different numbers of prints ({counts}); the mean of all forces is therefore a mean of "
        "figures that are not comparable, and it has no interval",
    )
    yield (
        _where(cell for cell in cells if cell.floor_from == REPEATS),
        "there are no stationary frames in contact; the noise floor is computed from the repeats on one print and is "
        "only an upper bound, because the sensor was moved between them",
    )
    yield (
        _where(cell for cell in cells if not cell.floor_from),
        f"there is no noise floor (no stationary frames in contact{'' if of_repeats else ' and no second repeat'}); "
        "it is unknown how much of the variance is noise",
    )
    for (presses, prints), members in _by(fullest, lambda cell: (cell.presses, cell.prints)):
        design = (prints, positions, repeats)
        other = not of_repeats and collection.beside_paper and design != (PRINTS, POSITIONS, PAPER_REPEATS)
        if other and presses == prints * positions * repeats:
            yield (
                _where(members),
                f"a cell has {counted(presses, 'press')} ({counted(prints, 'print')} x "
                f"{counted(positions, 'position')} x {counted(repeats, 'repeat')}), and "
                f"{PRINTS * POSITIONS * PAPER_REPEATS} ({PRINTS} x {POSITIONS} x {PAPER_REPEATS}) in the paper's text",
            )
    yield (
        _where(cell for cell in of_level if cell.presses < cell.prints * positions * repeats),
        "presses are missing; the estimates take this into account, but the paper's plain mean does not",
    )
    there = {(cell.combination, cell.texture) for cell in of_level}
    for combination in collection.combinations:
        missing = [texture for texture in collection.textures if (combination, texture) not in there]
        if missing:
            yield combination, f"{_listed(missing)} {'is' if len(missing) == 1 else 'are'} missing"
    if len(collection.combinations) == 1:
        yield "only one printer-filament", "nothing can be said about differences between printers"
    if len(collection.textures) == 1:
        yield "only one texture", "nothing can be said about differences between textures"
    yield (
        _where(cell for cell in of_level if cell.variance == 0.0),
        "all frames are equal, so the variance is 0; check that the sensor works",
    )


def _by(cells: Iterable[Cell], key: Callable[[Cell], K]) -> list[tuple[K, list[Cell]]]:
    groups: dict[K, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(key(cell), []).append(cell)
    return list(groups.items())


def _where(cells: Iterable[Cell]) -> str:
    """Return the names of the cells' combinations, or only their number if there are more than three."""
    names = list(dict.fromkeys(cell.combination for cell in cells))
    return _listed(names) if len(names) <= 3 else f"{len(names)} printer-filaments"


def _listed(words: Iterable[object]) -> str:
    return ", ".join(str(word) for word in words)


def relation_to_paper(protocol: Protocol) -> str:
    """Return the relation between figures of a protocol and the paper's, for images in counts."""
    if protocol == "paper":
        return (
            "The paper's printed figures are another quantity, the variance over the two repeats on one print. "
            'Use "tacbench variance --protocol as-published" to compute this quantity and compare it with them.'
        )
    meanings = ", ".join(f"{value:.3g} counts^2 if it is a {what}" for what, value in PAPER_FLOORS.items())
    return (
        "According to the authors' notebooks, the paper's printed figures are the variance over the repeats on one "
        "print, then the mean over prints, positions and pixels. They do not show how prints differ. They were "
        "computed from four prints at the lowest force, and include frames of other textures (row numbers were "
        f"stored in 8 bits). The paper gives the average pixel variation of a stationary sensor as {FLOOR:g}, "
        f"without a unit: {meanings}."
    )
