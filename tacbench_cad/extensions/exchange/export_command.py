"""``tacbench export-runs``: write runs in the formats of other tools."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path

import rich_click as click

from tacbench_cad.cli import ProgressLine, options
from tacbench_cad.util.entries import entries
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import counted

#: The words of ``--to``.
FORMATS = (*entries("tacbench.export_formats"), "tactile-data")


def _whole_numbers(separator: str, count: int, allowed: str) -> options.Value:
    def read(option: str, text: str) -> tuple[int, ...]:
        parts = text.split(separator)
        if len(parts) != count:
            raise InputError(option, text, f"must be {allowed}")
        return tuple(options.whole_of(option, part) for part in parts)

    return options.Value(allowed.partition(", ")[0], read)


@options.command("export-runs", "Share")
@options.runs
@options.option(
    "--to",
    options.text("NAME", *FORMATS),
    f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}.",
    options.OUTPUT,
    required=True,
)
@options.out("DIR", "A new folder. Without it, tactile-data writes into the run folders; all other formats need it.")
@options.option(
    "--bbox",
    _whole_numbers(",", 4, "X0,Y0,X1,Y1, whole numbers separated by commas"),
    "For tactile-data: pixels to keep. Default: the largest centred square.",
    options.FRAMES,
)
@options.option(
    "--size",
    _whole_numbers("x", 2, "WxH, for example 128x128"),
    "For tactile-data: size of the images. Default: 128x128.",
    options.FRAMES,
)
@options.flag("--colour", "For tactile-data: keep the colours. Default: grey by ITU-R BT.601.", options.FRAMES)
def command(
    runs: tuple[Path, ...],
    to: str,
    bbox: tuple[int, int, int, int] | None,
    size: tuple[int, int] | None,
    colour: bool,
    out: Path | None,
) -> None:
    """Write runs in the formats of other tools.

    - huggingface: Parquet files, a dataset card and Croissant metadata
    - webdataset: tar files
    - imagefolder: one folder of images for each label, with metadata.csv
    - zarr, npz: arrays
    - tactile-data: the files that tactile_learning reads for each run

    All formats except tactile-data contain the frames of all presses of all runs, and the columns of targets.csv. Image
    files are copied without change. Unknown values stay unknown. Simulated data are marked in every file.

    The format tactile-data is for the toolchain of the Python package tactile_learning. Its models take square grey
    images of 128 x 128 pixels, so the command crops, converts and resizes the images.

    Each frame is compared with its checksum. A folder is written completely or not at all.

    Examples:
      tacbench export-runs --to huggingface runs/ --out dataset
      tacbench export-runs --to zarr runs/ --out arrays
      tacbench export-runs --to tactile-data runs/ --out data --bbox 110,0,550,440
    """
    from tacbench_cad.extensions.exchange.exporting.card import NO_SERIES
    from tacbench_cad.extensions.exchange.exporting.export_formats import TACTILE_DATA, export_runs

    if one_of("to", to, FORMATS) == TACTILE_DATA:
        _export_tactile_data(runs, out, bbox, size or (128, 128), colour)
        return
    if out is None:
        raise InputError("--out DIR", None, f"is missing; --to {to} needs a new folder for the result")
    for option, value in (("bbox", bbox), ("size", size), ("colour", colour)):
        if value:
            raise InputError(option, None, f"is only for --to {TACTILE_DATA}; {to} does not change the frames")
    with ProgressLine() as progress:
        samples = export_runs(runs, to, out, partial(progress.show, "frames"))
    click.echo(f"{counted(len(samples.runs), 'run')}, {counted(len(samples), 'frame')}, in {out}")
    if samples.series:
        click.echo(NO_SERIES)


def _export_tactile_data(
    folders: tuple[Path, ...],
    out: Path | None,
    bbox: tuple[int, int, int, int] | None,
    size: tuple[int, int],
    colour: bool,
) -> None:
    from tacbench_cad.extensions.exchange.exporting.card import NO_SERIES
    from tacbench_cad.extensions.exchange.exporting.tactile_data import Processing, export_tactile_data
    from tacbench_cad.lab.runs import Run, find_runs

    processing = Processing(bbox=bbox, size=size, grey=not colour)
    runs = find_runs(folders)
    twice = next((name for name, count in Counter(folder.name for folder in runs).items() if count > 1), None)
    if out is not None and twice is not None:
        raise InputError("out", str(out), f"two of the runs have the name {twice}; export them to different folders")
    images = 0
    with ProgressLine() as progress:
        for folder in runs:
            target = None if out is None else out / folder.name
            images += export_tactile_data(folder, target, processing, partial(progress.show, folder.name))
    exported = f"{counted(len(runs), 'run')}, {counted(images, 'image')} of {size[0]}x{size[1]} pixels"
    click.echo(f"{exported}, in {out or 'the run folders'}")
    if any(Run.open(folder).info.series_frames for folder in runs):
        click.echo(NO_SERIES)
