"""``tacbench score``: predictions against a split file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import console, note, print_json, print_simulated, table

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.score import Score, Share

NAME = "score"


def command(
    predictions: Annotated[Path, typer.Argument(metavar="PREDICTIONS.csv", show_default=False)],
    split: Annotated[Path, typer.Argument(metavar="SPLIT", help="A file of tacbench split.", show_default=False)],
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Score predictions, made by anything, against a split file.

    PREDICTIONS.csv has a head and a row for each press that a fold tests, with the columns fold, run, force_level,
    repeat, position (as in the split file) and predicted (a texture's name, as texture-4); other columns are left
    alone. Every prediction that is missing, doubled or of something unknown is named, and the exit code is then 1.
    Intervals have prints as their unit.

    Examples:
      tacbench score predictions.csv splits/split_copy.json
      tacbench score predictions.csv splits/split_copy.json --json
    """
    from tacbench_cad.lab.analysis.classification.score import PredictionsError, score
    from tacbench_cad.lab.analysis.classification.split_files import read_split

    try:
        result = score(predictions, read_split(split))
    except PredictionsError as error:
        for one in error.faults:
            note(f"{one.kind}: {one.text}")
        raise
    if json:
        print_json(result.as_dict())
        return
    _print(result)


def _print(result: Score) -> None:
    textures = result.split.textures
    numbers = ("accuracy", "95 % interval", "right", "presses", "prints")
    shown = table(f"{result.split.protocol}: accuracy", "of", *numbers, right=numbers)
    shown.add_row("all folds", *_cells(result.accuracy))
    for name, one in result.folds.items():
        shown.add_row(name, *_cells(one))
    for name, one in result.recall.items():
        shown.add_row(f"{name} (recall)", *_cells(one))
    screen = console()
    screen.print(shown)
    confusion = table("pressed (rows) and predicted (columns)", "", *textures, right=textures)
    for name, row in zip(textures, result.confusion.tolist(), strict=True):
        confusion.add_row(name, *(f"{count:,}" for count in row))
    screen.print(confusion)
    screen.print(f"chance is {1.0 / len(textures):.1%}; data {result.split.data_sha256[:12]}", soft_wrap=True)
    print_simulated(screen, result.split.simulated)


def _cells(one: Share) -> list[str]:
    interval = "none" if one.low is None or one.high is None else f"{one.low:.1%} to {one.high:.1%}"
    return [f"{one.value:.1%}", interval, f"{one.right:,}", f"{one.presses:,}", str(one.prints)]
