"""A valid file of each kind that users supply, and its reader; ``tests/hostile/test_mutations.py`` damages them."""

from __future__ import annotations

import csv
import io
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from helpers.import_kinds import IMPORT_KINDS
from helpers.mutations import HARMLESS_IN_TOML, Kind, indented, marked, windows, writer
from helpers.scan_kinds import SCAN_KINDS

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


def read_texture_file(folder: Path) -> object:
    from tacbench_cad.making.choice import described

    return [block.name for block in described((str(folder / "file.toml"),), "paper", 1.0)]


def read_printers_file(folder: Path) -> object:
    from tacbench_cad.extensions.slicing.printers import printers

    return list(printers(folder / "file.toml"))


def make_record(folder: Path) -> None:
    from tacbench_cad.spec.printrecord import form

    text = form("A print", "ender-3", "pla-plus").replace('nozzle_mm = ""', "nozzle_mm = 0.4")
    (folder / "print.toml").write_text(text.replace('peaks_score = ""', "peaks_score = 2"))


def read_record_file(folder: Path) -> object:
    from tacbench_cad.spec.printrecord import read_record

    return len(read_record(folder / "print.toml").values)


def make_study(folder: Path) -> None:
    from helpers.small_study import STUDY

    (folder / "study.toml").write_text(STUDY)


def read_study_file(folder: Path) -> object:
    from tacbench_cad.lab.study.file import read_study

    file = read_study(folder / "study.toml")
    return len(file.study.blocks)


def make_layout(folder: Path) -> None:
    rows = [["plate", "label", "texture", "preset", "scale", "key_mm", "copy", "printer", "filament", "x_mm", "y_mm"]]
    rows += [["1", "4 PAPER", "4", "paper", "1", "3", "1", "ender-3", "pla-plus", "5.000", "6.000"]] * 3
    with (folder / "layout.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)


def read_layout_file(folder: Path) -> object:
    from tacbench_cad.lab.study.plate import read_layout

    return len(read_layout(folder / "layout.csv"))


def make_run(folder: Path) -> None:
    from helpers.studies import write_study

    write_study(folder / "study", textures=(4,), prints=(("ender-3", "pla-plus"),), copies=1, still=1)
    (run,) = (folder / "study").iterdir()
    for path in run.iterdir():
        path.rename(folder / path.name)
    run.rmdir()
    (folder / "study").rmdir()


def make_taxel_run(folder: Path) -> None:
    from helpers.studies import write_study

    def taxels(printed: Any, press: Any, rng: np.random.Generator) -> Any:
        return rng.normal(size=(4, 4))

    write_study(
        folder / "study",
        textures=(4,),
        prints=(("ender-3", "pla-plus"),),
        copies=1,
        still=1,
        image=taxels,
        shape=(4, 4),
    )
    (run,) = (folder / "study").iterdir()
    for path in run.iterdir():
        path.rename(folder / path.name)


def read_run_folder(folder: Path) -> object:
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.lab.runs.reading import Run

    report = check_run(folder)
    run = Run.open(folder)
    return sorted((finding.kind, finding.where) for finding in report.findings), run.info.differences(run.info)


def make_split(folder: Path) -> None:
    from helpers.studies import write_study
    from tacbench_cad.lab.analysis.classification.split_files import make_splits, write_split
    from tacbench_cad.lab.analysis.collection import Collection

    write_study(folder / "runs", copies=2, still=1)
    split = next(split for split in make_splits(Collection.open([folder / "runs"]), seed=3, folds=2)[0])
    write_split(folder / "split.json", split)
    with (folder / "predictions.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["fold", "run", "force_level", "repeat", "position", "predicted"])
        for fold in split.folds:
            for i in fold.test:
                press = split.presses[i]
                writer.writerow([fold.name, *press.key, press.texture])
    shutil.rmtree(folder / "runs")


def read_split_file(folder: Path) -> object:
    from tacbench_cad.lab.analysis.classification.split_files import read_split

    return len(read_split(folder / "split.json").presses)


def read_predictions(folder: Path) -> object:
    from tacbench_cad.lab.analysis.classification.score import score
    from tacbench_cad.lab.analysis.classification.split_files import read_split

    return str(score(folder / "predictions.csv", read_split(folder / "split.json")).accuracy)


def make_calibration(folder: Path) -> None:
    from tacbench_cad.lab.rig.calibration import CalibrationPoint, fit, write_calibration

    points = [
        CalibrationPoint(mass_g=m, counts=1000.0 + 80.0 * m, spread_counts=2.0, samples=50) for m in (0, 100, 200)
    ]
    write_calibration(folder / "cell.json", fit(points, date_utc="2026-01-31T12:00:00+00:00", device="/dev/ttyUSB0"))


def read_calibration_file(folder: Path) -> object:
    from tacbench_cad.lab.rig.calibration import read_calibration

    return read_calibration(folder / "cell.json").device


def _small_block() -> Any:
    from tacbench_cad.spec.block import Block
    from tacbench_cad.spec.sampling import SampleGrid

    return Block.of(2, "paper", sampling=SampleGrid(nx=12, ny=13))


def make_stl(folder: Path) -> None:
    from tacbench_cad.formats.stl import write_stl
    from tacbench_cad.geometry.block_part import block_part

    write_stl(block_part(_small_block()), folder / "block.stl")


def make_ascii_stl(folder: Path) -> None:
    from helpers.shapes import box_mesh

    text = io.StringIO("solid box\n")
    text.seek(0, 2)
    for triangle in box_mesh().triangle_points:
        text.write("facet normal 0 0 0\n outer loop\n")
        for corner in triangle.tolist():
            text.write("  vertex {:g} {:g} {:g}\n".format(*corner))
        text.write(" endloop\nendfacet\n")
    (folder / "block.stl").write_text(text.getvalue() + "endsolid box\n")


def make_3mf(folder: Path) -> None:
    from tacbench_cad.formats.threemf import write_3mf
    from tacbench_cad.geometry.block_part import block_part

    write_3mf(block_part(_small_block()), folder / "block.3mf")


def make_step(folder: Path) -> None:
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder

    from tacbench_cad.formats.step import write_shape

    write_shape(BRepPrimAPI_MakeCylinder(10.0, 5.0).Shape(), "part", "A part", folder / "block.step")


def read_stl_file(folder: Path) -> object:
    from tacbench_cad.checks.identify import examine

    return examine(folder / "block.stl").as_dict()


def read_3mf_file(folder: Path) -> object:
    from tacbench_cad.checks.identify import examine

    return examine(folder / "block.3mf", full=False).as_dict()


def read_step_file(folder: Path) -> object:
    from tacbench_cad.checks.identify import examine

    return examine(folder / "block.step").as_dict()


def make_gcode(folder: Path) -> None:
    from helpers.gcode_writer import write_gcode
    from tacbench_cad.spec.block import Block

    write_gcode(folder / "block.gcode", Block.of(2, scale=0.3), layer_mm=0.3)


def read_gcode_file(folder: Path) -> object:
    from tacbench_cad.extensions.slicing.comparison import slice_check
    from tacbench_cad.spec.block import Block

    return slice_check(folder / "block.gcode", Block.of(2, scale=0.3)).as_dict()


def make_manifest(folder: Path) -> None:
    row = {"file": "a.stl", "sha256": "0" * 64, "size_mm": [1.0, 2.0, 3.0], "checks": [{"name": "x", "ok": True}]}
    from tacbench_cad.making.manifest import write_manifest

    write_manifest(folder, [row])


def read_manifest_file(folder: Path) -> object:
    from tacbench_cad.making.manifest import read_rows, unchanged

    return unchanged(folder, read_rows(folder))


#: Every kind of file that users supply.
KINDS: dict[str, Kind] = {
    "texture": Kind("file.toml", writer("file.toml", TEXTURE), read_texture_file, HARMLESS_IN_TOML),
    "series": Kind("file.toml", writer("file.toml", SERIES), read_texture_file, HARMLESS_IN_TOML),
    "printers": Kind("file.toml", writer("file.toml", PRINTERS), read_printers_file, HARMLESS_IN_TOML),
    "record": Kind("print.toml", make_record, read_record_file, (windows, marked)),
    "study": Kind("study.toml", make_study, read_study_file, HARMLESS_IN_TOML),
    "layout": Kind("layout.csv", make_layout, read_layout_file, (marked,)),
    "run": Kind("run.json", make_run, read_run_folder, (windows, indented)),
    "targets": Kind("targets.csv", make_run, read_run_folder, (windows, marked)),
    "png": Kind("sensor_images/image_2.png", make_run, read_run_folder),
    "npy": Kind("sensor_data/reading_2.npy", make_taxel_run, read_run_folder),
    "split": Kind("split.json", make_split, read_split_file, (windows, indented)),
    "predictions": Kind("predictions.csv", make_split, read_predictions, (marked,)),
    "calibration": Kind("cell.json", make_calibration, read_calibration_file, (windows, indented)),
    "manifest": Kind("manifest.json", make_manifest, read_manifest_file, (windows,)),
    "stl": Kind("block.stl", make_stl, read_stl_file),
    "ascii stl": Kind("block.stl", make_ascii_stl, read_stl_file, (windows,)),
    "3mf": Kind("block.3mf", make_3mf, read_3mf_file),
    "step": Kind("block.step", make_step, read_step_file, (windows,)),
    "gcode": Kind("block.gcode", make_gcode, read_gcode_file, (windows,)),
    **IMPORT_KINDS,
    **SCAN_KINDS,
}


def read(name: str, folder: Path) -> object:
    """Return the result of a kind's reader for a folder."""
    return KINDS[name].read(folder)
