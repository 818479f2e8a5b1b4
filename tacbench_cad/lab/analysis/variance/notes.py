"""The notes of the variance table, its warnings about the data, and its relation to the paper's figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pandas as pd

from tacbench_cad.lab.analysis.published import FLOOR, PAPER_FLOORS, POSITIONS, PRINTS
from tacbench_cad.lab.analysis.published import REPEATS as PAPER_REPEATS
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, FRAMES, REPEATS, Protocol, groups
from tacbench_cad.lab.analysis.variance.variance_data import VarianceData
from tacbench_cad.util.text import counted


def variance_notes(result: VarianceData) -> list[str]:
    """Return the notes that explain the tables of a result."""
    words = {
        FRAMES: "stationary frames in contact, at the middle force",
        REPEATS: "repeats on one print, an upper bound",
    }
    sources = "; or ".join(text for source, text in words.items() if source in result.table["floor_from"].to_numpy())
    notes = [
        f"Noise alone is the variance expected from sensor noise alone{f' ({sources})' if sources else ''}. The "
        "unit of the intervals is the print. Floor removed is the variance with ddof 1 minus the noise floor."
    ]
    if result.design.steps:
        notes.append(
            f"Each figure is the mean over the {counted(result.design.steps, 'frame')} of a series. They were taken "
            "while the sensor moved in contact; the paper's sensor did not move."
        )
    if result.feature.words.note:
        notes.append(result.feature.words.note)
    if result.feature.region_ is not None:
        notes.append(f"The region of interest is {result.feature.region_.text}; pixels outside of it are not used.")
    elif result.outside is not None:
        advice = "; --roi auto leaves them out" if result.protocol == "paper" else ""
        outside = f"{100 * result.outside:.0f} %"
        notes.append(f"{outside} of the pixels do not show the sensor, but are part of each variance{advice}.")
    if result.units == "counts" and result.design.beside_paper:
        notes.append(relation_to_paper(result.protocol))
    return notes


def variance_warnings(result: VarianceData) -> list[str]:
    """Return the warnings about the data: every reason why the table cannot simply be compared with the paper's."""
    warnings = [f"{where}: {text}" for where, text in _warnings(result) if where]
    left_out = result.left_out
    if left_out:
        more = f", and {len(left_out) - 1:,} more" if len(left_out) > 1 else ""
        verb = "was" if len(left_out) == 1 else "were"
        frames = counted(len(left_out), "frame")
        warnings.insert(0, f"{frames} could not be used and {verb} left out: {left_out[0]}{more}")
    return warnings


def _warnings(result: VarianceData) -> Iterator[tuple[str, str]]:
    """Yield the subject and the text of every possible warning; a warning with an empty subject does not apply."""
    design, of_repeats = result.design, result.protocol == "as-published"
    positions, repeats = len(design.positions_mm), design.repeats
    cells = result.table.assign(combination=result.table["printer"] + "_" + result.table["filament"])
    of_level = cells[cells["force_level"] != ALL_LEVELS]
    prints_of = of_level.groupby("combination")["prints"]
    fullest = of_level[of_level["prints"] == prints_of.transform("max")]
    for (prints,), members in groups(fullest, ["prints"]):
        if prints == 1 and of_repeats:
            yield _where(members), "there is only one print of each texture, so there is no interval"
        elif prints == 1:
            yield (
                _where(members),
                "there is only one print of each texture; its variance contains sensor noise and differences between "
                "repeats, but no differences between prints, and it has no interval",
            )
        elif not of_repeats and prints < PRINTS and design.beside_paper:
            wide = "; with two prints, intervals are very wide" if prints == 2 else ""
            yield _where(members), f"there are {prints} prints of each texture, and {PRINTS} in the paper's text{wide}"
    mixed = of_level[prints_of.transform("nunique") > 1]
    counts = _listed(sorted(mixed["prints"].unique()))
    yield (
        _where(mixed),
        f"the force levels have different numbers of prints ({counts}); the mean of all forces is therefore a mean of "
        "figures that are not comparable, and it has no interval",
    )
    yield (
        _where(cells[cells["floor_from"] == REPEATS]),
        "there are no stationary frames in contact; the noise floor is computed from the repeats on one print and is "
        "only an upper bound, because the sensor was moved between them",
    )
    yield (
        _where(cells[cells["floor_from"] == ""]),
        f"there is no noise floor (no stationary frames in contact{'' if of_repeats else ' and no second repeat'}); "
        "it is unknown how much of the variance is noise",
    )
    design_of_paper = (PRINTS, POSITIONS, PAPER_REPEATS)
    for (presses, prints), members in groups(fullest, ["presses", "prints"]):
        own = (prints, positions, repeats)
        complete = presses == prints * positions * repeats
        if complete and not of_repeats and design.beside_paper and own != design_of_paper:
            yield (
                _where(members),
                f"a cell has {counted(presses, 'press')} ({counted(prints, 'print')} x "
                f"{counted(positions, 'position')} x {counted(repeats, 'repeat')}), and "
                f"{PRINTS * POSITIONS * PAPER_REPEATS} ({PRINTS} x {POSITIONS} x {PAPER_REPEATS}) in the paper's text",
            )
    yield (
        _where(of_level[of_level["presses"] < of_level["prints"] * positions * repeats]),
        "presses are missing; the estimates take this into account, but the paper's plain mean does not",
    )
    for combination in design.combinations:
        there = of_level.loc[of_level["combination"] == combination, "texture"].unique()
        missing = [texture for texture in design.textures if texture not in there]
        if missing:
            yield combination, f"{_listed(missing)} {'is' if len(missing) == 1 else 'are'} missing"
    if len(design.combinations) == 1:
        yield "only one printer-filament", "nothing can be said about differences between printers"
    if len(design.textures) == 1:
        yield "only one texture", "nothing can be said about differences between textures"
    yield (
        _where(of_level[of_level["variance"] == 0.0]),
        "all frames are equal, so the variance is 0; check that the sensor works",
    )


def _where(cells: pd.DataFrame) -> str:
    """Return the names of the cells' combinations, or only their number if there are more than three."""
    names = cells["combination"].unique()
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
