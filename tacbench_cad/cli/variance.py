"""``tacbench variance``: compute the variance over prints and repeats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import next_paths, note, print_json, print_lines, print_next, print_simulated, show_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.variance.registration import Seating
    from tacbench_cad.lab.analysis.variance.view import VarianceView


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
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.feature import fitted
    from tacbench_cad.lab.analysis.variance.registration import register as seats
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.lab.analysis.variance.view import VarianceView, write_all
    from tacbench_cad.util.files import locked

    if ddof not in (0, 1):
        raise InputError("ddof", ddof, "must be 0 or 1")
    others = {"colour": colour, "ddof": ddof, "register": register, "roi": roi, "series": series}
    others["features"] = features != "pixels"
    for name in (name for name, value in others.items() if value and protocol == "as-published"):
        raise InputError(name, others[name], "is only for --protocol paper; as-published has fixed settings")
    if seed < 0:
        raise InputError("seed", seed, "must be 0 or more")
    collection = Collection.open(runs)
    if isinstance(force_level, int):
        collection = collection.at_level(force_level)
    collection = collection.viewed(series)
    feature = None
    if protocol == "paper":
        feature = fitted(collection, features, roi, colour=colour)
    if out is not None:
        with locked(out):  # a folder that cannot be written is refused before the work, not after it
            pass
    with ProgressLine() as progress:
        seatings: tuple[Seating, ...] = ()

        def frames(done: int, total: int) -> None:
            progress.show("frames", done, total)

        if register:
            progress.show("registering")
            seatings = seats(collection, feature, ddof=ddof, jobs=jobs, dask=dask)
        result = variance_table(
            collection,
            feature,
            protocol=protocol,
            ddof=ddof,
            jobs=jobs,
            dask=dask,
            seed=seed,
            progress=frames,
        )
    files = [] if out is None else write_all(result, out, seatings)
    view = VarianceView.of(result, seatings)
    if json:
        took = {"readings": result.passed.frames, "process_seconds": dict(result.passed.seconds)}
        print_json({**view.document(), **took, "files": [str(path) for path in files]})
    else:
        _print(view)
        if out is not None:
            click.echo(f"{counted(len(files), 'file')} in {out}")
        print_next("classify", *next_paths(runs))
    for line in result.left_out:
        note(f"error: left out: {line}")
    if result.left_out:
        raise Exit(1)


def _print(view: VarianceView) -> None:
    print_simulated(view.collection.simulated)
    for _, shown in view.shown():
        show_table(shown)
    print_lines(*view.notes, *(f"warning: {text}" for text in view.warnings))
    tests = view.tables.get("permutation")
    if tests is not None and tests.empty and len(view.collection.combinations) > 1:
        note("no permutation test between printers: it needs two printers with two prints each of the same texture")
