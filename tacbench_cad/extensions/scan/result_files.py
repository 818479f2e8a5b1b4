"""The files of a scan's result: JSON, CSV, coloured points, and scans from the simulator."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad import __version__
from tacbench_cad.extensions.scan.cloud import Cloud
from tacbench_cad.extensions.scan.colours import coloured, reach_mm
from tacbench_cad.extensions.scan.record import SCAN_FILE
from tacbench_cad.extensions.scan.result import WAVE_COLUMNS, ScanResult, wave_row
from tacbench_cad.util.files import refusing, replacing, write_json
from tacbench_cad.util.types import Bytes, Floats

#: The names of the files in the folder of a result.
DEVIATION_FILE, WAVES_FILE, POINTS_FILE = "deviation.csv", "waves.csv", "deviation.ply"
#: The columns of the map of the top.
MAP_COLUMNS = ("x_mm", "y_mm", "formula_mm", "printed_mm", "deviation_mm", "pin_shift_px", "points", "simulated")
#: The largest number of points in a coloured file. Of more points, an even selection is written.
MAX_POINTS = 1_000_000
#: The comment with which a file of simulated points begins.
SIMULATED = "simulated scan"


def write_result(result: ScanResult, folder: Path) -> list[Path]:
    """Write the files of a result, each completely or not at all.

    Args:
        result: The result.
        folder: The folder. It is created if it is missing.

    Returns:
        The paths of the files.

    Raises:
        InputError: The folder cannot be written.
    """
    with refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in (SCAN_FILE, DEVIATION_FILE, WAVES_FILE, POINTS_FILE)]
    write_json(paths[0], result.as_dict())
    write_map(result, paths[1])
    rows = [list(wave_row(wave).values()) for wave in result.fit.waves]
    _write_csv(paths[2], (*WAVE_COLUMNS, "simulated"), ([*row, result.cloud.simulated] for row in rows))
    write_coloured(result, paths[3])
    return paths


def write_map(result: ScanResult, path: Path) -> None:
    """Write the map of the top as CSV, with a row for each cell that has points."""
    top = result.top
    i, j = np.nonzero(top.counts > 0)
    columns = (top.formula_mm, top.printed_mm, top.deviation_mm, top.pin_shifts_px)
    values = np.column_stack([top.x_mm[i], top.y_mm[j], *(column[i, j] for column in columns), top.counts[i, j]])
    row = ",".join(["%.4f"] * 4 + ["%.5f", "%.4g", "%d", str(result.cloud.simulated).lower()])
    with replacing(path) as temporary:
        np.savetxt(temporary, values, row, header=",".join(MAP_COLUMNS), comments="")
        text = temporary.read_text(encoding="utf-8").replace("nan", "")
        temporary.write_text(text, encoding="utf-8", newline="\n")


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            writer.writerow([str(cell).lower() if isinstance(cell, bool) else cell for cell in row])


def write_coloured(result: ScanResult, path: Path) -> None:
    """Write the points of the top and the walls in the block frame, coloured by their deviation, as PLY."""
    fit = result.fit
    which = np.flatnonzero(fit.used & np.isfinite(fit.deviation_mm))
    which = which[:: max(1, -(-len(which) // MAX_POINTS))]
    deviation = fit.deviation_mm[which]
    reach = reach_mm(deviation)
    comments = [
        f"deviation of {result.block.name} from its formula, tacbench-cad {__version__}",
        f"blue: {-reach:g} mm or less, white: 0, red: {reach:g} mm or more",
    ]
    if result.cloud.simulated:
        comments.insert(0, f"{SIMULATED}: {result.cloud.source}")
    write_ply(path, fit.pose.to_block(result.cloud.points_mm[which]), coloured(deviation, reach), deviation, comments)


def write_simulated(cloud: Cloud, path: Path) -> None:
    """Write a simulated scan as PLY. Its first comment says that it is simulated."""
    write_ply(path, cloud.points_mm, comments=[f"{SIMULATED}: {cloud.source}", f"tacbench-cad {__version__}"])


def write_ply(
    path: Path,
    points_mm: Floats,
    colours: Bytes | None = None,
    deviation_mm: Floats | None = None,
    comments: Iterable[str] = (),
) -> None:
    """Write points as binary PLY.

    Args:
        path: The file.
        points_mm: The points, shape (n, 3).
        colours: The colours, shape (n, 3); None for no colours.
        deviation_mm: The deviations, which become the property ``quality``, shape (n,), as MeshLab
            calls it; None for no such property.
        comments: The comments in the header.

    Raises:
        InputError: The file cannot be written.
    """
    columns: list[tuple[str, str, str, NDArray[Any]]]
    columns = [(name, "<f4", "float", points_mm[:, i]) for i, name in enumerate("xyz")]
    if colours is not None:
        columns += [(name, "u1", "uchar", colours[:, i]) for i, name in enumerate(("red", "green", "blue"))]
    if deviation_mm is not None:
        columns.append(("quality", "<f4", "float", deviation_mm))
    table = np.empty(len(points_mm), dtype=[(name, kind) for name, kind, _, _ in columns])
    for name, _, _, values in columns:
        table[name] = values
    header = [
        *("ply", "format binary_little_endian 1.0", *(f"comment {comment}" for comment in comments)),
        *(f"element vertex {len(points_mm)}", *(f"property {word} {name}" for name, _, word, _ in columns)),
        "end_header\n",
    ]
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write("\n".join(header).encode("ascii", "replace"))
        stream.write(table.tobytes())
