"""The main questions of a study, each with its figure, its 95 % interval and a plain answer.

1. *Is this printer repeatable?* The figure is the standard deviation between prints of one texture, as a fraction of
   the standard deviation between textures. The limit, :data:`REPEATABLE`, is this project's own: prints must differ
   clearly less than the textures that they are meant to show.
2. *Do prints differ more than repeats?* The figure is the variance between two prints, divided by the variance between
   two repeats on one print. It is 1 if prints add no variance.
3. *Which printer's prints are more alike?* The figure is the ratio of the two printers' variances between prints, the
   larger divided by the smaller. It has no interval. A permutation test decides: its p, adjusted for all pairs of
   printers, must be at most :data:`SIGNIFICANT` (see :mod:`tacbench_cad.lab.analysis.variance.permutation`).
4. *Which textures can be told apart on a print never seen?* The figure is the fraction of a texture's presses that is
   predicted correctly when the whole print is left out of the training (hold-out level ``copy``).

The answer to questions 1, 2 and 4 is yes or no only if the whole 95 % interval is on one side of the limit. The unit of
the interval is the print.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.tables import Shown, frame_of, records
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, CellKey, name_of
from tacbench_cad.lab.analysis.variance.intervals import CellSums, component_interval, pooled, ratio_interval
from tacbench_cad.lab.analysis.variance.streaming import PlaceSums, levels_with_most_prints
from tacbench_cad.util.text import interval, short

#: The limit of question 1: standard deviation between prints, as a fraction of the one between textures.
REPEATABLE = 0.3
#: The limit of question 3: p of the permutation test.
SIGNIFICANT = 0.05
#: The limit of question 4: fraction of a texture's presses that must be predicted correctly.
TOLD_APART = 0.5

IS_REPEATABLE = "Is this printer repeatable?"
PRINTS_DIFFER = "Do prints differ more than repeats?"
MORE_ALIKE = "Which printer's prints are more alike?"
WHICH_TEXTURES = "Which textures can be told apart on a print never seen?"

_OF_TEXTURES = "% of the SD between textures"
_OF_REPEATS = "times the variance of repeats"
_OF_OTHER = "times the other's variance"
RIGHT = "% predicted correctly"


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The answer to one question about one printer or texture.

    Args:
        question: The question.
        about: The printer and filament, or the texture.
        figure: The measured figure, in ``unit``; None if it is unknown.
        low: The lower end of its 95 % interval.
        high: The upper end of its 95 % interval.
        unit: The unit of the figure, in words.
        answer: The answer in plain words, or the reason why there is none.
    """

    question: str
    about: str
    figure: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    answer: str


def answer_table(answers: Iterable[Answer]) -> pd.DataFrame:
    """Return the table of ``printer_answers.csv`` or ``texture_answers.csv``."""
    return frame_of(answers, [field.name for field in fields(Answer)])


def shown_answers(answers: pd.DataFrame) -> Shown:
    """Format the table of answers; each question appears only once."""
    rows = records(answers)
    frame = pd.DataFrame(
        {
            "question": answers["question"].mask(answers["question"].duplicated(), ""),
            "": answers["about"],
            "figure": ["" if row["figure"] is None else f"{short(row['figure'])} {row['unit']}" for row in rows],
            "95 % interval": ["" if row["low"] is None else interval(row["low"], row["high"]) for row in rows],
            "answer": answers["answer"],
        }
    )
    return Shown("answers to the main questions", frame)


def print_answers(
    sums: Mapping[CellKey, Mapping[int, CellSums]],
    places: Sequence[PlaceSums],
    tests: pd.DataFrame,
    *,
    known: bool,
    seed: int,
) -> Iterator[Answer]:
    """Yield the answers to questions 1 and 2 for each printer of a variance table, and to question 3 for each pair.

    Args:
        sums: The sums over positions, by cell and level.
        places: The sums of each place.
        tests: The rows of ``permutation.csv``.
        known: Whether the print of each sample is known.
        seed: The seed of the intervals.
    """
    drawn = levels_with_most_prints(
        {(level, key): cell.design for key, of in sums.items() for level, cell in of.items()}
    )
    differ: list[Answer] = []
    for combination in dict.fromkeys(combination for combination, _ in sums):
        levels = {key: drawn[key] for key in sums if key[0] == combination}
        of_keys = ([sums[key][level] for level in of_key] for key, of_key in levels.items())
        several = [cell for of_key in of_keys if (cell := pooled(of_key) or of_key[0]).prints > 1]
        about = name_of(combination)
        reason = _no_answer(several) if known else "cannot be said: the print of each sample is unknown"
        if reason:
            yield Answer(question=IS_REPEATABLE, about=about, answer=reason)
            differ.append(Answer(question=PRINTS_DIFFER, about=about, answer=reason))
            continue
        yield _repeatable(about, several, _between_textures(places, levels, several), seed)
        ratio = ratio_interval(several, seed=seed)
        answer = "yes" if ratio.low > 1.0 else f"not shown; at most {short(ratio.high)} times"
        ends = {"figure": max(1.0, ratio.estimate), "low": ratio.low, "high": ratio.high}
        differ.append(Answer(question=PRINTS_DIFFER, about=about, **ends, unit=_OF_REPEATS, answer=answer))
    yield from differ
    if known:
        yield from _more_alike(tests)


def _more_alike(tests: pd.DataFrame) -> Iterator[Answer]:
    """Compare pairs of printers by the permutation tests over all force levels, or at the only level."""
    pooled_tests = tests[tests["force_level"] == ALL_LEVELS]
    pairs = pooled_tests if len(pooled_tests) else tests
    if pairs["force_level"].nunique() > 1:
        return
    for test in records(pairs):
        first, second = name_of(test["first"]), name_of(test["second"])
        if test["p_holm"] <= SIGNIFICANT:
            answer = f"{second if test['statistic'] > 0.0 else first} (p {short(test['p_holm'])})"
        elif test["least_p"] * len(pairs) > SIGNIFICANT:
            answer = "cannot be said: too few prints"
        else:
            answer = f"not shown (p {short(test['p_holm'])})"
        ratio = test["ratio"]
        figure = None if ratio is None else max(ratio, 1.0 / ratio)
        about = f"{first} or {second}" if len(pairs) > 1 else "both printers"
        yield Answer(question=MORE_ALIKE, about=about, figure=figure, unit=_OF_OTHER, answer=answer)


def _no_answer(cells: Sequence[CellSums]) -> str:
    """Return the reason why the questions about prints have no answer; an empty string if they have one."""
    if not cells:
        return "cannot be said: there is only one print of each texture; press at least two"
    if not sum(cell.dof[1] for cell in cells):
        return "cannot be said: there is only one repeat; press each position at least twice"
    return ""


def _repeatable(about: str, cells: Sequence[CellSums], textures: float, seed: int) -> Answer:
    """Compare the standard deviation between prints with the one between textures (``textures`` is a variance)."""
    if textures <= 0.0:
        reason = "cannot be said: there are no differences between textures to compare with"
        return Answer(question=IS_REPEATABLE, about=about, answer=reason)
    prints = component_interval(cells, "print", seed=seed)
    figure, low, high = (
        100.0 * math.sqrt(max(0.0, value) / textures) for value in (prints.estimate, prints.low, prints.high)
    )
    limit = 100.0 * REPEATABLE
    answer = f"yes, below {limit:g} %" if high < limit else f"no, above {limit:g} %" if low > limit else "unclear"
    return Answer(
        question=IS_REPEATABLE, about=about, figure=figure, low=low, high=high, unit=_OF_TEXTURES, answer=answer
    )


def _between_textures(
    places: Iterable[PlaceSums], levels: Mapping[CellKey, Sequence[int]], cells: Sequence[CellSums]
) -> float:
    """Return the variance between textures of one printer.

    It is half the mean squared distance between two textures, without the parts that prints and noise cause.

    Args:
        places: The sums of each place.
        levels: The used levels of each cell of the printer.
        cells: The sums of the cells with several prints.
    """
    repeat = sum(cell.within for cell in cells) / sum(cell.dof[1] for cell in cells)
    between, dof, kappa = (sum(values) for values in zip(*((c.between, c.dof[0], c.kappa) for c in cells), strict=True))
    prints = max(0.0, (between - dof * repeat) / kappa)
    halves = []
    for place in places:
        used = [i for i, key in enumerate(place.cells) if place.level in levels.get(key, ())]
        of_place = list(place.cells.values())
        of_mean = {i: prints / of_place[i].prints + repeat / of_place[i].presses for i in used}
        halves += [(place.distances[i, j] - of_mean[i] - of_mean[j]) / 2.0 for i, j in combinations(used, 2)]
    return float(np.mean(halves)) if halves else 0.0
