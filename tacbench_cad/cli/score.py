"""``tacbench score``: predictions against a split file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, print_table
from tacbench_cad.util.text import interval

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.classification.score import Score, Share


@options.command("score")
@options.argument("predictions", options.file("PREDICTIONS.csv"), "The predictions.")
@options.argument("split", options.file("SPLIT"), "A file of tacbench split.")
@options.json
def command(predictions: Path, split: Path, json: bool) -> None:
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
        for fault in error.faults:
            note(f"{fault.kind}: {fault.text}")
        raise
    if json:
        print_json(result.as_dict())
    else:
        _print(result)


def _print(result: Score) -> None:
    textures = result.split.textures
    rows = {"all folds": result.accuracy, **result.folds}
    rows |= {f"{name} (recall)": recall for name, recall in result.recall.items()}
    print_table(
        f"{result.split.protocol}: accuracy (%)",
        ("of", ">accuracy", ">95 % interval", ">right", ">presses", ">prints"),
        [(name, *_cells(share)) for name, share in rows.items()],
    )
    print_table(
        "pressed (rows) and predicted (columns)",
        ("", *(f">{name}" for name in textures)),
        [
            (name, *(f"{count:,}" for count in row))
            for name, row in zip(textures, result.confusion.tolist(), strict=True)
        ],
    )
    print_lines(f"chance is {1.0 / len(textures):.1%}; data {result.split.data_sha256[:12]}")
    print_simulated(result.split.simulated)


def _cells(share: Share) -> tuple[object, ...]:
    low, high = (None if end is None else 100.0 * end for end in (share.low, share.high))
    return f"{100.0 * share.value:.1f}", interval(low, high), f"{share.right:,}", f"{share.presses:,}", share.prints
