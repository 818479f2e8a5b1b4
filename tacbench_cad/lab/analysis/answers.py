"""The three questions that a study asks first, each with its figure, its interval and a plain answer.

1. *Is this printer repeatable?* The standard deviation between prints of one texture, as a fraction of that between
   textures. Gauge studies accept no more than :data:`REPEATABLE`, and call up to 0.1 good (AIAG, Measurement Systems
   Analysis, 4th edition, 2010: percentage of gauge repeatability and reproducibility).
2. *Do prints differ more than repeats?* The variance of two prints over that of two repeats on one print: 1 if prints
   add nothing.
3. *Which textures can be told apart on a print never seen?* The fraction of a texture's presses that is predicted
   rightly where its whole print was left out of the training (hold-out level ``copy``).

The answer is yes or no only where the whole 95 % interval says so. Its unit is the print.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.analysis.tables import Column, Row, Table
from tacbench_cad.lab.analysis.variance.cells import name_of
from tacbench_cad.lab.analysis.variance.intervals import CellSums, component_interval, ratio_interval
from tacbench_cad.lab.analysis.variance.streaming import CellKey, PlaceSums, levels_with_most_prints
from tacbench_cad.lab.analysis.variance.table import VarianceResult, pooled
from tacbench_cad.util.text import interval, short

#: Prints may differ by this fraction of what textures differ by, as standard deviations.
REPEATABLE = 0.3
#: A texture is told apart where more than this fraction of its presses is predicted rightly.
TOLD_APART = 0.5

IS_REPEATABLE = "Is this printer repeatable?"
PRINTS_DIFFER = "Do prints differ more than repeats?"
WHICH_TEXTURES = "Which textures can be told apart on a print never seen?"

_OF_TEXTURES = "% of what textures differ by"
_OF_REPEATS = "times what repeats differ by"
RIGHT = "% predicted correctly"

#: The columns of ``printer_answers.csv`` and ``texture_answers.csv``.
COLUMNS: tuple[Column, ...] = (
    *(Column("question"), Column("about")),
    *(Column("figure", float), Column("low", float), Column("high", float)),
    *(Column("unit"), Column("answer")),
)


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One answer.

    Args:
        question: The question.
        about: Printer and filament, or texture.
        figure: What was measured, in ``unit``; None if it cannot be said.
        low: Lower end of its 95 % interval.
        high: Upper end.
        unit: What the figure counts.
        answer: The answer in plain words, or why there is none.
    """

    question: str
    about: str
    figure: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    answer: str


def shown(table: Table) -> Table:
    """The rows of ``printer_answers.csv`` and ``texture_answers.csv`` as people see them: each question once."""
    rows: list[Row] = []
    for row in table.rows:
        again = any(row["question"] == other["question"] for other in table.rows[: len(rows)])
        figure = "" if row["figure"] is None else f"{short(row['figure'])} {row['unit']}"
        ends = "" if row["low"] is None else interval(row["low"], row["high"])
        question = "" if again else row["question"]
        rows.append(
            {"question": question, "about": row["about"], "figure": figure, "ends": ends, "answer": row["answer"]}
        )
    heads = {"question": "question", "about": "", "figure": "figure", "ends": "95 % interval", "answer": "answer"}
    columns = tuple(Column(name, head=head) for name, head in heads.items())
    return Table(columns=columns, rows=tuple(rows), title="the questions first")


def print_answers(result: VarianceResult) -> Iterator[Answer]:
    """Whether each printer of a variance table is repeatable, and whether its prints differ more than repeats."""
    drawn = levels_with_most_prints(
        {(level, key): cell.design.tolist() for key, of in result.sums.items() for level, cell in of.items()}
    )
    differ: list[Answer] = []
    for combination in dict.fromkeys(combination for combination, _ in result.sums):
        levels = {key: drawn[key] for key in result.sums if key[0] == combination}
        of_keys = ([result.sums[key][level] for level in of_key] for key, of_key in levels.items())
        several = [cell for of_key in of_keys if (cell := pooled(of_key) or of_key[0]).prints > 1]
        about = name_of(combination)
        known = result.collection.has("print")
        reason = _no_answer(several) if known else "cannot be said: the print of each sample is unknown"
        if reason:
            yield Answer(question=IS_REPEATABLE, about=about, answer=reason)
            differ.append(Answer(question=PRINTS_DIFFER, about=about, answer=reason))
            continue
        yield _repeatable(about, several, _between_textures(result.passed.places, levels, several), result.seed)
        ratio = ratio_interval(several, seed=result.seed)
        answer = "yes" if ratio.low > 1.0 else f"not shown; at most {short(ratio.high)} times"
        ends = {"figure": max(1.0, ratio.estimate), "low": ratio.low, "high": ratio.high}
        differ.append(Answer(question=PRINTS_DIFFER, about=about, **ends, unit=_OF_REPEATS, answer=answer))
    yield from differ


def _no_answer(cells: Sequence[CellSums]) -> str:
    """Why nothing can be said of prints; empty if something can."""
    if not cells:
        return "cannot be said: one print of each texture; press at least two"
    return "" if sum(cell.dof[1] for cell in cells) else "cannot be said: one repeat; press each place at least twice"


def _repeatable(about: str, cells: Sequence[CellSums], textures: float, seed: int) -> Answer:
    """Whether what prints differ by is small beside what textures differ by (a variance)."""
    if textures <= 0.0:
        reason = "cannot be said: no differences between textures to compare with"
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
    places: Iterable[PlaceSums], levels: dict[CellKey, tuple[int, ...]], cells: Sequence[CellSums]
) -> float:
    """The variance between textures of one printer: half the mean squared distance of two, without prints and noise."""
    repeat = sum(cell.within for cell in cells) / sum(cell.dof[1] for cell in cells)
    between, dof, kappa = (sum(values) for values in zip(*((c.between, c.dof[0], c.kappa) for c in cells), strict=True))
    prints = max(0.0, (between - dof * repeat) / kappa)
    combination = next(iter(levels))[0]
    halves = []
    for place in places:
        names, distances = place.distances.get(combination, ((), np.zeros((0, 0))))
        used = [i for i, name in enumerate(names) if place.level in levels.get((combination, name), ())]
        of_mean = {
            i: prints / cell.prints + repeat / cell.presses
            for i in used
            for cell in [place.cells[combination, names[i]]]
        }
        halves += [(distances[i, j] - of_mean[i] - of_mean[j]) / 2.0 for i in used for j in used if i < j]
    return float(np.mean(halves)) if halves else 0.0
