"""``tacbench check-gcode``: check how accurately a slicer's G-code prints a texture."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.cli import next_block, note, options, print_json, print_next, print_table, write_picture
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.extensions.slicing.comparison import AsSliced
    from tacbench_cad.extensions.slicing.printed_surface import BedPlace
    from tacbench_cad.spec import Block, Extrema


def _frame_of(option: str, text: str) -> BedPlace:
    from tacbench_cad.extensions.slicing.printed_surface import BedPlace

    try:
        numbers = options.numbers_of(option, text)
    except InputError:
        numbers = ()
    if len(numbers) not in (2, 3):
        raise InputError(option, text, "must be X,Y or X,Y,DEGREES: numbers such as 88.35, separated by commas")
    degrees = numbers[2] if len(numbers) == 3 else 0.0
    if degrees not in (0.0, 90.0, 180.0, 270.0):
        raise InputError(option, text, "the rotation must be 0, 90, 180 or 270 degrees")
    return BedPlace(x_mm=numbers[0], y_mm=numbers[1], quarters=int(degrees) // 90)


@options.command("check-gcode", "Print")
@options.argument("files", options.file("FILE.gcode"), "G-code files with one block each.", many=True)
@options.option(
    "--texture",
    options.TEXTURE,
    "Texture of the block: 1 to 6, a name such as dunes, or a TOML file.",
    options.PARTS,
    required=True,
)
@options.preset
@options.key
@options.scale
@options.option(
    "--frame",
    options.Value("X,Y[,DEG]", _frame_of),
    "Position of the block on the bed: its lower left corner in mm, and its rotation if it is turned by 90, 180 or 270 "
    "degrees. Default: computed from the outer walls of the low layers.",
    options.INPUT,
)
@options.option(
    "--filament", options.MM, "Diameter of the filament. Default: from the file, otherwise 1.75.", options.INPUT
)
@options.out("FILE", "Picture: .png, .svg or .pdf. Default: NAME_as-sliced.png in the working folder.")
@options.flag("--no-picture", "Write no picture.", options.OUTPUT)
@options.json
def command(
    files: tuple[Path, ...],
    texture: str,
    preset: str,
    scale: float,
    key_mm: float | None,
    frame: BedPlace | None,
    filament: float | None,
    out: Path | None,
    no_picture: bool,
    json: bool,
) -> None:
    """Check how accurately a slicer's G-code prints a texture.

    The command computes the top surface that the G-code prints and compares it with the formula. It reads G-code of
    PrusaSlicer, Cura, Bambu Studio and OrcaSlicer. It ignores purge lines, skirt, brim and supports.

    The table has these errors:
    - the height error (rms) where the slope is below 1
    - the same error of an ideal staircase: the same layers, printed perfectly
    - the sideways error on steeper walls
    - the number of peaks that are more than one layer too low
    - the number of valleys that are more than one layer too high

    The outermost 0.5 mm of the block are ignored. If you name several files, each file gets a column. You can then
    compare layer heights, nozzles or slicer settings.

    Examples:
      tacbench check-gcode texture-2.gcode --texture 2
      tacbench check-gcode fine.gcode coarse.gcode --texture 4 --no-picture
      tacbench check-gcode plate.gcode --texture 4 --frame 88.35,85
      tacbench check-gcode turned.gcode --texture hex.toml --frame 20,30,90
    """
    from tacbench_cad.extensions.slicing.comparison import slice_check
    from tacbench_cad.extensions.slicing.slicing_pictures import as_sliced_picture

    block = _block(texture, preset, scale, key_mm)
    pictures = _pictures(files, out, no_picture)
    results = [slice_check(path, block, frame, filament_mm=filament) for path in files]
    if json:
        print_json({"files": [result.as_dict() for result in results]})
    else:
        names = [f">{result.sliced.path.name}" for result in results]
        title = f"{block.name} as sliced (lengths in µm unless another unit is given)"
        print_table(title, ("", *names), [(head, *map(cell, results)) for head, cell in _ROWS])
    for result in results:
        for warning in result.warnings:
            note(f"warning: {result.sliced.path.name}: {warning}")
    for result, path in zip(results, pictures, strict=False):
        if write_picture(path, partial(as_sliced_picture, result), required=out is not None):
            note(f"wrote {path}")
    if not json:
        print_next("plate", "--printer", "NAME", *next_block((texture,), preset, scale, key_mm))


def _block(texture: str, preset: str, scale: float, key_mm: float | None) -> Block:
    from dataclasses import replace

    from tacbench_cad.making import described

    blocks = described((texture,), preset, scale)
    if len(blocks) != 1:
        raise InputError("texture", texture, "name one texture: 1 to 6, a name such as dunes, or a TOML file")
    return replace(blocks[0], key_mm=key_mm)


def _pictures(files: Sequence[Path], out: Path | None, no_picture: bool) -> list[Path]:
    """The paths of the pictures, in the order of the files; empty with ``--no-picture``."""
    from tacbench_cad.util.plotting import picture_format, require_single_picture

    if out is not None and no_picture:
        raise InputError("out", str(out), "cannot be combined with --no-picture")
    require_single_picture(out, len(files))
    if no_picture:
        return []
    if out is not None:
        picture_format(out)
        return [out]
    paths = [Path(f"{path.stem}_as-sliced.png") for path in files]
    for path in paths:
        if paths.count(path) > 1:
            raise InputError(
                "out", str(path), "two files have the same name and would write this picture; use --no-picture"
            )
    return paths


def _um(mm: float | None) -> str:
    return "-" if mm is None else f"{1000.0 * mm:.0f}"


def _place(result: AsSliced) -> str:
    frame = result.frame
    turned = f", turned {90 * frame.quarters} degrees" if frame.quarters else ""
    return f"{frame.x_mm:.2f}, {frame.y_mm:.2f}{turned} ({frame.source})"


def _signed(mm: float) -> str:
    return f"{round(1000.0 * mm):+d}"


def _extrema(extrema: Extrema, above: float) -> str:
    """The number of missed extrema, and their mean and largest errors: above 0 if too much is printed."""
    if extrema.count == 0:
        return "none"
    mean, worst = (_signed(above * error) for error in (extrema.mean_mm, extrema.worst_mm))
    return f"{extrema.missed} of {extrema.count}; error {mean} mean, {worst} worst"


def _share(result: AsSliced) -> str:
    steep = result.sideways
    return "-" if steep is None else f"{100.0 * steep.missing_fraction:.1f} %"


_ROWS = (
    ("slicer", lambda result: result.sliced.dialect),
    ("layers", lambda result: f"{len(result.sliced.layer_tops_mm)} of {result.sliced.layer_mm:.4g} mm"),
    ("corner on the bed (mm)", _place),
    ("top with slope below 1", lambda result: f"{100.0 * result.flat_fraction:.0f} %"),
    ("  height error, rms", lambda result: _um(result.rms_mm)),
    ("  of the ideal staircase", lambda result: _um(result.ideal_rms_mm)),
    ("  misplaced by 0.1 mm", lambda result: _um(result.misplaced_rms_mm)),
    ("  height error, mean", lambda result: "-" if result.mean_mm is None else _signed(result.mean_mm)),
    ("steep walls: sideways error, rms", lambda result: _um(result.sideways and result.sideways.rms_mm)),
    ("  of the ideal staircase", lambda result: _um(result.sideways and result.sideways.ideal_rms_mm)),
    ("  no matching height within 0.8 mm", _share),
    ("peaks lost", lambda result: _extrema(result.peaks, -1.0)),
    ("valleys filled", lambda result: _extrema(result.valleys, 1.0)),
)
