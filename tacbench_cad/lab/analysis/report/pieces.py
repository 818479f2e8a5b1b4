"""The pieces that a page is made of, and the template that turns them into HTML.

The page has no script, no font of its own and no address in it; pictures stand in it as base64. On a narrow screen
wide tables and figures scroll in their own box, so that letters keep their size; on paper they fit the page.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.tables import Table
from tacbench_cad.util.door import read_bytes
from tacbench_cad.util.errors import InputError

#: Pixels of a screen for one of a figure: figures have 150 an inch, a page of HTML counts 96.
_SCALE = 96.0 / 150.0
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True)
class Piece:
    """A piece of a page: what it is, and what it needs of the rest.

    Args:
        kind: What it is.
        text: Its text; of a figure the caption, which also stands for those who do not see it.
        items: Items of a list.
        table: The table, with its title as the caption.
        image: A figure's PNG in base64.
        size_px: Width and height at which it is shown.
        files: The files that have it with every digit, or at full size.
    """

    kind: Literal["paragraph", "heading", "list", "table", "figure", "verbatim"]
    text: str = ""
    items: Sequence[str] = ()
    table: Table | None = None
    image: str = ""
    size_px: tuple[int, int] = (0, 0)
    files: str = ""


@dataclass(frozen=True, kw_only=True)
class Study:
    """What every section reads.

    Args:
        collection: The presses.
        files: Folder of the report's tables and figures.
    """

    collection: Collection
    files: Path

    def file(self, name: str) -> str:
        """What a table's or a figure's caption says of its files."""
        return f"{self.files.name}/{name}"

    def table(self, table: Table, file: str = "") -> Piece:
        """A table with its title as a piece, and the file within the report's that has it with every digit."""
        return Piece("table", table=table, files=self.file(file) if file else "")

    def figure(self, stem: str, caption: str, *tables: str) -> Piece:
        """A PNG as a figure within the page; its mark of simulated data is in the picture.

        Args:
            stem: Its path within the report's files, without suffix.
            caption: What it shows.
            tables: Tables that it was drawn from, within the report's files.

        Raises:
            InputError: It cannot be read, or is no PNG.
        """
        path = self.files / f"{stem}.png"
        data = read_bytes(path, "figure", "image")
        if not data.startswith(_PNG) or len(data) < 24:
            raise InputError("figure", str(path), "is no PNG file; have it drawn again")
        width, height = struct.unpack(">II", data[16:24])
        return Piece(
            "figure",
            caption,
            image=base64.b64encode(data).decode(),
            size_px=(round(width * _SCALE), round(height * _SCALE)),
            files=", ".join(map(self.file, (f"{stem}.png", f"{stem}.pdf", *tables))),
        )


@dataclass(frozen=True, kw_only=True)
class Section:
    """A section of the page.

    Args:
        anchor: What links to it.
        title: Its title.
        pieces: What stands in it.
    """

    anchor: str
    title: str
    pieces: tuple[Piece, ...]


def page(title: str, subtitle: str, simulated: Sequence[str], sections: Iterable[Section]) -> str:
    """A whole page.

    Args:
        title: Its title.
        subtitle: The line below the title.
        simulated: What of the data was simulated; it stands on top, and every table is marked.
        sections: Its sections.
    """
    from jinja2 import Environment, FileSystemLoader
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("report.html.j2").render(
        title=title,
        subtitle=subtitle,
        simulated="; ".join(simulated),
        sections=list(sections),
        number=Markup(' class="n"'),
    )
