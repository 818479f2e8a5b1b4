"""``tacbench score``: score predictions for a split file."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table


@options.command("score")
@options.argument("predictions", options.file("PREDICTIONS"), "Table of your predictions (CSV).")
@options.argument("split", options.file("SPLIT"), "Split file that tacbench split wrote.")
@options.json
def command(predictions: Path, split: Path, json: bool) -> None:
    """Score your own predictions for the test data.

    The table has a header and one row for each press that a fold tests. It has these columns: fold, run, force_level,
    repeat and position with the values of the split file, and predicted with the name of a texture, for example
    texture-4. Other columns are ignored.

    A prediction that is missing, that appears twice, or that belongs to no test press is reported, and the exit code is
    then 1. The confidence intervals of the accuracies are computed over prints.

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
        print_json(result.document())
        return
    for table in result.shown:
        show_table(table)
    print_lines(f"chance is {1.0 / len(result.split.textures):.1%}; data {result.split.data_sha256[:12]}")
    print_simulated(result.split.simulated)
