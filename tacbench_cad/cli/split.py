"""``tacbench split``: split files of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import console, note, print_json, table, whole_of, words_of
from tacbench_cad.util.text import counted

NAME = "split"


def command(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUNS", help="Run folders, or folders that hold some.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="DIR", help="Folder of the split files.")] = Path(
        "splits"
    ),
    rungs: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Of press, position, force, copy, printer-filament. Default: all."),
    ] = None,
    folds: Annotated[str, typer.Option(metavar="N", help="Folds of the rungs press and position.")] = "5",
    seed: Annotated[str, typer.Option(metavar="N", help="Draws presses and positions into folds.")] = "0",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Write split files: which presses may be learnt from and which are to be predicted, with a protocol id and hashes.

    One JSON file a rung: split_press.json, split_position.json, split_force.json, split_copy.json and
    split_printer-filament.json. Anything may make the predictions; tacbench score judges them. Two sensors that pressed
    the same prints in the same way have the same protocol id, so they can be compared without sharing code or images.

    Examples:
      tacbench split runs/
      tacbench split runs/ --rungs copy,printer-filament -o splits
      tacbench score predictions.csv splits/split_copy.json
    """
    from tacbench_cad.lab.analysis.classification.split_files import make_splits, write_split
    from tacbench_cad.lab.analysis.classification.splits import RUNGS
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.util.files import locked

    number, count = whole_of("seed", seed), whole_of("folds", folds)
    wanted = words_of(rungs) or RUNGS
    splits, notes = make_splits(Collection.open(runs), wanted, seed=number, folds=count)
    with locked(out):
        paths = [write_split(out / f"split_{one.rung}.json", one) for one in splits]
    if json:
        print_json(
            {
                "splits": [
                    {
                        "file": str(path),
                        "protocol": one.protocol,
                        "rung": one.rung,
                        "design_sha256": one.design_sha256,
                        "data_sha256": one.data_sha256,
                        "presses": len(one.presses),
                        "folds": [fold.name for fold in one.folds],
                        "simulated": list(one.simulated),
                    }
                    for path, one in zip(paths, splits, strict=True)
                ],
                "left_out": list(notes),
            }
        )
        return
    shown = table(
        f"{counted(len(paths), 'split file')} in {out}",
        *("file", "protocol", "folds", "tested"),
        right=("folds", "tested"),
    )
    for path, one in zip(paths, splits, strict=True):
        tested = sum(len(fold.test) for fold in one.folds)
        shown.add_row(path.name, one.protocol, str(len(one.folds)), f"{tested:,}")
    console().print(shown)
    for text in notes:
        note(f"note: {text}")
