"""``tacbench split``: write the split files of a study."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_next, print_table
from tacbench_cad.util.text import counted


@options.command("split", "Analyse")
@options.runs
@options.option(
    "--hold-out",
    options.words("LIST", *options.LEVELS),
    f"Hold-out levels: {', '.join(options.LEVELS)}. Default: all.",
    options.METHOD,
)
@options.option("--folds", options.COUNT, "Folds of the levels press and position.", options.METHOD, default="5")
@options.out("DIR", "Folder of the split files.", default="splits")
@options.json
@options.option("--seed", options.COUNT, "Seed of the folds of presses and positions.", options.ADVANCED, default="0")
def command(
    runs: tuple[Path, ...], hold_out: tuple[str, ...] | None, folds: int, seed: int, out: Path, json: bool
) -> None:
    """List which presses are training data and which are test data.

    Use this command if you classify with your own program. It writes one split file (JSON) for each hold-out level:
    split_press.json, split_position.json, split_force.json, split_copy.json and split_printer-filament.json. If the
    sessions are known, it also writes split_session.json. A split file lists the training presses and the test presses
    of each fold. "tacbench score" then scores your predictions.

    Each split file has a protocol id and checksums. If two sensors pressed the same prints in the same way, they get
    the same protocol id. You can then compare them without exchanging code or images.

    Examples:
      tacbench split runs/
      tacbench split runs/ --hold-out copy,printer-filament -o splits
    """
    from tacbench_cad.lab.analysis.classification.hold_out import leak_warning
    from tacbench_cad.lab.analysis.classification.split_files import make_splits, write_split
    from tacbench_cad.lab.runs.press_table import read
    from tacbench_cad.util.files import locked

    splits, notes = make_splits(read(runs), hold_out, seed=seed, folds=folds)
    with locked(out):
        files = {out / f"split_{split.hold_out}.json": split for split in splits}
        for path, split in files.items():
            write_split(path, split)
    if json:
        facts = ("protocol", "hold_out", "design_sha256", "data_sha256", "simulated", "unknown_groups")
        found = [
            {"file": str(path), **{name: getattr(split, name) for name in facts}}
            | {"presses": len(split.presses), "folds": [fold.name for fold in split.folds]}
            for path, split in files.items()
        ]
        print_json({"splits": found, "left_out": list(notes)})
        return
    print_table(
        f"{counted(len(files), 'split file')} in {out}",
        ("file", "protocol", ">folds", ">tested"),
        [
            (path.name, split.protocol, len(split.folds), f"{sum(len(fold.test) for fold in split.folds):,}")
            for path, split in files.items()
        ],
    )
    unknown = splits[0].unknown_groups
    warnings = [leak_warning(unknown)] if unknown else []
    for text in (*notes, *warnings):
        note(f"note: {text}")
    print_next("score", "PREDICTIONS", next(iter(files)))
