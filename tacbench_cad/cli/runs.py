"""``tacbench runs``: find the region of interest and the markers in frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_paths, print_json, print_lines, print_next, print_table
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import refusing
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.rig.sensor import Frame


@options.group("runs", "Press")
def command() -> None:
    """Find the region of interest and the markers in frames."""


@options.command("roi", command)
@options.runs
@options.option(
    "--roi",
    options.REGION,
    "Region to store: auto, circle:X,Y,R or rect:X0,Y0,X1,Y1 in pixels, or a PNG file that is white inside the region. "
    "none removes the stored region.",
    options.FRAMES,
)
@options.out("DIR", "Folder for pictures of the region, one for each run.")
@options.json
def roi(runs: tuple[Path, ...], roi: str | None, out: Path | None, json: bool) -> None:
    """Find the region of interest and store it with the runs.

    The region of interest is the part of each frame that shows the sensor. With --roi, the command stores the region in
    each run folder (roi.json). After that, variance, classify, report and check-runs use only the pixels inside the
    region. --roi none removes the stored region.

    --roi auto finds a dome or a gel, in frames without contact if there are any. It stores the region only if the
    result is certain. If the frames show neither a dome nor a gel, the whole frame is used. Without --roi, the command
    shows the region that auto finds and stores nothing.

    Examples:
      tacbench runs roi runs/ -o pictures
      tacbench runs roi runs/ --roi auto
      tacbench runs roi runs/ --roi circle:304,248,210
    """
    from tacbench_cad.extensions.markers.region import NONE_FOUND, remove_region, store_region
    from tacbench_cad.extensions.markers.resting import NO_REGION, found_region, region_of, resting_frames
    from tacbench_cad.lab.runs.reading import Run, find_runs

    opened = [Run.open(folder) for folder in find_runs(runs)]
    none_found = False
    try:
        region = found_region(opened) if roi is None else region_of(opened, roi)
    except InputError as error:
        none_found = error.allowed == NONE_FOUND
        if not none_found:
            raise
        region = None
    files = []
    for run in opened:
        if roi == NO_REGION:
            remove_region(run.folder)
        elif roi is not None and region is not None:
            store_region(run.folder, region)
        if out is not None and region is not None:
            for frame in resting_frames(run, 1):
                files.append(_picture(out / f"{run.folder.name}_roi.png", region.drawn(frame)))
    kept = len(opened) if roi is not None and not none_found else 0
    if json:
        known = None if region is None else {"roi": region.text, "sureness": region.sureness, "outside": region.outside}
        print_json({"region": known, "kept": kept, "files": [str(path) for path in files]})
    elif none_found:
        print_lines("no dome or gel was found: the whole frame is used")
    elif region is None:
        print_lines(f"no region is stored with {counted(len(opened), 'run')}")
    else:
        sure = f"{100 * region.sureness:.0f} % certain, {100 * region.outside:.0f} % of the pixels are outside"
        end = f"stored with {counted(kept, 'run')}" if kept else "not stored"
        pictures = [f"{counted(len(files), 'picture')} in {out}"] if files else []
        print_lines(f"{region.text}: {sure}; {end}", *pictures)
        if kept:
            print_next("variance", *next_paths(runs))
        else:
            print_next("runs", "roi", *next_paths(runs), "--roi", region.text)


@options.command("markers", command)
@options.runs
@options.roi
@options.marker_settings
@options.option(
    "--reference",
    options.file("FRAMES"),
    "Image, or folder of images, of the sensor without contact. The command stores them with the runs that have no "
    "such frames.",
    options.FRAMES,
)
@options.out("DIR", "Folder for the pictures.", required=True)
@options.json
def markers(
    runs: tuple[Path, ...],
    roi: str | None,
    marker_sigma: float | None,
    marker_threshold: float | None,
    reference: Path | None,
    out: Path,
    json: bool,
) -> None:
    """Find the markers of the sensor and draw them over frames.

    The command shows the markers that variance and classify use with --features markers. For each run it draws
    the frame with the largest force:
    - green: markers that were found
    - red: predicted places of markers that were not found
    - blue: spots that are not markers of the sensor
    - yellow: displacement of each marker since the frames without contact

    Imported runs often have no frames without contact. The displacements are then measured from the median position of
    each marker over the frames of all runs. If you have such frames, give them with --reference. They are stored with
    the runs, and all commands use them from then on.

    The width and the contrast of the markers are estimated from the frames. You can replace the estimates with
    --marker-sigma and --marker-threshold.

    Examples:
      tacbench runs markers runs/ -o pictures
      tacbench runs markers runs/ -o pictures --marker-sigma 3.5
      tacbench runs markers imported/ -o pictures --reference at_rest.png
    """
    from tacbench_cad.extensions.markers.displacements import MarkerFeatures
    from tacbench_cad.extensions.markers.markers import MarkerSettings
    from tacbench_cad.extensions.markers.pattern import expected_count
    from tacbench_cad.extensions.markers.pictures import markers_drawn
    from tacbench_cad.extensions.markers.resting import add_references, region_of
    from tacbench_cad.lab.runs.reading import Run, find_runs

    opened = [Run.open(folder) for folder in find_runs(runs)]
    if reference is not None:
        opened = add_references(opened, reference)
    settings = MarkerSettings(sigma_px=marker_sigma, threshold=marker_threshold)
    features = MarkerFeatures.learn(opened, settings, region_of(opened, roi))
    rows = []
    for run in opened:
        row = max(run.rows, key=lambda row: (row.force_level or 0, -row.number), default=None)
        if row is None:
            continue
        frame = run.frame(row)
        start, spots = features.references_px[run.info.printed.name], features.finder.find(frame)
        track = features.track(run, frame)
        path = _picture(out / f"{run.folder.name}_markers.png", markers_drawn(frame, start, spots, track))
        largest = float((track.displacement_px**2).sum(axis=1).max()) ** 0.5
        rows.append((run.folder.name, row.number, int(track.found.sum()), round(largest, 2), str(path)))
    finder, expected = features.finder, expected_count(next(iter(features.references_px.values())))
    if json:
        keys = ("run", "press", "found", "largest_displacement_px", "picture")
        look = {"markers": features.count, "expected": expected, "displacement_from": features.origin}
        look |= {"sigma_px": finder.sigma_px, "threshold": finder.threshold, "dark": finder.dark}
        print_json({**look, "runs": [dict(zip(keys, row, strict=True)) for row in rows]})
        return
    kind = "dark" if finder.dark else "bright"
    sizes = f"--marker-sigma {finder.sigma_px:.3g} --marker-threshold {finder.threshold:.3g}"
    print_lines(f"{features.count} {kind} markers of about {expected} that their spacing suggests ({sizes})")
    print_lines(f"displacements are measured from the {features.origin} of each marker")
    print_table("a frame of each run", ("run", ">frame", ">found", ">largest displacement (px)", "picture"), rows)
    print_next("variance", *next_paths(runs), "--features", "markers")


def _picture(path: Path, image: Frame) -> Path:
    """Write a picture, completely or not at all."""
    from tacbench_cad.lab.runs.pictures import write_png

    with refusing(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, image)
    return path
