"""The pages that people read in the repository are plain Markdown, and their pictures, links and anchors exist."""

from __future__ import annotations

import re
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PICTURES = DOCS / "images"
sys.path.insert(0, str(DOCS))

import renew

PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "examples/README.md")),
    *sorted(DOCS.glob("*.md")),
    DOCS / "api" / "index.md",
]
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())


@cache
def prose(page: Path) -> str:
    """Return a page without its fenced blocks and comments."""
    text = re.sub(r"^(`{3,}).*?^\1$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)


@cache
def anchors(page: Path) -> frozenset[str]:
    """Return the anchors that GitHub gives to the headings of a page."""
    seen: Counter[str] = Counter()
    names = []
    for heading in re.findall(r"^#{1,6} +(.*?) *#*$", prose(page), re.MULTILINE):
        text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")
        names.append(f"{slug}-{seen[slug]}" if seen[slug] else slug)
        seen[slug] += 1
    return frozenset(names)


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """Return the file and the anchor of each link and picture of a page that leads into the project."""
    text = re.sub(r"(`+).*?\1", "", prose(page))
    targets = re.findall(r"\]\(<?([^)\s>]+)>?[^)]*\)", text) + re.findall(r"(?:src|href)=\"([^\"]+)\"", text)
    for target in targets:
        if not re.match(r"[a-z]+:", target):
            path, _, anchor = unquote(target).partition("#")
            yield (page.parent / path).resolve() if path else page, anchor


@each_page
def test_the_targets_of_links_exist(page: Path) -> None:
    wrong = []
    for target, anchor in links(page):
        if not target.exists():
            wrong.append(f"{target} does not exist")
        elif anchor and target.suffix == ".md" and anchor not in anchors(target):
            wrong.append(f"{target.name} has no heading #{anchor}")
    assert wrong == []


@each_page
def test_a_page_is_plain_markdown(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.findall(r"(?<!`)\{[\w:-]+\}`.*", prose(page)), "roles of Sphinx"
    assert not re.findall(r"^ *[`:]{3,}\{.*", text, re.MULTILINE), "directives of Sphinx"
    assert not text.startswith("---"), "GitHub shows the header of a notebook as a table"
    assert not re.findall(r"\[\]\(", prose(page)), "a link without words"
    assert not re.findall(r"!\[ *\]\(", prose(page)), "a picture without words"


def test_pictures_are_used_and_small() -> None:
    used = {target for page in PAGES for target, _ in links(page)}
    files = {path for path in PICTURES.rglob("*") if path.is_file()}
    assert sorted(files - used) == [], "no page shows these"
    assert sorted(path for path in files if path.stat().st_size > renew.MAX_PICTURE_BYTES) == []


@each_page
def test_marks_of_blocks_are_correct(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").split("\n")
    items = list(renew.parse(page.name, lines))
    pictures = [item.options["target"] for item in items if item.kind == "picture"]
    assert len(pictures) == len(set(pictures)), "two pictures have the same name"
    for item in items:
        options = item.options
        if item.kind == "block":
            assert options.keys() <= {"run", "quiet", "varies", "lines", "write", "from"}, f"line {item.start + 1}"
            assert "run" not in options or item.language in ("python", "sh"), f"line {item.start + 1}"
        name = options.get("write") or Path(options.get("from", "")).name
        if item.kind == "block" and name:
            above = "\n".join(lines[max(item.start - 6, 0) : item.start])
            assert f"{name}`" in above, f"line {item.start + 1}: the text above does not name {name}"


def test_outputs_that_differ_only_in_durations_and_rounding_count_as_equal() -> None:
    old = "[A]  1,296 images in 83.4 s, 0:01:24 left\n ─────\n mean  2.254 counts at /tmp/rig-x1/stage"
    new = "[A]  1,296 images in 9.1 s, 0:00:02 left\n ───────\n mean   2.259 counts at /tmp/rig-zz/stage"
    assert renew.alike(old, new)
    assert not renew.alike(old, new.replace("2.259", "2.299"))
    assert renew.alike(old, new.replace("2.259", "7.1"), varies=True)
    assert not renew.alike(old, new.replace("mean", "median"))
    assert not renew.alike(old, new.replace("1,296", "1,295 of 1,296"))


def test_a_page_is_parsed_with_its_outputs() -> None:
    text = (
        "```sh run lines=3\nls\n```\n\n```text output\na\n```\n\n<!-- picture: a/b.png 600 -->\n![b](images/x/b.webp)"
    )
    block, picture = renew.parse("page", text.split("\n"))
    assert (block.kind, block.code, block.output, block.start, block.stop) == ("block", "ls\n", "a", 0, 7)
    assert block.options == {"run": "", "lines": "3"}
    assert picture.options == {"source": "a/b.png", "width": "600", "varies": None, "target": "images/x/b.webp"}


@pytest.mark.parametrize("text", ["```text output\n```", "```sh run\nls", "<!-- picture: a.png -->\n"])
def test_wrong_marks_are_named(text: str) -> None:
    with pytest.raises(renew.PageError, match=r"page:\d+: "):
        list(renew.parse("page", text.split("\n")))
