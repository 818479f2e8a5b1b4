"""``tacbench score``: predictions against a split file."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table


@options.command("score")
@options.argument("predictions", options.file("PREDICTIONS.csv"), "The predictions.")
@options.argument("split", options.file("SPLIT"), "A file of tacbench split.")
@options.json
def command(predictions: Path, split: Path, json: bool) -> None:
    """Score predictions, made by anything, against a split file.

    PREDICTIONS.csv has a head and a row for each press that a fold tests, with the columns fold, run, force_level,
    repeat, position (as in the split file) and predicted (a texture's name, as texture-4); other columns are
    ignored. Every prediction that is missing, doubled or of something unknown is named, and the exit code is then 1.
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
        print_json(result.document())
        return
    for table in result.shown:
        show_table(table)
    print_lines(f"chance is {1.0 / len(result.split.textures):.1%}; data {result.split.data_sha256[:12]}")
    print_simulated(result.split.simulated)
