"""``tacbench correct``: make blocks whose files are corrected for a printer, and their texture files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from tacbench_cad.cli import (
    ProgressLine,
    note,
    options,
    print_json,
    print_lines,
    print_next,
    print_table,
    show_print_set,
)
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.extensions.printer_models.correction import Corrected
    from tacbench_cad.extensions.printer_models.effect import Effect
    from tacbench_cad.extensions.printer_models.prediction import Errors
    from tacbench_cad.making import Request


#: The number of waves that the table shows. The JSON document has all of them.
MAX_WAVES = 12


@options.command("correct", "Print")
@options.argument("model", options.file("MODEL.toml"), "Model of the printer, which tacbench printer-model wrote.")
@options.textures
@options.part
@options.option(
    "--parts",
    options.words("LIST", "blocks", "holder", "jig"),
    "Parts to make: blocks, holder, jig. Holder and jig get the sides of the corrected files. Default: all.",
    options.PARTS,
)
@options.formats
@options.copies
@options.out("DIR", "Folder of the files.", default="corrected")
@options.json
def command(model: Path, parts: tuple[str, ...] | None, json: bool, **request: Any) -> None:
    """Make blocks whose files are corrected for a printer.

    The sides, the height and the waves of each block are changed, so that its print is nearer to the formula. The
    command prints the expected effect. For each block, the folder gets:
    - the files, each of which is read back and checked
    - a texture file, such as texture-4.toml, which other commands and study files accept as the printed file

    Names and labels have the word corr (or free, if the relief of the prints is free).

    Examples:
      tacbench correct my-printer.toml
      tacbench correct my-printer.toml --texture 3,4 --key --label --formats 3mf
      tacbench check-part corrected/t4-corr_*.stl --texture corrected/texture-4.toml
    """
    from tacbench_cad.extensions.printer_models.correction import corrected_for
    from tacbench_cad.extensions.printer_models.effect import effect_of
    from tacbench_cad.extensions.printer_models.model import read_printer_model
    from tacbench_cad.making import Request, blocks_of, build
    from tacbench_cad.util.convert import to_plain

    asked = Request(**options.request_fields(request))
    printer = read_printer_model(model)
    corrected = [corrected_for(block, printer) for block in blocks_of(asked)]
    with ProgressLine(every_s=0.0) as progress:
        result = build(_request(asked, corrected, parts), progress.show)
    written = _write_textures(corrected, asked)
    effects = [effect_of(each) for each in corrected]
    if json:
        texture_files = [path.name for path in written]
        print_json({**result.as_dict(), "texture_files": texture_files, "expected_prints": to_plain(effects)})
    else:
        show_print_set(result)
        show_effects(effects)
        print_next("plate", "--printer", "NAME", "--files", asked.out)
    for failure in result.failures:
        note(f"failed, not written: {failure.file}: {'; '.join(failure.faults)}")
    if not result.ok:
        raise Exit(1)


def _request(asked: Request, corrected: list[Corrected], parts: tuple[str, ...] | None) -> Request:
    """Return the request of the parts: the corrected blocks, and fixtures for each of their outlines."""
    from dataclasses import replace

    from housing import FIXTURES
    from tacbench_cad.making import Request

    made: list[Any] = []
    kinds = parts or ("blocks", "holder", "jig")
    if "blocks" in kinds:
        for each in corrected:
            numbers = [None] if asked.copies is None else range(1, asked.copies + 1)
            files = [each.file if number is None else replace(each.file, copy=number) for number in numbers]
            made += [replace(each, file=file) for file in files]
    outlines = {each.for_fixtures.silhouette: each.for_fixtures for each in corrected}
    names = ("fit", "rim_mm", "slots", "nozzle_mm", "jig")
    chosen = {name: value for name in names if (value := getattr(asked, name)) is not None}
    for kind in kinds:
        if kind != "blocks":
            made += [FIXTURES[kind].requested(block, chosen) for block in outlines.values()]
    return Request(parts=tuple(made), formats=asked.formats, out=asked.out)


def _write_textures(corrected: list[Corrected], asked: Request) -> list[Path]:
    """Write the texture files of the corrected blocks, and return their paths."""
    from tacbench_cad.util.files import write_text

    sources = {Path(str(word)).stem: str(Path(str(word)).resolve()) for word in asked.textures if _is_file(word)}
    paths = []
    for each in corrected:
        name = each.print.texture.name
        path = asked.out / f"{name}.toml"
        write_text(path, each.toml(sources.get(name, name)))
        paths.append(path)
    return paths


def _is_file(word: Any) -> bool:
    return str(word).lower().endswith(".toml")


def show_effects(effects: Sequence[Effect]) -> None:
    """Print the expected prints of plain and corrected files, and the waves with the largest errors."""
    rows = []
    for effect in effects:
        for what, size, relief, errors in (
            ("formula", effect.size_mm, effect.relief_mm, None),
            ("print of the plain file", effect.plain_size_mm, effect.plain_relief_mm, effect.plain),
            ("print of this file", effect.corrected_size_mm, effect.corrected_relief_mm, effect.corrected),
        ):
            name = effect.texture if what == "formula" else ""
            each = (errors.rms_mm, errors.printable_rms_mm, errors.normal_rms_mm) if errors else ()
            rms = [f"{1000.0 * error:.1f}" for error in each] or [""] * 3
            rows.append((name, what, *(f"{side:.3f}" for side in size), f"{relief:.3f}", *rms))
    heads = (
        *("texture", "", ">x (mm)", ">y (mm)", ">height (mm)", ">relief (mm)"),
        *(">vertical error", ">of printable waves", ">along the normal"),
    )
    title = f"expected prints, by the model {effects[0].model}; errors are root mean squares in µm"
    print_table(title, heads, rows)
    for effect in effects:
        if not effect.waves:
            print_lines(f"{effect.texture} is not a sum of waves: only its sides and its height are corrected")
        if effect.plain and effect.corrected and effect.free and not effect.helps:
            print_lines(_advice(effect, effect.plain, effect.corrected, effect.free))
    waves = [(effect.texture, wave) for effect in effects for wave in effect.waves]
    waves.sort(key=lambda row: -abs(row[1].plain_mm - row[1].amplitude_mm))
    if waves:
        print_table(
            f"expected amplitudes (µm) of {'the waves' if len(waves) <= MAX_WAVES else 'the waves that change most'}",
            ("texture", ">wavelength (mm)", ">direction (°)", ">formula", ">plain", ">corrected", ">in the file", ""),
            [
                (
                    texture,
                    f"{wave.wavelength_mm:.3f}",
                    f"{wave.direction_deg:.0f}",
                    *(
                        f"{1000.0 * amplitude:.1f}"
                        for amplitude in (wave.amplitude_mm, wave.plain_mm, wave.corrected_mm, wave.file_mm)
                    ),
                    wave.note,
                )
                for texture, wave in waves[:MAX_WAVES]
            ],
        )
    if len(waves) > MAX_WAVES:
        print_lines(f"{counted(len(waves) - MAX_WAVES, 'more wave')} (see --json)")


def _advice(effect: Effect, plain: Errors, corrected: Errors, free: Errors) -> str:
    """Say what to do if the correction is not expected to reduce both errors."""
    (vertical, normal), before, with_free = (
        [f"{1000.0 * error:.1f}" for error in (errors.rms_mm, errors.normal_rms_mm)]
        for errors in (corrected, plain, free)
    )
    text = (
        f"{effect.texture}: the correction does not reduce both errors: the vertical error is {vertical} instead of "
        f"{before[0]} µm, and the error along the normal is {normal} instead of {before[1]} µm"
    )
    if effect.relief_rule == "formula" and free.is_below(corrected):
        both = " and ".join(with_free)
        return f"{text}. With a free relief they are {both} µm (tacbench printer-model --relief free)"
    return text if corrected.rms_mm < plain.rms_mm else f"{text}; print the plain file"
