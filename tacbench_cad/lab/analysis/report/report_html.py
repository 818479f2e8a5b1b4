"""The templates of the page and the functions that they can call.

The page is a single file: it has no scripts, no fonts and no web addresses, and its pictures are embedded as base64.
Sections are folded on a screen and open when printed. On a narrow screen, wide tables and figures scroll in their own
boxes, so that their text keeps its size. On paper they are scaled to the page.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.lab.analysis.report import facts
from tacbench_cad.lab.runs.frame_files import PNG
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted
from tacbench_cad.util.untrusted import read_bytes

if TYPE_CHECKING:
    from jinja2 import Template

#: Screen pixels per pixel of a figure: figures have 150 pixels per inch, and an HTML page has 96.
_SCALE = 96.0 / 150.0


@dataclass(frozen=True, kw_only=True)
class Image:
    """A PNG file in base64, with the width and height at which it is shown, in screen pixels."""

    data: str
    width: int
    height: int


def read_image(path: Path) -> Image:
    """Read the PNG file of a figure.

    Raises:
        InputError: The file cannot be read, or it is not a PNG file.
    """
    data = read_bytes(path, "figure", "image")
    if not data.startswith(PNG) or len(data) < 24:
        raise InputError("figure", str(path), "is not a PNG file; run the analysis again")
    width, height = (round(side * _SCALE) for side in struct.unpack(">II", data[16:24]))
    return Image(data=base64.b64encode(data).decode(), width=width, height=height)


def render_page(document: Mapping[str, Any], base: Path) -> str:
    """Return the HTML page that shows a document of ``tacbench report --json``.

    Args:
        document: The document.
        base: The folder that contains the folder of the report's files.

    Raises:
        InputError: A figure cannot be read.
    """
    folder = base / document["folder"]
    return template("report.html.j2").render(report=document, image=lambda name: read_image(folder / name))


def template(name: str) -> Template:
    """Return one of the templates in this folder. It escapes values in HTML, and a missing name is an error."""
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
    """Return a macro of a template as a function."""
    return getattr(template(name).make_module(), function)
