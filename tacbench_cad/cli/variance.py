"""``tacbench variance``: compute the variance over prints and repeats."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import next_paths, note, print_json, print_lines, print_next, print_simulated, show_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.text import counted


@options.command("variance", "Analyse")
@options.runs
@options.option(
    "--protocol",
    options.text("NAME", "paper", "as-published"),
    "paper: variance over prints and repeats, as the text of the paper says. as-published: variance over the repeats "
    "on one print, as the authors computed the figures in the paper.",
    options.METHOD,
    default="paper",
)
@options.option(
    "--force-level",
    options.LEVEL,
    "Use one force level only. Default: all; for as-published the lowest.",
    options.METHOD,
    default="all",
    show_default=False,
)
@options.flag(
    "--register",
    "Separate differences in placement from differences in printing. This reads every image three times.",
    options.METHOD,
)
@options.look
@options.flag("--colour", "Use the colours. Default: grey by ITU-R BT.601.", options.FRAMES)
@options.out("DIR", "Folder for tables (CSV) and figures (PNG, PDF).")
@options.json
@options.jobs
@options.dask
@options.option(
    "--ddof",
    options.Value("0|1", options.whole_of, completing.of_words("0", "1")),
    "0 divides by n, as NumPy and the paper do. 1 divides by n - 1.",
    options.ADVANCED,
    default="0",
)
@options.option("--seed", options.COUNT, "Seed of the intervals and permutation tests.", options.ADVANCED, default="0")
def command(
    runs: tuple[Path, ...],
    protocol: Literal["paper", "as-published"],
    force_level: int | Literal["all"],
    features: str,
    series: bool,
    roi: str | None,
    colour: bool,
    ddof: int,
    register: bool,
    seed: int,
    jobs: int,
    dask: str | None,
    out: Path | None,
    json: bool,
) -> None:
    """Compute the variance over prints and repeats.

    This is the variance table of the paper: the variance of each pixel over prints and repeats, averaged over pixels
    and positions. There is one row for each texture and each combination of printer and filament, at each force level
    and for the mean of the force levels. Below each row you find:
    - the variance that is expected from sensor noise alone
    - the 95 % confidence interval, computed over prints
    - the variance without the noise floor (with ddof 1)

    The noise is measured on the stationary frames in contact. If there are none, it is estimated from the repeats on
    one print and is only an upper bound.

    If the protocol has a motion, --series analyses the frames that were taken while the sensor slid
    in contact. Each variance is then also averaged over these frames, and motion.csv has the variance of each of them.

    Two more tables follow: the variance components with ISO 5725 limits, and permutation tests between printers. If a
    frame cannot be used, it is named and left out, and the exit code is 1.

    The text of the paper describes the variance above. But the table in the paper has another variance, as the authors'
    saved notebooks show: the variance over the repeats on one print (divided by n), averaged over prints, positions and
    pixels. With --protocol as-published, you get this variance, with the published figures next to yours. It is
    computed at one force level, from grey images at 40 % of their size.

    Examples:
      tacbench variance runs -o results
      tacbench variance runs --protocol as-published
      tacbench variance runs --register --jobs 4
      tacbench variance runs --features markers
      tacbench variance runs --roi auto
      tacbench variance slides --series
      tacbench variance runs --colour --ddof 1 --json
    """
    from tacbench_cad.lab.analysis.feature import feature_of
    from tacbench_cad.lab.analysis.study_design import at_level
    from tacbench_cad.lab.analysis.variance.table import variance
    from tacbench_cad.lab.runs.press_table import read
    from tacbench_cad.util.files import locked

    presses = read(runs, series=series)
    if isinstance(force_level, int):
        presses = at_level(presses, force_level)
    usual = features == "pixels" and roi is None and not colour
    feature = None if usual else feature_of(features, roi=roi, colour=colour)
    if out is not None:
        with locked(out):  # a folder that cannot be written is refused before the work, not after it
            pass
    with ProgressLine() as progress:
        if register:
            progress.show("registering")
        result = variance(
            presses,
            feature,
            protocol=protocol,
            ddof=ddof,
            seed=seed,
            register=register,
            jobs=jobs,
            dask=dask,
            progress=partial(progress.show, "frames"),
        )
    files = [] if out is None else result.save(out)
    if json:
        print_json({**result.document(), "files": [str(path) for path in files]})
    else:
        print_simulated(result.design.simulated)
        for _, shown in result.shown():
            show_table(shown)
        print_lines(*result.notes, *(f"warning: {text}" for text in result.warnings))
        if protocol == "paper" and result.tables["permutation"].empty and len(result.design.combinations) > 1:
            note("no permutation test between printers: it needs two printers with two prints each of the same texture")
        if out is not None:
            click.echo(f"{counted(len(files), 'file')} in {out}")
        print_next("classify", *next_paths(runs))
    for line in result.left_out:
        note(f"error: left out: {line}")
    if result.left_out:
        raise Exit(1)
