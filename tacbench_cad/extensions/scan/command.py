"""``tacbench scan``: compare the scan of a print with its formula."""

from __future__ import annotations

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
from tacbench_cad.extensions.scan.record import SCAN_FILE
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.files import locked, refusing, write_json
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.extensions.scan.comparison import Views
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
    limits: tuple[str, ...] | None,
    compare: Path | None,
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
    blocks, origin, run = _blocks(block, preset, scale, key_mm)
    if simulate is not None:
        if file is not None:
            raise InputError("simulate", str(simulate), f"writes a scan and reads none; leave out {file}")
        if block is not None and len(blocks) > 1:
            raise InputError("block", block, "means several blocks, but one is simulated; name one, for example 4")
        _simulate(blocks[0] if printed_from is None else _file_of(blocks[0], printed_from), simulate, values["copy"])
        named = [] if block is None else ["--block", block]
        named += [] if printed_from is None else ["--printed-from", str(printed_from)]
        print_next("scan", simulate, *named, *next_block(("all",), preset, scale, key_mm))
        return
    if printed_from is not None:
        if len(blocks) > 1:
            raise InputError("printed-from", str(printed_from), "needs the block of the print; name it by --block")
        origin = replace(origin, printed_from=_file_of(blocks[0], printed_from).name)
    from tacbench_cad.extensions.scan.result_files import document_of

    if file is None:
        raise InputError("file", None, "name a scan, or write a simulated scan with --simulate FILE.ply")
    folder = out if out is not None else Path(f"{file.stem}_scan")
    with locked(folder):
        result, views = _result(file, blocks, limits, compare, origin, run, values)
        paths = _write(result, views, folder, run, no_picture)
    if json:
        print_json(document_of(result, views) | {"folder": str(folder), "files": [str(path) for path in paths]})
    else:
        _show(result, views)
        note(f"wrote {', '.join(path.name for path in paths)} to {folder}")
        if run is not None:
            note(f"wrote {run.folder / SCAN_FILE}")
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

    if word is not None and not is_texture_name(word) and (Path(word) / "run.json").is_file():
        from tacbench_cad.lab.runs import Run
        from tacbench_cad.lab.study import PrintedBlock

        opened = Run.open(Path(word))
        printed = opened.info.printed
        if printed.block is None:
            raise InputError("block", word, "is an imported run without a formula; name the texture instead")
        record = opened.print_record.values
        nozzle = record.get("nozzle_mm")
        file = printed.file if isinstance(printed, PrintedBlock) else None
        origin = PrintOrigin(
            printer=printed.printer,
            filament=printed.filament,
            copy=printed.copy,
            nozzle_mm=nozzle,
            printed_from=None if file is None else file.name,
        )
        return [printed.block], origin, opened
    blocks = blocks_named(word, preset, scale, key_mm)
    return blocks, PrintOrigin(copy=blocks[0].copy if len(blocks) == 1 else None), None


def _file_of(block: Block, path: Path) -> Block:
    """Return a block as it is in the file that was printed."""
    from tacbench_cad.lab.study import block_in_file

    return block_in_file(block, path)


def _result(
    file: Path,
    blocks: list[Block],
    limits: tuple[str, ...] | None,
    compare: Path | None,
    origin: PrintOrigin,
    run: Run | None,
    values: dict[str, Any],
) -> tuple[ScanResult, Views | None]:
    from tacbench_cad.extensions.scan.analysing import LAYER_MM, ScanOptions, analyse
    from tacbench_cad.extensions.scan.limits import limits_of
    from tacbench_cad.extensions.slicing.gcode import read_gcode
    from tacbench_cad.lab.study import own_name

    given: dict[str, Any] = {
        name: own_name(name, values[name]) for name in ("printer", "filament") if values[name] is not None
    }
    if values["copy"] is not None:
        given["copy"] = values["copy"]
    sliced = None if compare is None else read_gcode(compare)
    recorded = None if run is None else run.print_record.values.get("layer_height_mm")
    layers = (values["layer_mm"], recorded, None if sliced is None else sliced.layer_mm, LAYER_MM)
    layer = next(mm for mm in layers if mm is not None)
    require_between("layer", layer, 0.001, 10.0, " mm")
    chosen = ScanOptions(
        fit=values["fit"], layer_mm=layer, limits=limits_of(limits or ()), origin=replace(origin, **given)
    )
    with ProgressLine(_EVERY_S) as line:

        def progress(step: str, fraction: float) -> None:
            line.show(step, round(100.0 * fraction), 100)

        def read(path: Path, size_mm: tuple[float, float, float] | None) -> ScanFile:
            from tacbench_cad.extensions.scan.reading import read_scan
            from tacbench_cad.util.files import existing_file

            progress(f"reading {path.name}", 0.0)
            unit, pixel = values["unit"], values["mm_per_pixel"]
            return read_scan(existing_file(path), unit=unit, mm_per_pixel=pixel, size_mm=size_mm)

        sizes = {(*block.size_mm, block.height_mm) for block in blocks}
        size = sizes.pop() if len(sizes) == 1 else None
        scan = read(file, size)
        if scan.kind != "height map" and (pixel := values["mm_per_pixel"]) is not None:
            raise InputError("--mm-per-pixel", pixel, f"{file} is not a height map; leave out the option")
        left_out = f"Without a valid value and left out: {counted(scan.dropped, 'point')}."
        repeat, flat = values["repeat"], values["flat"]
        chosen = replace(
            chosen,
            notes=(*scan.notes, *([left_out] if scan.dropped else [])),
            repeat=None if repeat is None else read(repeat, size).cloud,
            flat=None if flat is None else read(flat, None).cloud,
        )
        result = analyse(scan.cloud, blocks, chosen, progress)
        if sliced is None:
            return result, None
        progress("computing the sliced surface", 0.0)
        return result, _views(result, sliced)


def _views(result: ScanResult, sliced: Any) -> Views:
    from tacbench_cad.extensions.scan.comparison import ComparisonView, Views
    from tacbench_cad.extensions.slicing.comparison import compare

    top = result.top
    as_sliced = compare(sliced, result.block, pitch_mm=top.cell_mm)
    heights = {"as sliced": as_sliced.printed_mm, "as scanned": top.printed_mm}
    return Views(
        block=result.block,
        x_mm=top.x_mm,
        y_mm=top.y_mm,
        formula_mm=top.formula_mm,
        views=[ComparisonView(name=name, heights_mm=surface) for name, surface in heights.items()],
        layer_mm=top.layer_mm,
        simulated=result.cloud.simulated,
    )


def _write(result: ScanResult, views: Views | None, folder: Path, run: Run | None, no_picture: bool) -> list[Path]:
    from tacbench_cad.extensions.scan.result_files import document_of, write_result
    from tacbench_cad.extensions.scan.scan_pictures import comparison_picture, deviation_picture, waves_picture

    drawings = {
        "deviation.png": partial(deviation_picture, result),
        "waves.png": partial(waves_picture, result) if any(wave.determined for wave in result.fit.waves) else None,
        "comparison.png": None if views is None else partial(comparison_picture, views),
    }
    with refusing(folder):
        for name in drawings:  # a picture of an earlier scan must not stay beside the new numbers
            (folder / name).unlink(missing_ok=True)
    paths = write_result(result, folder, views)
    if run is not None:
        write_json(run.folder / SCAN_FILE, document_of(result, views))
    wanted = {} if no_picture else {folder / name: draw for name, draw in drawings.items() if draw is not None}
    return paths + [path for path, draw in wanted.items() if write_picture(path, draw)]


def _show(result: ScanResult, views: Views | None) -> None:
    from tacbench_cad.extensions.scan.result import described, wave_table

    print_table(described(result), ("", ">value", "interval or remark"), result.rows())
    if result.fit.waves:
        heads = (">wavelength (mm)", ">direction (degrees)", ">formula (µm)", ">printed / formula", ">95 % interval")
        print_table("printed waves", (*heads, ">phase (degrees)", ">95 % interval"), wave_table(result.fit.waves))
    if views is not None:
        print_table("three views (formula: 0)", ("", *(f">{view.name}" for view in views.views)), views.rows())
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
