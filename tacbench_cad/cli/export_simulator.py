"""``tacbench export-simulator``: textures for simulators."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import print_json, print_table
from tacbench_cad.util.text import counted


@options.command("export-simulator")
@options.option(
    "--to", options.words("mjcf|urdf|sdf|usd|glb|obj|npy|png16|taxim"), "What for; several with commas.", required=True
)
@options.textures
@options.preset
@options.scale
@options.out("DIR", "Folder that takes a folder a texture.", required=True)
@options.json
def command(to: tuple[str, ...], textures: tuple[str, ...], preset: str, scale: float, out: Path, json: bool) -> None:
    """Write textures for simulators: a folder a texture, with collision that keeps the relief.

    The folder's README.md states frame, scale, units, the proved error against the formula, contact settings that hold,
    and what was tested. A folder is written whole or not at all; one that holds the same texture gains the new files,
    one that holds another is refused.

    Examples:
      tacbench export-simulator --to mjcf --out sim
      tacbench export-simulator --to urdf,sdf --texture 2 --out sim
      tacbench export-simulator --to npy,png16 --texture hex.toml --scale 2 --out heights
    """
    from tacbench_cad.formats.simulators.folder import export_to_simulators
    from tacbench_cad.making.choice import described
    from tacbench_cad.util.convert import to_plain

    folders = export_to_simulators(described(textures, preset, scale), to, out)
    if json:
        print_json({"folders": to_plain(folders)})
        return
    print_table(
        f"{counted(len(folders), 'folder')} in {out}",
        ("folder", ">files", ">MB", "begin with"),
        [
            (one.folder.name, len(one.files), f"{sum(one.files.values()) / 1e6:.2f}", next(iter(one.files)))
            for one in folders
        ],
    )
