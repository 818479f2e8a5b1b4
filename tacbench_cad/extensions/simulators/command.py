"""``tacbench export-simulator``: write textures for simulators."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options, print_json, print_table
from tacbench_cad.util.text import counted

#: The words of ``--to``; a test compares them with the formats that can be written.
FORMATS = ("mjcf", "urdf", "sdf", "usd", "glb", "obj", "npy", "png16", "taxim")


@options.command("export-simulator", "Share")
@options.option(
    "--to",
    options.words("LIST", *FORMATS),
    "Formats: mjcf, urdf, sdf, usd, glb, obj, npy, png16, taxim.",
    options.OUTPUT,
    required=True,
)
@options.textures
@options.preset
@options.scale
@options.out("DIR", "Folder of the texture folders.", required=True)
@options.json
def command(to: tuple[str, ...], textures: tuple[str, ...], preset: str, scale: float, out: Path, json: bool) -> None:
    """Write textures for simulators.

    Each texture gets its own folder. Its collision geometry keeps the full relief. The README.md in the folder states
    the coordinate frame, the scale, the units, a proved upper limit of the error against the formula, recommended
    contact settings, and what was tested.

    A folder is written completely or not at all. If the folder exists already:
    - If it has the same texture, the new files are added or replace old ones.
    - If it has another texture, the command refuses.

    Examples:
      tacbench export-simulator --to mjcf --out sim
      tacbench export-simulator --to urdf,sdf --texture 2 --out sim
      tacbench export-simulator --to npy,png16 --texture hex.toml --out heights
    """
    from tacbench_cad.extensions.simulators.folder import export_to_simulators
    from tacbench_cad.making import described
    from tacbench_cad.util.convert import to_plain

    folders = export_to_simulators(described(textures, preset, scale), to, out)
    if json:
        print_json({"folders": to_plain(folders)})
        return
    print_table(
        f"{counted(len(folders), 'folder')} in {out}",
        ("folder", ">files", ">MB", "start with"),
        [
            (each.folder.name, len(each.files), f"{sum(each.files.values()) / 1e6:.2f}", next(iter(each.files)))
            for each in folders
        ],
    )
