"""Measure the errors of textures 2 and 4 as sliced by PrusaSlicer and CuraEngine, for the tables of docs/plates.md.

    python benchmarks/slice_check.py

Blocks of the preset paper, as STL within 0.01 mm of the formula, are sliced by the programs that are installed
(Debian's packages prusa-slicer, cura-engine and cura). The G-code is compared with the formula as ``tacbench
check-gcode`` does.

Errors are root mean squares in micrometres: vertical where the slope is below 1, sideways on steeper walls. The value
in brackets is that of ideal steps with the same layers. A peak is lost, or a valley filled, if its height is wrong by
more than one layer. The last columns have the height error if the coordinates are wrong by 0.1 mm, and the seconds to
slice and to check.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from tacbench_cad.extensions.slicing.comparison import compare
from tacbench_cad.extensions.slicing.gcode import read_gcode
from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.spec.block import Block

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.outsiders import program
from helpers.slicing import by_cura, by_prusa, cura_search_path

#: Options of PrusaSlicer for texture 4: name, layer height and nozzle in mm, wall generator.
WALLS = (
    ("classic walls", 0.1, 0.4, "classic"),
    ("Arachne", 0.1, 0.4, "arachne"),
    ("Arachne", 0.2, 0.4, "arachne"),
    ("Arachne, nozzle 0.2", 0.1, 0.2, "arachne"),
)
LAYERS_MM = (0.1, 0.15, 0.2)

Slice = Callable[[Path], Path]


def cases(model: dict[int, Path]) -> Iterator[tuple[int, str, Slice]]:
    """Yield a texture number, a description, and the function that slices the texture."""
    cura = shutil.which("CuraEngine") and cura_search_path()
    if shutil.which("prusa-slicer"):
        run = program("prusa-slicer", "prusa-slicer")
        for layer in LAYERS_MM:
            yield 2, f"PrusaSlicer, {layer:g} mm", lambda out, h=layer: by_prusa(run, model[2], out, h)
        for name, layer, nozzle, walls in WALLS:
            words = ("--perimeter-generator", walls)
            yield (
                4,
                f"PrusaSlicer, {name}, {layer:g} mm",
                lambda out, h=layer, n=nozzle, w=words: by_prusa(run, model[4], out, h, *w, nozzle_mm=n),
            )
    else:
        print("prusa-slicer is not installed: its rows are left out")
    if cura:
        os.environ["CURA_ENGINE_SEARCH_PATH"] = cura
        engine = program("CuraEngine", "cura-engine")
        for layer in LAYERS_MM:
            yield 2, f"CuraEngine, {layer:g} mm", lambda out, h=layer: by_cura(engine, model[2], out, h)
        yield 4, "CuraEngine, 0.1 mm", lambda out: by_cura(engine, model[4], out, 0.1)
    else:
        print("CuraEngine or its definitions are not installed: its rows are left out")


def _um(mm: float | None) -> str:
    return "-" if mm is None else f"{1000.0 * mm:.0f}"


def main() -> None:
    """Slice and compare each case, and print one row for it."""
    heads = ("height (ideal)", "sideways (ideal)", "peaks lost", "valleys filled", "0.1 mm off", "seconds")
    print(f"{'texture':<9}{'':<38}" + "".join(f"{head:>18}" for head in heads))
    with tempfile.TemporaryDirectory() as folder:
        model = {number: Path(folder) / f"{number}.stl" for number in (2, 4)}
        for number, path in model.items():
            FORMATS["stl"].write(block_part(Block.of(number)), path)
        for number, name, cut in cases(model):
            start = time.perf_counter()
            path = cut(Path(folder) / "sliced.gcode")
            sliced = time.perf_counter()
            comparison = compare(read_gcode(path), Block.of(number))
            steep = comparison.sideways
            row = (
                f"{_um(comparison.rms_mm)} ({_um(comparison.ideal_rms_mm)})",
                "-" if steep is None else f"{_um(steep.rms_mm)} ({_um(steep.ideal_rms_mm)})",
                f"{comparison.peaks.missed:,} of {comparison.peaks.count:,}",
                f"{comparison.valleys.missed:,} of {comparison.valleys.count:,}",
                _um(comparison.misplaced_rms_mm),
                f"{sliced - start:.1f} + {time.perf_counter() - sliced:.1f}",
            )
            print(f"{number:<9}{name:<38}" + "".join(f"{text:>18}" for text in row), flush=True)


if __name__ == "__main__":
    main()
