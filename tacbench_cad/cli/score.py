"""``tacbench score``: score predictions for a split file."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table


@options.command("score", "Analyse")
@options.argument("predictions", options.file("PREDICTIONS"), "Table of your predictions (CSV).")
@options.argument("split", options.file("SPLIT"), "Split file that tacbench split wrote.")
@options.json
def command(predictions: Path, split: Path, json: bool) -> None:
    """Score your own predictions for the test data.

    The split file has several folds. Each fold divides the presses into training and test data. Your table has a header
    and one row for each test press of each fold. Its columns are:
    - fold, run, force_level, repeat, position: the values of the split file
    - predicted: the name of a texture, for example texture-4

    Other columns are ignored. If a prediction is missing, appears twice, or belongs to no test press, the command
    reports it, and the exit code is 1. The confidence intervals of the accuracies are computed over prints.

    Examples:
      tacbench score predictions.csv splits/split_copy.json
      tacbench score predictions.csv splits/split_copy.json --json
    """
    from tacbench_cad.lab.analysis.classification.hold_out import leak_warning
    from tacbench_cad.lab.analysis.classification.score import PredictionsError, score
    from tacbench_cad.lab.analysis.classification.split_files import read_split

    try:
        result = score(predictions, read_split(split))
    except PredictionsError as error:
        for fault in error.faults:
            note(fault)
        raise
    if json:
        print_json(result.document())
        return
    for table in result.shown():
        show_table(table)
    if result.split.unknown_groups:
        print_lines(f"note: {leak_warning(result.split.unknown_groups)}")
    print_lines(f"chance is {1.0 / len(result.split.textures):.1%}; data {result.split.data_sha256[:12]}")
    print_simulated(result.split.simulated)
