"""``tacbench roi``: find the region of interest and store it with the runs."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_paths, print_json, print_lines, print_next
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


@options.command("roi", "Press")
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
def command(runs: tuple[Path, ...], roi: str | None, out: Path | None, json: bool) -> None:
    """Find the region of interest and store it with the runs.

    The region of interest is the part of each frame that shows the sensor. With --roi, the command stores the region in
    each run folder (roi.json). After that, variance, classify, report and check-runs use only the pixels inside the
    region. --roi none removes the stored region.

    --roi auto finds a dome or a gel, in frames without contact if there are any. It stores the region only if the
    result is certain. If the frames show neither a dome nor a gel, the whole frame is used. Without --roi, the command
    shows the region that auto finds and stores nothing.

    Examples:
      tacbench roi runs/ -o pictures
      tacbench roi runs/ --roi auto
      tacbench roi runs/ --roi circle:304,248,210
    """
    from tacbench_cad.lab.runs.frame_files import write_png
    from tacbench_cad.lab.runs.reading import Run, find_runs
    from tacbench_cad.lab.runs.region import remove_region, store_region
    from tacbench_cad.lab.runs.region_search import NO_REGION, NONE_FOUND, found_region, region_of

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
            for frame in run.resting_frames(1):
                files.append(out / f"{run.folder.name}_roi.png")
                write_png(files[-1], region.drawn(frame))
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
            print_next("roi", *next_paths(runs), "--roi", region.text)
