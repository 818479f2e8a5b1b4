"""``tacbench runs``: check run folders, and write them as other tools read them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import end_check, note, print_json, print_lines, print_table, simulated_devices
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError, one_line, one_of
from tacbench_cad.util.files import refusing
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.rig.sensor import Frame
    from tacbench_cad.lab.runs.checking import RunReport

#: Findings of one kind that are shown for a run before the rest is only counted.
MAX_SHOWN = 10


@options.group("runs")
def command() -> None:
    """Check run folders, and export them for other tools."""


_folders = options.argument("folders", options.file("DIR"), "Run folders, or folders with runs in them.", many=True)


def _whole_numbers(separator: str, count: int, allowed: str) -> options.Value:
    def read(option: str, text: str) -> tuple[int, ...]:
        parts = text.split(separator)
        if len(parts) != count:
            raise InputError(option, text, f"must be {allowed}")
        return tuple(options.whole_of(option, part) for part in parts)

    return options.Value(allowed.partition(", ")[0], read)


@options.command("check", command)
@_folders
@options.flag("--repair", "Cut off a torn last row. Nothing else is changed.")
@options.json
def check(folders: tuple[Path, ...], repair: bool, json: bool) -> None:
    """Examine run folders and every frame in them.

    Missing, extra, doubled, unreadable, dark, blurred and stuck (identical) images, wrong checksums and gaps in the
    protocol are named, one line a run and then one a finding; the exit code is then 1. The order of the rows of
    targets.csv means nothing: a press is known by its force level, repeat and position. Empty fields of print.toml are
    named and are no fault.

    Examples:
      tacbench runs check runs/
      tacbench runs check runs/texture-4_paper_x1_bambu-p1p_pla-minus_copy01 --repair
      tacbench runs check runs/ --json
    """
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.lab.runs.reading import find_runs

    reports: list[RunReport] = []
    refusals: list[tuple[Path, InputError]] = []
    with ProgressLine() as progress:
        for folder in find_runs(folders):
            try:
                reports.append(check_run(folder, repair=repair, progress=partial(progress.show, folder.name)))
            except InputError as error:
                refusals.append((folder, error))
    for report in reports:
        for repaired in report.repaired:
            note(f"repaired {report.folder}: {repaired}")
    if json:
        print_json(
            {
                "ok": not refusals and all(report.ok for report in reports),
                "runs": [report.as_dict() for report in reports],
                "refused": [{"folder": str(path), "reason": one_line(refusal)} for path, refusal in refusals],
            }
        )
    else:
        _print(reports)
    end_check(reports, [refusal for _, refusal in refusals])


@options.command("export", command)
@_folders
@options.option(
    "--to", options.text("huggingface|webdataset|imagefolder|zarr|npz|tactile-data"), "What it is for.", required=True
)
@options.option(
    "--bbox",
    _whole_numbers(",", 4, "X0,Y0,X1,Y1, whole numbers with commas between them"),
    "For tactile-data: pixels to keep. Default: the largest centred square.",
)
@options.option(
    "--size", _whole_numbers("x", 2, "WxH, as 128x128"), "For tactile-data: size of the images. Default: 128x128."
)
@options.flag("--colour", "For tactile-data: keep the colours. Default: grey (BT.601).")
@options.out("DIR", "A new folder. For tactile-data, a folder for one folder a run; without it, the run folders.")
def export(
    folders: tuple[Path, ...],
    to: str,
    bbox: tuple[int, int, int, int] | None,
    size: tuple[int, int] | None,
    colour: bool,
    out: Path | None,
) -> None:
    """Write run folders as other tools read them.

    huggingface is Parquet files with the images, a dataset card and Croissant metadata; webdataset tar files;
    imagefolder one folder of images for each label, with metadata.csv; zarr and npz arrays. Each has all frames of all
    runs, as the bytes that they are where the format takes files, and the columns of targets.csv for each of them. What
    is unknown stays unknown, and simulated data say so in every file.

    tactile-data is what tactile_learning reads: processed_images/, targets_images.csv and the JSON files for each run.
    Its images are cut to a square, made grey and 128 x 128 pixels, as that toolchain's models take them.

    Every frame is compared with its checksum on the way. A folder is written whole or not at all.

    Examples:
      tacbench runs export --to huggingface runs/ --out dataset
      tacbench runs export --to zarr runs/ --out arrays
      tacbench runs export --to tactile-data runs/ --out learning --bbox 110,0,550,440
    """
    from tacbench_cad.lab.runs.exporting.formats import FORMATS, TACTILE_DATA, export_runs

    if one_of("to", to, (*FORMATS, TACTILE_DATA)) == TACTILE_DATA:
        _export_tactile_data(folders, out, bbox, size or (128, 128), colour)
        return
    if out is None:
        raise InputError("out", None, f"is missing: --to {to} needs a folder for the result")
    for option, value in (("bbox", bbox), ("size", size), ("colour", colour)):
        if value:
            raise InputError(option, None, f"is for --to {TACTILE_DATA}: {to} keeps the frames as they are")
    with ProgressLine() as progress:
        samples = export_runs(folders, to, out, partial(progress.show, "frames"))
    click.echo(f"{counted(len(samples.runs), 'run')}, {counted(len(samples), 'frame')}, in {out}")


def _export_tactile_data(
    folders: tuple[Path, ...],
    out: Path | None,
    bbox: tuple[int, int, int, int] | None,
    size: tuple[int, int],
    colour: bool,
) -> None:
    from tacbench_cad.lab.runs.exporting.tactile_data import Processing, export_tactile_data
    from tacbench_cad.lab.runs.reading import find_runs

    processing = Processing(bbox=bbox, size=size, grey=not colour)
    runs = find_runs(folders)
    twice = next((name for name, count in Counter(folder.name for folder in runs).items() if count > 1), None)
    if out is not None and twice is not None:
        raise InputError("out", str(out), f"two of the runs are named {twice}; export them to different folders")
    images = 0
    with ProgressLine() as progress:
        for folder in runs:
            target = None if out is None else out / folder.name
            images += export_tactile_data(folder, target, processing, partial(progress.show, folder.name))
    exported = f"{counted(len(runs), 'run')}, {counted(images, 'image')} of {size[0]}x{size[1]} pixels"
    click.echo(f"{exported}, in {out or 'the run folders'}")


@options.command("roi", command)
@_folders
@options.roi
@options.out("DIR", "Folder for a picture of the region in a frame of each run.")
@options.json
def roi(folders: tuple[Path, ...], roi: str | None, out: Path | None, json: bool) -> None:
    """Find, show and keep the region of interest: the part of each frame that shows the sensor.

    With --roi, the region is kept in each run folder (roi.json), and variance, classify and the check of the runs use
    it from then on; --roi none removes it. auto looks for a dome or a gel in the frames without contact, and keeps what
    it is sure of. Without --roi, what auto would find is shown and nothing is kept.

    Examples:
      tacbench runs roi runs/ -o pictures
      tacbench runs roi runs/ --roi auto
      tacbench runs roi runs/ --roi circle:304,248,210
    """
    from tacbench_cad.lab.runs.reading import Run, find_runs
    from tacbench_cad.lab.vision.region import remove_region, store_region
    from tacbench_cad.lab.vision.resting import NO_REGION, found_region, region_of, resting_frames

    runs = [Run.open(folder) for folder in find_runs(folders)]
    region = found_region(runs) if roi is None else region_of(runs, roi)
    files = []
    for run in runs:
        if roi == NO_REGION:
            remove_region(run.folder)
        elif roi is not None and region is not None:
            store_region(run.folder, region)
        if out is not None and region is not None:
            for frame in resting_frames(run, 1):
                files.append(_picture(out / f"{run.folder.name}_roi.png", region.drawn(frame)))
    kept = len(runs) if roi is not None else 0
    if json:
        known = None if region is None else {"roi": region.text, "sureness": region.sureness, "outside": region.outside}
        print_json({"region": known, "kept": kept, "files": [str(path) for path in files]})
    elif region is None:
        print_lines(f"no region is kept with {counted(len(runs), 'run')}")
    else:
        sure = f"{100 * region.sureness:.0f} % sure, {100 * region.outside:.0f} % of the pixels lie outside"
        end = f"kept with {counted(kept, 'run')}" if kept else f"nothing is kept; --roi {region.text} keeps it"
        pictures = [f"{counted(len(files), 'picture')} in {out}"] if files else []
        print_lines(f"{region.text}: {sure}; {end}", *pictures)


@options.command("markers", command)
@_folders
@options.roi
@options.marker_settings
@options.out("DIR", "Folder for pictures of the markers that were found.", required=True)
@options.json
def markers(
    folders: tuple[Path, ...],
    roi: str | None,
    marker_sigma: float | None,
    marker_threshold: float | None,
    out: Path,
    json: bool,
) -> None:
    """Find the markers of the sensor, and draw them over frames: what --features markers would use.

    For each run a picture of the press with the largest force. Green are the markers that were followed, red those that
    were not found (where their neighbours predict them), blue what is no marker of the sensor; yellow is the way from
    the place without contact. Nothing has to be tuned; --marker-sigma and --marker-threshold replace what is estimated.

    Examples:
      tacbench runs markers runs/ -o pictures
      tacbench runs markers runs/ -o pictures --marker-sigma 3.5 --marker-threshold 20
    """
    from tacbench_cad.lab.runs.reading import Run, find_runs
    from tacbench_cad.lab.vision.displacements import MarkerFeatures
    from tacbench_cad.lab.vision.markers import MarkerSettings
    from tacbench_cad.lab.vision.pictures import markers_drawn
    from tacbench_cad.lab.vision.resting import region_of

    runs = [Run.open(folder) for folder in find_runs(folders)]
    settings = MarkerSettings(sigma_px=marker_sigma, threshold=marker_threshold)
    features = MarkerFeatures.learn(runs, settings, region_of(runs, roi))
    rows = []
    for run in runs:
        row = max(run.rows, key=lambda row: (row.force_level or 0, -row.number), default=None)
        if row is None:
            continue
        frame = run.frame(row)
        reference, found = features.references_px[run.info.printed.name], features.finder.find(frame)
        track = features.track(run, frame)
        path = _picture(out / f"{run.folder.name}_markers.png", markers_drawn(frame, reference, found, track))
        largest = float((track.displacement_px**2).sum(axis=1).max()) ** 0.5
        rows.append((run.folder.name, row.number, int(track.found.sum()), round(largest, 2), str(path)))
    finder = features.finder
    if json:
        keys = ("run", "press", "found", "largest_displacement_px", "picture")
        look = {"markers": features.count, "sigma_px": finder.sigma_px, "threshold": finder.threshold}
        print_json({**look, "dark": finder.dark, "runs": [dict(zip(keys, row, strict=True)) for row in rows]})
        return
    kind = "dark" if finder.dark else "bright"
    sizes = f"--marker-sigma {finder.sigma_px:.3g} --marker-threshold {finder.threshold:.3g}"
    print_lines(f"{features.count} {kind} markers ({sizes})")
    print_table("a press of each run", ("run", ">press", ">found", ">largest displacement (px)", "picture"), rows)


def _picture(path: Path, image: Frame) -> Path:
    """Write a picture, whole or not at all."""
    from tacbench_cad.lab.runs.pictures import write_png

    with refusing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, image)
    return path


def _devices(simulated: Sequence[str]) -> str:
    names = simulated_devices(simulated)
    return "all" if len(names) == 3 else ", ".join(names) or "no"


def _print(reports: Sequence[RunReport]) -> None:
    print_table(
        "runs",
        ("run", ">presses", ">references", ">stationary", ">out of band", "simulated", ">findings"),
        [
            (
                report.folder.name,
                f"{report.presses} of {report.planned}",
                report.references,
                report.stationary,
                report.out_of_band,
                _devices(report.simulated),
                len(report.findings) or "ok",
            )
            for report in reports
        ],
    )
    for report in reports:
        so_far: Counter[str] = Counter()
        for finding in report.findings:
            so_far[finding.kind] += 1
            if so_far[finding.kind] <= MAX_SHOWN:
                print_lines(one_line(f"{report.folder.name}: {finding.kind}: {finding.where} {finding.text}"))
        for kind, count in so_far.items():
            if count > MAX_SHOWN:
                print_lines(f"{report.folder.name}: {kind}: and {count - MAX_SHOWN} more (all with --json)")
    empty = Counter(field for report in reports for field in report.empty_fields)
    if empty:
        print_lines("empty in print.toml (runs): " + ", ".join(f"{field} ({count})" for field, count in empty.items()))
    findings = sum(len(report.findings) for report in reports)
    presses = sum(report.presses for report in reports)
    verdict = counted(findings, "finding") if findings else "nothing wrong"
    print_lines(f"{counted(len(reports), 'run')}, {counted(presses, 'press')}: {verdict}")
