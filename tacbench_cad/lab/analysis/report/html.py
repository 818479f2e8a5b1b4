"""The pieces of a page that needs nothing but itself: headings, paragraphs, tables and pictures as HTML.

Every text is escaped here, once. The page has no script, no font of its own and no address in it; pictures stand in it
as base64. On a narrow screen wide tables and figures scroll in their own box, so that letters keep their size; on paper
they fit the page.
"""

from __future__ import annotations

import base64
import re
import struct
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from tacbench_cad.util.errors import InputError

#: Pixels of a screen for one of a figure: figures have 150 an inch, a page of HTML counts 96.
_SCALE = 96.0 / 150.0
_PNG = b"\x89PNG\r\n\x1a\n"

_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 62rem; background: #fff; color: #222;
  font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", Helvetica, Arial, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0 0 .5rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .5rem; padding-bottom: .2rem; border-bottom: 2px solid #0072b2; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p, ul { margin: .5rem 0; max-width: 44rem; }
nav ul { columns: 2 14rem; padding-left: 1.2rem; }
a { color: #00507d; }
.scroll { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-size: .9rem; padding-bottom: .3rem; }
th, td { padding: .2rem .6rem; text-align: left; vertical-align: top; border-bottom: 1px solid #ddd; }
thead th { border-bottom: 1.5px solid #222; vertical-align: bottom; }
td.n, th.n { text-align: right; white-space: nowrap; }
figure { margin: 1rem 0; }
figcaption { font-size: .9rem; max-width: 44rem; }
img { display: block; height: auto; }
.mark { color: #b03a00; font-style: italic; font-size: .85rem; margin: .2rem 0; }
.banner { border: 2px solid #b03a00; color: #8a2e00; padding: .5rem .8rem; max-width: none; }
.files { color: #555; font-size: .8rem; margin: .2rem 0; }
pre { overflow-x: auto; background: #f5f5f5; padding: .6rem; font-size: .8rem; }
@media (min-width: 64rem) { img { max-width: 100%; } }
@page { size: A4; margin: 15mm; }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav { display: none; }
  img { max-width: 100%; max-height: 240mm; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; }
  th, td { padding: .1rem .3rem; }
  thead { display: table-header-group; }
  tr, figure { break-inside: avoid; }
  h2, h3, caption { break-after: avoid; }
  pre { white-space: pre-wrap; }
}
"""


def page(title: str, body: Iterable[str]) -> str:
    """A whole document.

    Args:
        title: Its title.
        body: Its pieces, as the functions here make them.
    """
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def heading(level: int, text: str, anchor: str = "") -> str:
    """A heading of level 1 to 3."""
    name = f' id="{escape(anchor)}"' if anchor else ""
    return f"<h{level}{name}>{escape(text)}</h{level}>"


def contents(sections: Iterable[tuple[str, str]]) -> str:
    """A list of sections, each with anchor and title."""
    items = "".join(f'<li><a href="#{escape(anchor)}">{escape(title)}</a></li>' for anchor, title in sections)
    return f'<nav aria-label="Contents"><ul>{items}</ul></nav>'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph; ``kind`` is ``mark`` (simulated data), ``banner`` or ``files``."""
    return f"<p{_class(kind)}>{escape(text)}</p>"


def bullets(items: Iterable[str]) -> str:
    """A list."""
    return f"<ul>{''.join(f'<li>{escape(one)}</li>' for one in items)}</ul>"


def verbatim(text: str) -> str:
    """Text as it is typed."""
    return f"<pre>{escape(text)}</pre>"


def table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[Any]], simulated: bool, files: str = "") -> str:
    """A table with its mark of simulated data.

    Args:
        caption: What it shows.
        heads: Heads of its columns.
        rows: Cells; columns of numbers are set flush right. A float is shortened to four digits, None is a dash.
        simulated: Whether any of the data was simulated.
        files: The file that has it with every digit.
    """
    kept = [list(row) for row in rows]
    right = [bool(kept) and all(row[i] is None or _is_number(row[i]) for row in kept) for i in range(len(heads))]
    head = "".join(
        f'<th scope="col"{_class("n" if r else "")}>{escape(h)}</th>' for h, r in zip(heads, right, strict=True)
    )
    body = "".join(
        "<tr>"
        + "".join(f"<td{_class('n' if r else '')}>{escape(shown(v))}</td>" for v, r in zip(row, right, strict=True))
        + "</tr>\n"
        for row in kept
    )
    return (
        f'<div class="scroll"><table><caption>{escape(caption)}</caption>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}</tbody></table></div>" + mark(simulated) + (paragraph(files, "files") if files else "")
    )


def figure(path: Path, caption: str, files: str = "") -> str:
    """A PNG as a figure within the page; its mark of simulated data is in the picture.

    Args:
        path: The PNG.
        caption: What it shows; also its text for those who do not see it.
        files: Where it lies as a file.

    Raises:
        InputError: It cannot be read, or is no PNG.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError("figure", str(path), f"cannot be read: {error.strerror}") from None
    if not data.startswith(_PNG) or len(data) < 24:
        raise InputError("figure", str(path), "is no PNG file; have it drawn again")
    width, height = struct.unpack(">II", data[16:24])
    size = f'width="{round(width * _SCALE)}" height="{round(height * _SCALE)}"'
    image = f'<img {size} alt="{escape(caption)}" src="data:image/png;base64,{base64.b64encode(data).decode()}">'
    return (
        f'<figure><div class="scroll">{image}</div><figcaption>{escape(caption)}</figcaption>'
        + (paragraph(files, "files") if files else "")
        + "</figure>"
    )


def mark(simulated: bool) -> str:
    """The line below a table of simulated data; the top of the page says what was simulated."""
    return paragraph("simulated data", "mark") if simulated else ""


def shown(value: Any) -> str:
    """A cell's text."""
    if value is None or value == "":
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 10_000.0 else f"{value:,.0f}"
    return str(value)


def _is_number(value: Any) -> bool:
    """Whether a cell is a number, or a text that is one."""
    if isinstance(value, str):
        return re.fullmatch(r"[+-]?\d+(\.\d+)?", value) is not None
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
