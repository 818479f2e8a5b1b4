"""``tacbench view``: write a web page that shows the parts in 3D."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacbench_cad.cli import next_block, note, options, print_next


@options.command("view", "Print")
@options.argument(
    "parts",
    options.words("PARTS", *options.TEXTURES, *options.PART_NAMES, suffix=".toml"),
    "1 to 6, a name such as dunes, a TOML file, blocks, holder, jig, coupon. Default: the whole print set.",
    many=True,
    required=False,
)
@options.part
@options.out("FILE.html", "The page.", default="view.html")
def command(parts: tuple[tuple[str, ...], ...], out: Path, **request: Any) -> None:
    """Write a web page that shows the parts in 3D.

    On the page you can rotate, cut and measure the parts. It shows:
    - the relief of each texture, coloured by height
    - block, holder and jig, and how they fit together
    - the press positions and the contact areas
    - the distance of a block's mesh from the formula, in colours

    The page is one file and loads nothing from the internet, so you can send it to a colleague.

    Examples:
      tacbench view
      tacbench view 4 -o texture-4.html
      tacbench view 1,2 holder jig --slots 2
      tacbench view hex.toml --tolerance 0.05
    """
    from tacbench_cad.making import Request, request_of, write_view
    from tacbench_cad.render import require_page

    words = [word for words in parts for word in words]
    print_set = request_of(words, Request(**options.request_fields(request)))
    require_page(out)
    scene = write_view(print_set, out, note)
    for what, reason in scene.left_out:
        note(f"left out: {what}: {reason}")
    note(f"wrote {out} ({out.stat().st_size / 1e6:.1f} MB)")
    textures = [word for word in words if word not in options.PART_NAMES]
    print_next("make", *next_block(textures or ["all"], print_set.preset, print_set.scale, print_set.key_mm), err=True)
