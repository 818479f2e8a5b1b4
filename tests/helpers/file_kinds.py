"""A valid file of each kind that users supply, and its reader; ``tests/hostile/test_mutations.py`` damages them."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from helpers.gcode_writer import write_gcode
from helpers.import_kinds import IMPORT_KINDS
from helpers.mutations import HARMLESS_IN_TOML, Kind, indented, marked, windows, writer
from helpers.scan_kinds import SCAN_KINDS
from helpers.shapes import box_mesh
from helpers.small_study import STUDY
from helpers.studies import write_study
from tacbench_cad.checks.identify import examine
from tacbench_cad.extensions.slicing.comparison import slice_check
from tacbench_cad.extensions.slicing.printers import printers
from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.lab.acquire.study_file import read_study
from tacbench_cad.lab.analysis.classification.score import score
from tacbench_cad.lab.analysis.classification.split_files import make_splits, read_split, write_split
from tacbench_cad.lab.rig.calibration import CalibrationPoint, fit, read_calibration, write_calibration
from tacbench_cad.lab.runs import press_table
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.printrecord import form, read_record
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.plate import read_layout
from tacbench_cad.making.choice import described
from tacbench_cad.making.manifest import read_rows, unchanged, write_manifest
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid

TEXTURE = """# a texture
[texture]
name = "hex"
family = "plane-waves"

[[wave]]
amplitude = 0.5
f = 1.0
g = 0.5
phase = 0.1

[[wave]]
amplitude = 0.25
f = 2.0
g = -0.5

[block]
height_mm = 7.0
mm_per_unit = [1.6, 1.6, 1.0]
domain = [[0, 19], [0, 25]]
"""
SERIES = '[texture]\nname = "saw"\nfamily = "series"\nlaw = "triangle"\nN = 25\nterms = "highest"\naxes = "xy"\n'
PRINTERS = '[printer.mine]\nbed_mm = [200, 210]\nheight_mm = 180\nkeep_out_mm = [[0, 0, 20, 30]]\nfilaments = ["pla"]\n'


LAYOUT = "plate,label,texture,preset,scale,key_mm,copy,printer,filament,x_mm,y_mm\n" + (
    "1,4 PAPER,4,paper,1,3,1,ender-3,pla-plus,5.000,6.000\n" * 3
)
RECORD = form("A print", printer="ender-3", filament="pla-plus").replace('nozzle_mm = ""', "nozzle_mm = 0.4")
ASCII_STL = "\n".join(
    [
        "solid box",
        *(
            "facet normal 0 0 0\n outer loop\n"
            + "".join("  vertex {:g} {:g} {:g}\n".format(*corner) for corner in triangle.tolist())
            + " endloop\nendfacet"
            for triangle in box_mesh().triangle_points
        ),
        "endsolid box\n",
    ]
)
SMALL = Block.of(2, scale=0.3)


def make_run(folder: Path, **options: Any) -> None:
    """Write one run, whose files lie in the folder itself."""
    prints = (("ender-3", "pla-plus"),)
    write_study(folder / "study", textures=(4,), prints=prints, copies=1, still=1, **options)
    (run,) = (folder / "study").iterdir()
    for path in run.iterdir():
        path.rename(folder / path.name)
    shutil.rmtree(folder / "study")


def make_taxel_run(folder: Path) -> None:
    def taxels(printed: Any, press: Any, rng: np.random.Generator) -> Any:
        return rng.normal(size=(4, 4))

    make_run(folder, image=taxels, shape=(4, 4))


def read_run(folder: Path) -> object:
    report, run = check_run(folder), Run.open(folder)
    return sorted((finding.kind, finding.where) for finding in report.findings), run.info.differences(run.info)


def make_split(folder: Path) -> None:
    write_study(folder / "runs", copies=2, still=1)
    split = next(split for split in make_splits(press_table.read(folder / "runs"), seed=3, folds=2)[0])
    write_split(folder / "split.json", split)
    with (folder / "predictions.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["fold", "run", "force_level", "repeat", "position", "predicted"])
        for fold in split.folds:
            rows.writerows([fold.name, *split.presses[i][:4], split.presses[i].texture] for i in fold.test)
    shutil.rmtree(folder / "runs")


def read_predictions(folder: Path) -> object:
    return score(folder / "predictions.csv", read_split(folder / "split.json")).table.to_csv()


def make_calibration(folder: Path) -> None:
    points = [
        CalibrationPoint(mass_g=m, counts=1000.0 + 80.0 * m, spread_counts=2.0, samples=50) for m in (0, 100, 200)
    ]
    write_calibration(folder / "cell.json", fit(points, date_utc="2026-01-31T12:00:00+00:00", device="/dev/ttyUSB0"))


def make_block(folder: Path, form: str) -> None:
    part = block_part(Block.of(2, sampling=SampleGrid(nx=12, ny=13)))
    FORMATS[form].write(part, folder / f"block.{form}")


def make_step(folder: Path) -> None:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder

    from tacbench_cad.formats.step import write_shape

    write_shape(BRepPrimAPI_MakeCylinder(10.0, 5.0).Shape(), "part", "A part", folder / "block.step")


def make_manifest(folder: Path) -> None:
    row = {"file": "a.stl", "sha256": "0" * 64, "size_mm": [1.0, 2.0, 3.0], "checks": [{"name": "x", "ok": True}]}
    write_manifest(folder, [row])


def read_texture(folder: Path) -> object:
    return [block.name for block in described((str(folder / "file.toml"),), "paper", 1.0)]


def read_part(folder: Path) -> object:
    (path,) = folder.glob("block.*")
    return examine(path, full=path.suffix != ".3mf").as_dict()


#: Every kind of file that users supply.
KINDS: dict[str, Kind] = {
    "texture": Kind("file.toml", writer("file.toml", TEXTURE), read_texture, HARMLESS_IN_TOML),
    "series": Kind("file.toml", writer("file.toml", SERIES), read_texture, HARMLESS_IN_TOML),
    "printers": Kind(
        "file.toml",
        writer("file.toml", PRINTERS),
        lambda folder: list(printers(folder / "file.toml")),
        HARMLESS_IN_TOML,
    ),
    "record": Kind(
        "print.toml",
        writer("print.toml", RECORD.replace('peaks_score = ""', "peaks_score = 2")),
        lambda folder: len(read_record(folder / "print.toml").values),
        (windows, marked),
    ),
    "study": Kind(
        "study.toml",
        writer("study.toml", STUDY),
        lambda folder: len(read_study(folder / "study.toml").study.blocks),
        HARMLESS_IN_TOML,
    ),
    "layout": Kind(
        "layout.csv",
        writer("layout.csv", LAYOUT),
        lambda folder: len(read_layout(folder / "layout.csv")),
        (marked,),
    ),
    "run": Kind("run.json", make_run, read_run, (windows, indented)),
    "targets": Kind("targets.csv", make_run, read_run, (windows, marked)),
    "png": Kind("sensor_images/image_2.png", make_run, read_run),
    "npy": Kind("sensor_data/reading_2.npy", make_taxel_run, read_run),
    "split": Kind(
        "split.json",
        make_split,
        lambda folder: len(read_split(folder / "split.json").presses),
        (windows, indented),
    ),
    "predictions": Kind("predictions.csv", make_split, read_predictions, (marked,)),
    "calibration": Kind(
        "cell.json",
        make_calibration,
        lambda folder: read_calibration(folder / "cell.json").device,
        (windows, indented),
    ),
    "manifest": Kind("manifest.json", make_manifest, lambda folder: unchanged(folder, read_rows(folder)), (windows,)),
    "stl": Kind("block.stl", lambda folder: make_block(folder, "stl"), read_part),
    "ascii stl": Kind("block.stl", writer("block.stl", ASCII_STL), read_part, (windows,)),
    "3mf": Kind("block.3mf", lambda folder: make_block(folder, "3mf"), read_part),
    "step": Kind("block.step", make_step, read_part, (windows,)),
    "gcode": Kind(
        "block.gcode",
        lambda folder: write_gcode(folder / "block.gcode", SMALL, layer_mm=0.3),
        lambda folder: slice_check(folder / "block.gcode", SMALL).as_dict(),
        (windows,),
    ),
    **IMPORT_KINDS,
    **SCAN_KINDS,
}


def read(name: str, folder: Path) -> object:
    """Return the result of a kind's reader for a folder."""
    return KINDS[name].read(folder)
