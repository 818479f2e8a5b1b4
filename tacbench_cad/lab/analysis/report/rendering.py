"""The templates of the page, and what they can call.

The page has no script, no font of its own and no address in it; pictures stand in it as base64. Sections are folded on
a screen and open on paper. On a narrow screen wide tables and figures scroll in their own box, so that letters keep
their size; on paper they fit the page.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.lab.analysis.report import facts
from tacbench_cad.lab.runs.pictures import PNG
from tacbench_cad.util.door import read_bytes
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from jinja2 import Template

#: Pixels of a screen for one of a figure: figures have 150 an inch, a page of HTML counts 96.
_SCALE = 96.0 / 150.0


@dataclass(frozen=True, kw_only=True)
class Image:
    """A PNG in base64, and the width and height in pixels at which it is shown."""

    data: str
    width: int
    height: int


def read_image(path: Path) -> Image:
    """A figure's PNG.

    Raises:
        InputError: It cannot be read, or is no PNG.
    """
    data = read_bytes(path, "figure", "image")
    if not data.startswith(PNG) or len(data) < 24:
        raise InputError("figure", str(path), "is no PNG file; have it drawn again")
    width, height = (round(side * _SCALE) for side in struct.unpack(">II", data[16:24]))
    return Image(data=base64.b64encode(data).decode(), width=width, height=height)


def render_page(document: Mapping[str, Any], base: Path) -> str:
    """The page that shows a document of ``tacbench report --json``.

    Args:
        document: The document.
        base: Where the folder of its files lies.

    Raises:
        InputError: A figure cannot be read.
    """
    folder = base / document["folder"]
    return template("report.html.j2").render(report=document, image=lambda name: read_image(folder / name))


def template(name: str) -> Template:
    """One of the templates in this folder; what HTML shows is escaped, and a name that is missing refused."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=name.endswith(".html.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    words = (
        facts.prints_in_words,
        facts.sampling_in_words,
        facts.forces_in_words,
        facts.devices_in_words,
        facts.unknown_in_words,
    )
    environment.globals.update({function.__name__: function for function in (*words, counted)})
    return environment.get_template(name)


def macro(name: str, function: str) -> Any:
    """A macro of a template, to be called from here."""
    return getattr(template(name).make_module(), function)
