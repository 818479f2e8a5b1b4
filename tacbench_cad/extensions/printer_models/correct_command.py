"""``tacbench correct``: make blocks whose files are corrected for a printer, and their texture files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from tacbench_cad.cli import ProgressLine, note, options, print_json, print_next, show_print_set

if TYPE_CHECKING:
    from tacbench_cad.extensions.printer_models.correction import Corrected
    from tacbench_cad.making import Request


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
    from tacbench_cad.extensions.printer_models.effect_table import show_effects
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
