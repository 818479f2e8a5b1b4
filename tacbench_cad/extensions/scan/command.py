"""``tacbench scan``: compare the scan of a print with its formula."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from tacbench_cad.cli import (
    ProgressLine,
    next_block,
    note,
    options,
    print_json,
    print_lines,
    print_next,
    print_table,
    write_picture,
)
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.extensions.scan.reading import ScanFile
    from tacbench_cad.extensions.scan.result import PrintOrigin, ScanResult
    from tacbench_cad.lab.runs import Run
    from tacbench_cad.spec import Block

#: Seconds between two lines of progress without a terminal. A scan takes a few seconds.
_EVERY_S = 2.0
#: The simulated print of ``--simulate``: its scale, and the wavelengths along x and y that lose half of their height.
_SCALE, _HALF_MM = 0.996, (0.9, 1.2)


@options.command("scan", "Print")
@options.argument("file", options.file("FILE"), "Scan: a mesh, a point cloud or a height map.", required=False)
@options.option(
    "--block",
    options.text("BLOCK", complete=options.TEXTURE.complete),
    "The block: a texture (1 to 6, a name, a TOML file), the words of its label ('T4 PAPER X1 02'), the name of its "
    "file, the folder of its print set, or its run folder. Default: the six textures are tried.",
    options.PARTS,
)
@options.preset
@options.key
@options.scale
@options.option(
    "--unit", options.choice("um", "mm", "m", "inch"), "Unit of the file, if the file has none.", options.INPUT
)
@options.option("--mm-per-pixel", options.MM, "Distance of neighbouring pixels of a height map.", options.INPUT)
@options.option(
    "--repeat",
    options.file("FILE"),
    "A second scan of the same print, from which the noise of the scanner is computed.",
    options.INPUT,
)
@options.option("--flat", options.file("FILE"), "A scan of a flat plate, for the same purpose.", options.INPUT)
@options.option(
    "--printed-from",
    options.file("FILE.toml"),
    "Texture file that was printed, if it is not that of the block, for example a corrected one. Default: from the run "
    "folder.",
    options.PARTS,
)
@options.option("--printer", options.text("NAME"), "Printer. Default: from the run folder.", options.PRINTER)
@options.option("--filament", options.text("NAME"), "Filament. Default: from the run folder.", options.PRINTER)
@options.option("--copy", options.COUNT, "Number of the copy. Default: from the label.", options.PRINTER)
@options.option(
    "--layer",
    options.MM,
    "Height of a layer: a crest that is lower by more counts as lost. Default: from print.toml or the G-code, "
    "otherwise 0.2.",
    options.PRINTER,
    dest="layer_mm",
)
@options.option(
    "--fit",
    options.choice("pose", "scale", "square"),
    "What is fitted: only the pose; also the scales along x, y and z; also the skew.",
    options.METHOD,
    default="scale",
)
@options.option(
    "--limits",
    options.words("LIST", suffix=".toml"),
    "Limits of the verdict: NAME=VALUE,... or a TOML file. Default: what a TacTip feels, and the clearance of the "
    "holder.",
    options.METHOD,
)
@options.option(
    "--compare",
    options.file("FILE.gcode"),
    "G-code of the print: show formula, as sliced and as scanned side by side.",
    options.METHOD,
)
@options.option(
    "--simulate",
    options.file("FILE.ply"),
    "Write a simulated scan of the block instead, to try the command without a scanner.",
    options.METHOD,
)
@options.out("DIR", "Folder of the results. Default: NAME_scan in the working folder.")
@options.flag("--no-picture", "Write no pictures.", options.OUTPUT)
@options.json
def command(
    file: Path | None,
    block: str | None,
    preset: str,
    scale: float,
    key_mm: float | None,
    simulate: Path | None,
    printed_from: Path | None,
    out: Path | None,
    no_picture: bool,
    json: bool,
    **values: Any,
) -> None:
    """Compare the scan of a print with its formula.

    The command reads meshes (STL, PLY, OBJ, 3MF), point clouds (XYZ, PLY, LAS) and height maps (TIFF, NPY, CSV, and
    files of instruments that the package surfalize reads). It finds how the scan lies on the block, and writes:
    - the deviation from the formula, as a picture, a table and coloured points
    - shrinkage and skew, with intervals
    - how much of each wave was printed, with intervals
    - lost crests, filled valleys, and the roughness
    - how far the deviation moves the pins of a TacTip

    One line says whether the print is within the limits; if it is not, the exit code is 1. If --block is a run
    folder, scan.json is also written there, beside print.toml, and the report shows it.

    Examples:
      tacbench scan --simulate scan.ply --block 4       # without a scanner
      tacbench scan scan.ply --block 4
      tacbench scan top.npy --unit um --mm-per-pixel 0.02 --block 4
      tacbench scan top.stl --unit mm --block 'T4 PAPER X1 02'
      tacbench scan scan.ply --block stl_out --limits top_rms_mm=0.05
      tacbench scan scan.ply --block 4 --compare texture-4.gcode
    """
    from tacbench_cad.lab.study import block_in_file
    from tacbench_cad.util.files import locked

    blocks, origin, run = _blocks(block, preset, scale, key_mm)
    if len(blocks) > 1 and (printed_from is not None or (simulate is not None and block is not None)):
        allowed = "must be a single one with --simulate and --printed-from; name one block, for example 4"
        raise InputError("block", block, allowed)
    in_file = blocks[0] if printed_from is None else block_in_file(blocks[0], printed_from)
    if simulate is not None:
        if file is not None:
            raise InputError("simulate", str(simulate), f"writes a scan and reads none; leave out {file}")
        _simulate(in_file, simulate, values["copy"])
        named = [] if block is None else ["--block", block]
        named += [] if printed_from is None else ["--printed-from", str(printed_from)]
        print_next("scan", simulate, *named, *next_block(("all",), preset, scale, key_mm))
        return
    if file is None:
        raise InputError("file", None, "name a scan, or write a simulated scan with --simulate FILE.ply")
    if printed_from is not None:
        origin = replace(origin, printed_from=in_file.name)
    folder = out if out is not None else Path(f"{file.stem}_scan")
    with locked(folder):
        result = _result(file, blocks, origin, run, values)
        paths = _write(result, folder, run, no_picture)
    if json:
        print_json(result.as_dict() | {"folder": str(folder), "files": [str(path) for path in paths]})
    else:
        _show(result)
        note(f"wrote {', '.join(path.name for path in paths)} to {folder}")
        if run is not None:
            note(f"wrote scan.json to {run.folder}")
        print_lines(str(result.verdict))
        if result.origin.printed_from is None:
            print_next("printer-model", folder, "-o", "my-printer.toml")
    if not result.verdict.ok:
        raise Exit(1)


def _blocks(
    word: str | None, preset: str, scale: float, key_mm: float | None
) -> tuple[list[Block], PrintOrigin, Run | None]:
    """Return the possible blocks, what is known about the print, and the run if the user named its folder."""
    from tacbench_cad.extensions.scan.result import PrintOrigin
    from tacbench_cad.making import blocks_named
    from tacbench_cad.spec import is_texture_name

    if word is None or is_texture_name(word) or not (Path(word) / "run.json").is_file():
        blocks = blocks_named(word, preset, scale, key_mm)
        return blocks, PrintOrigin(copy=blocks[0].copy if len(blocks) == 1 else None), None
    from tacbench_cad.lab.runs import Run
    from tacbench_cad.lab.study import PrintedBlock

    run = Run.open(Path(word))
    printed = run.info.printed
    if printed.block is None:
        raise InputError("block", word, "is an imported run without a formula; name the texture instead")
    file = printed.file if isinstance(printed, PrintedBlock) else None
    origin = PrintOrigin(
        printer=printed.printer,
        filament=printed.filament,
        copy=printed.copy,
        nozzle_mm=run.print_record.values.get("nozzle_mm"),
        printed_from=None if file is None else file.name,
    )
    return [printed.block], origin, run


def _result(
    file: Path, blocks: list[Block], origin: PrintOrigin, run: Run | None, values: Mapping[str, Any]
) -> ScanResult:
    from tacbench_cad.extensions.scan.analysing import LAYER_MM, ScanOptions, analyse
    from tacbench_cad.extensions.scan.comparison import Views
    from tacbench_cad.extensions.scan.limits import limits_of
    from tacbench_cad.extensions.scan.reading import read_scan
    from tacbench_cad.extensions.slicing.comparison import compare
    from tacbench_cad.extensions.slicing.gcode import read_gcode
    from tacbench_cad.lab.study import own_name
    from tacbench_cad.util.files import existing_file

    given = {name: values[name] for name in ("printer", "filament", "copy") if values[name] is not None}
    for name in given.keys() - {"copy"}:
        given[name] = own_name(name, given[name])
    sliced = None if values["compare"] is None else read_gcode(values["compare"])
    recorded = None if run is None else run.print_record.values.get("layer_height_mm")
    layers = (values["layer_mm"], recorded, None if sliced is None else sliced.layer_mm, LAYER_MM)
    layer = next(mm for mm in layers if mm is not None)
    require_between("layer", layer, 0.001, 10.0, " mm")
    limits = limits_of(values["limits"] or ())
    sizes = {(*block.size_mm, block.height_mm) for block in blocks}
    size = sizes.pop() if len(sizes) == 1 else None
    unit, pixel_mm = values["unit"], values["mm_per_pixel"]
    with ProgressLine(_EVERY_S) as line:

        def progress(step: str, fraction: float = 0.0) -> None:
            line.show(step, round(100.0 * fraction), 100)

        def read(path: Path, size_mm: tuple[float, float, float] | None) -> ScanFile:
            progress(f"reading {path.name}")
            return read_scan(existing_file(path), unit=unit, mm_per_pixel=pixel_mm, size_mm=size_mm)

        scan = read(file, size)
        if scan.kind != "height map" and pixel_mm is not None:
            raise InputError("--mm-per-pixel", pixel_mm, f"{file} is not a height map; leave out the option")
        left_out = f"Without a valid value and left out: {counted(scan.dropped, 'point')}."
        options = ScanOptions(
            fit=values["fit"],
            layer_mm=layer,
            limits=limits,
            origin=replace(origin, **given),
            repeat=None if values["repeat"] is None else read(values["repeat"], size).cloud,
            flat=None if values["flat"] is None else read(values["flat"], None).cloud,
            notes=(*scan.notes, *([left_out] if scan.dropped else [])),
        )
        result = analyse(scan.cloud, blocks, options, progress)
        if sliced is None:
            return result
        progress("computing the sliced surface")
        as_sliced = compare(sliced, result.block, pitch_mm=result.top.cell_mm)
        printed = {"as sliced": as_sliced.printed_mm, "as scanned": result.top.printed_mm}
        return replace(result, comparison=Views(top=result.top, printed_mm=printed, simulated=result.cloud.simulated))


def _write(result: ScanResult, folder: Path, run: Run | None, no_picture: bool) -> list[Path]:
    from tacbench_cad.extensions.scan.record import SCAN_FILE
    from tacbench_cad.extensions.scan.result_files import write_result
    from tacbench_cad.extensions.scan.scan_pictures import comparison_picture, deviation_picture, waves_picture
    from tacbench_cad.util.files import refusing, write_json

    has_waves, views = any(wave.determined for wave in result.fit.waves), result.comparison
    drawings = {
        "deviation.png": partial(deviation_picture, result),
        "waves.png": partial(waves_picture, result) if has_waves else None,
        "comparison.png": None if views is None else partial(comparison_picture, views),
    }
    with refusing(folder):
        for name in drawings:  # a picture of an earlier scan must not stay beside the new numbers
            (folder / name).unlink(missing_ok=True)
    paths = write_result(result, folder)
    if run is not None:
        write_json(run.folder / SCAN_FILE, result.as_dict())
    wanted = {} if no_picture else {folder / name: draw for name, draw in drawings.items() if draw is not None}
    return paths + [path for path, draw in wanted.items() if write_picture(path, draw)]


def _show(result: ScanResult) -> None:
    from tacbench_cad.extensions.scan.result import described, wave_table

    print_table(described(result), ("", ">value", "interval or remark"), result.rows())
    if result.fit.waves:
        heads = (">wavelength (mm)", ">direction (degrees)", ">formula (µm)", ">printed / formula", ">95 % interval")
        print_table("printed waves", (*heads, ">phase (degrees)", ">95 % interval"), wave_table(result.fit.waves))
    if (views := result.comparison) is not None:
        print_table("three views (formula: 0)", ("", *(f">{name}" for name in views.printed_mm)), views.rows())
    for filters in dict.fromkeys(parameters["filters"] for parameters in result.roughness.values()):
        print_lines(f"ISO 25178: {filters}")
    for sentence in result.notes:
        note(f"note: {sentence}")


def _simulate(block: Block, path: Path, copy: int | None) -> None:
    """Write a simulated scan of a print of a block. Each copy has its own pose and noise."""
    from tacbench_cad.extensions.scan.result_files import write_simulated
    from tacbench_cad.extensions.scan.simulating import ScanTruth, low_pass, simulate_scan, stretch

    if path.suffix.lower() != ".ply":
        raise InputError("simulate", str(path), "must end in .ply")
    truth = ScanTruth(
        transfer_x=low_pass(_HALF_MM[0]),
        transfer_y=low_pass(_HALF_MM[1]),
        outlier_fraction=0.01,
        walls=("x-", "x+", "y-", "y+") if block.outline is None else (),
        seed=copy or block.copy or 0,
    ).with_random_pose()
    truth = replace(truth, pose=replace(truth.pose, stretch=stretch((_SCALE, _SCALE, 1.0))))
    cloud = simulate_scan(block, truth)
    write_simulated(cloud, path)
    x, y = _HALF_MM
    note(f"wrote {path}: a simulated scan of {block.name}, {len(cloud):,} points with 0.02 mm of noise")
    note(
        f"the simulated printer shrinks {100.0 * (1.0 - _SCALE):.1f} % along x and y, and halves the amplitude of "
        f"waves of {x:g} mm along x and {y:g} mm along y"
    )
