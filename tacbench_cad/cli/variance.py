"""``tacbench variance``: how well it printed, the paper's table with what a reviewer would ask for beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_simulated, show_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.analysis.variance.registration import Seating
    from tacbench_cad.lab.analysis.variance.view import VarianceView


@options.command("variance")
@options.runs
@options.option(
    "--protocol",
    options.text("paper|as-published"),
    "The variance over prints and repeats, as the paper's text says, or that over the repeats on one print, which the "
    "paper's printed figures are.",
    default="paper",
)
@options.option(
    "--force-level",
    options.LEVEL,
    "Use the presses of one force level only. Default: all; with as-published the lowest.",
    default="all",
)
@options.look
@options.flag("--colour", "Keep the colours; else BT.601 grey.")
@options.option(
    "--ddof", options.Value("0|1", options.whole_of), "Divide by n (0, as the paper's NumPy) or n - 1.", default="0"
)
@options.flag(
    "--register", "Separate differences in placement from differences in printing; reads every image three times."
)
@options.option("--seed", options.COUNT, "Seed of intervals and permutation tests.", default="0")
@options.jobs
@options.dask
@options.out("DIR", "Folder for tables (CSV) and figures (PNG, PDF).")
@options.json
def command(
    runs: tuple[Path, ...],
    protocol: Literal["paper", "as-published"],
    force_level: int | Literal["all"],
    features: Literal["pixels", "markers"],
    roi: str | None,
    marker_sigma: float | None,
    marker_threshold: float | None,
    colour: bool,
    ddof: int,
    register: bool,
    seed: int,
    jobs: int,
    dask: str | None,
    out: Path | None,
    json: bool,
) -> None:
    """The paper's variance table: each pixel's variance over prints and repeats, mean over pixels and positions.

    For each printer-filament and texture, at each force and as the mean of the forces. Under each row: what the
    sensor's noise alone gives in this table (from the stationary frames in contact; without any, from repeats on one
    print, which is only an upper bound), the 95 % interval with prints as its unit, the estimate with the noise floor
    removed (ddof 1). Then variance components with ISO 5725 limits, and permutation tests between printers. A reading
    that cannot be used is named and left out; the exit code is then 1.

    --protocol as-published computes what the paper's printed figures are, by the saved outputs of its authors'
    notebooks, and sets them beside ours: the variance over the repeats on one print (divisor n), mean over prints,
    positions and pixels, of images at 40 % of their size, grey without rounding, at one force.

    Examples:
      tacbench variance runs -o results
      tacbench variance runs --protocol as-published
      tacbench variance runs --register --jobs 4
      tacbench variance runs --features markers
      tacbench variance runs --roi auto
      tacbench variance runs --colour --ddof 1 --json
    """
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.preprocess import preprocess_of
    from tacbench_cad.lab.analysis.variance.registration import register as seats
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.lab.analysis.variance.view import VarianceView, write_all
    from tacbench_cad.lab.vision.markers import MarkerSettings
    from tacbench_cad.util.files import locked

    if ddof not in (0, 1):
        raise InputError("ddof", ddof, "allowed: 0, 1")
    others = {"colour": colour, "ddof": ddof, "register": register, "roi": roi, "features": features != "pixels"}
    for name in (name for name, value in others.items() if value and protocol == "as-published"):
        raise InputError(name, others[name], "is for --protocol paper; as-published has its own grey, size and divisor")
    if seed < 0:
        raise InputError("seed", seed, "must be 0 or more")
    collection = Collection.open(runs)
    if isinstance(force_level, int):
        collection = collection.at_level(force_level)
    markers = MarkerSettings(sigma_px=marker_sigma, threshold=marker_threshold)
    preprocess = None
    if protocol == "paper":
        preprocess = preprocess_of(collection, features, roi, colour=colour, markers=markers)
    if out is not None:
        with locked(out):  # a folder that cannot be written is refused before the work, not after it
            pass
    with ProgressLine() as progress:
        seatings: tuple[Seating, ...] = ()

        def readings(done: int, total: int) -> None:
            progress.show("readings", done, total)

        if register:
            progress.show("registering")
            seatings = seats(collection, preprocess, ddof=ddof, jobs=jobs, dask=dask)
        result = variance_table(
            collection,
            preprocess if protocol == "paper" else None,
            protocol=protocol,
            ddof=ddof,
            jobs=jobs,
            dask=dask,
            seed=seed,
            progress=readings,
        )
    files = [] if out is None else write_all(result, out, seatings)
    view = VarianceView.of(result, seatings)
    if json:
        took = {"readings": result.passed.readings, "process_seconds": dict(result.passed.seconds)}
        print_json({**view.document(), **took, "files": [str(path) for path in files]})
    else:
        _print(view)
        if out is not None:
            click.echo(f"{counted(len(files), 'file')} in {out}")
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
    if tests and not tests.rows and len(view.collection.combinations) > 1:
        note("no permutation test between printers: it needs two printers with two prints of one texture each")
