"""``tacbench view``: the 3D page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note


@options.command("view")
@options.argument(
    "parts",
    options.words("PARTS"),
    "1 to 6, a texture's name, a TOML file, blocks, holder, jig, coupon. Default: the whole set.",
    many=True,
    required=False,
)
@options.part
@options.out("FILE.html", "The page.", default="view.html")
def command(parts: tuple[tuple[str, ...], ...], out: Path, **request: Any) -> None:
    """Write one HTML page with the parts in 3D: to turn, cut and measure. It loads nothing, so it can be sent on.

    The page shows texture, block, holder, jig and how they go together, the press positions and contact circles, and
    how far each point of a block's mesh lies from the formula, in colour with its scale.

    Examples:
      tacbench view
      tacbench view 4 -o texture-4.html
      tacbench view 1,2 holder jig --slots 2
      tacbench view hex.toml --tolerance 0.05
    """
    from tacbench_cad.making.request import Request
    from tacbench_cad.making.showing import request_of, write_view
    from tacbench_cad.render.viewing.page import require_page

    words = [word for words in parts for word in words]
    meant = request_of(words, Request(**options.request_fields(request)))
    require_page(out)
    scene = write_view(meant, out, note)
    for what, reason in scene.left_out:
        note(f"left out: {what}: {reason}")
    note(f"wrote {out} ({out.stat().st_size / 1e6:.1f} MB)")
