"""``tacbench design``: design a texture block in the browser."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tacbench_cad.cli import note, options


@options.command("design", "Print")
@options.argument(
    "texture",
    options.text("TEXTURE", complete=options.TEXTURE.complete),
    "1 to 6, a later texture such as dunes, or a TOML file. Default: 2.",
    required=False,
)
@options.out("DIR", "Folder of the files that the page writes.", default="stl_out")
@options.port
@options.no_browser
def command(texture: str | None, out: Path, port: int, no_browser: bool) -> None:
    """Design a texture block in the browser.

    The command opens a page with sliders for the formula, the size and the tolerance. The page shows:
    - the block in 3D, and a cut through it
    - the part of the relief that your nozzle can print
    - relief, base, number of triangles and largest distance from the formula

    The page writes the files of the block, or copies the texture file (TOML). Press Ctrl-C to end the command.

    Only browsers on this machine can open the page, and only with the address that the command prints.

    Examples:
      tacbench design
      tacbench design 4 -o blocks
      tacbench design hex.toml
    """
    from tacbench_cad.util.packages import require

    require("the design page", "starlette", "uvicorn", "websockets", "k3d")
    from tacbench_cad.extensions.design.app import DesignPage
    from tacbench_cad.extensions.design.document import first_state
    from tacbench_cad.extensions.serving.server import serve

    design, name = first_state(texture or "2")
    with tempfile.TemporaryDirectory(prefix="tacbench-") as uploads:
        serve(
            DesignPage(out, Path(uploads), design, name).routes,
            port=port,
            browser=not no_browser,
            announce=lambda address: note(f"open {address}\npress Ctrl-C to end"),
        )
