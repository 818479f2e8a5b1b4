"""``tacbench markers``: find the markers of the sensor and draw them over frames."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import next_paths, options, print_json, print_lines, print_next, print_table


@options.command("markers", "Press")
@options.runs
@options.roi
@options.option(
    "--sigma-px",
    options.NUMBER,
    "Scale of the filter that finds the markers, in pixels: the width of a marker divided by 2.8. Default: estimated.",
    options.ADVANCED,
)
@options.option(
    "--threshold", options.NUMBER, "Minimum contrast of a marker, in counts. Default: estimated.", options.ADVANCED
)
@options.option(
    "--reference",
    options.file("FRAMES"),
    "Image, or folder of images, of the sensor without contact. The command stores them with the runs that have no "
    "such frames.",
    options.FRAMES,
)
@options.out("DIR", "Folder for the pictures.", required=True)
@options.json
def command(
    runs: tuple[Path, ...],
    roi: str | None,
    sigma_px: float | None,
    threshold: float | None,
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
    --sigma-px and --threshold.

    Examples:
      tacbench markers runs/ -o pictures
      tacbench markers runs/ -o pictures --sigma-px 3.5
      tacbench markers imported/ -o pictures --reference at_rest.png
    """
    from tacbench_cad.extensions.markers.displacements import MarkerFeatures
    from tacbench_cad.extensions.markers.marker_pictures import markers_drawn
    from tacbench_cad.extensions.markers.markers import MarkerSettings
    from tacbench_cad.extensions.markers.pattern import circle_around, expected_count
    from tacbench_cad.extensions.markers.references import add_references
    from tacbench_cad.lab.runs import Run, find_runs, region_of, write_png

    opened = [Run.open(folder) for folder in find_runs(runs)]
    if reference is not None:
        opened = add_references(opened, reference)
    settings = MarkerSettings(sigma_px=sigma_px, threshold=threshold)
    features = MarkerFeatures.learn(opened, settings, region_of(opened, roi))
    rows = []
    for run in opened:
        row = max(run.rows, key=lambda row: (row.force_level or 0, -row.number), default=None)
        if row is None:
            continue
        frame = run.frame(row)
        start, spots = features.trackers[str(run.folder)].reference_px, features.finder.find(frame)
        track = features.track(run.folder, frame)
        path = out / f"{run.folder.name}_markers.png"
        write_png(path, markers_drawn(frame, start, spots, track))
        largest = float((track.displacement_px**2).sum(axis=1).max()) ** 0.5
        rows.append((run.folder.name, row.number, int(track.found.sum()), round(largest, 2), str(path)))
    finder, first = features.finder, features.first.reference_px
    expected, circle = expected_count(first), circle_around(first)
    if json:
        keys = ("run", "press", "found", "largest_displacement_px", "picture")
        look = {"markers": features.count, "expected": expected, "displacement_from": features.origin, "circle": circle}
        look |= {"sigma_px": finder.sigma_px, "threshold": finder.threshold, "dark": finder.dark}
        print_json({**look, "runs": [dict(zip(keys, row, strict=True)) for row in rows]})
        return
    kind = "dark" if finder.dark else "bright"
    sizes = f"--features markers:sigma_px={finder.sigma_px:.3g},threshold={finder.threshold:.3g}"
    print_lines(f"{features.count} {kind} markers of about {expected} that their spacing suggests ({sizes})")
    print_lines(
        f"displacements are measured from the {features.origin} of each marker",
        f"the circle around the markers is {circle}, which tacbench roi accepts as a region",
    )
    print_table("a frame of each run", ("run", ">frame", ">found", ">largest displacement (px)", "picture"), rows)
    print_next("variance", *next_paths(runs), "--features", "markers")
