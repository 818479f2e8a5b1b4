"""The manual: its outputs and pictures are up to date, no link is dead, nothing is fetched, a browser shows it all."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from difflib import unified_diff
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from helpers.checkout import ROOT, Once

pytest.importorskip("sphinx", reason="the manual needs the extra docs")

from markdown_it import MarkdownIt

sys.path.insert(0, str(ROOT / "docs"))

import renew

pytestmark = pytest.mark.real

#: For renewing all pages and for the build, in s, and for one page in the browser, in ms.
RENEWAL_PATIENCE_S, BUILD_PATIENCE_S, PAGE_PATIENCE_MS = 3600.0, 1800.0, 60_000
#: Where a reader may be sent, each looked at by a person: the theme's makers, and whom a page speaks of.
OUTSIDE = {
    "https://github.com/gnea/grbl/wiki",
    "https://github.com/pradyunsg/furo",
    "https://pradyunsg.me",
    "https://www.sphinx-doc.org/",
}
#: Attributes for which a browser fetches what they name.
FETCHED = ("src", "data", "poster", "background", "xlink:href")
#: Relations for which it fetches what is linked to.
LOADED = {"stylesheet", "icon", "preload", "prefetch", "modulepreload", "manifest"}
#: Languages of blocks that are shown and not run.
SHOWN = {"sh", "text", "toml", "csv", "json", "bibtex", "gcode", "xml", "yaml"}


@dataclass(frozen=True)
class Manual:
    """What a build left."""

    code: int
    said: str
    html: Path
    docs: Path

    @property
    def written(self) -> tuple[Path, ...]:
        """The pages as they were written."""
        return tuple(sorted(self.docs.glob("*.md")))

    def page(self, written: Path) -> Path:
        """What became of one."""
        return self.html / f"{written.stem}.html"

    @property
    def pages(self) -> tuple[Path, ...]:
        """The pages."""
        return tuple(sorted(self.html.rglob("*.html")))

    def name(self, page: Path) -> str:
        """A page as it is linked to from the first."""
        return page.relative_to(self.html).as_posix()


@pytest.fixture(scope="session")
def manual(once: Once, source: Path) -> Manual:
    """The manual of a clean checkout, by the Makefile's own command."""
    recipe = re.search(r"sphinx-build (.*) docs docs/_build/html$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe, "the Makefile builds it otherwise"

    def fill(folder: Path) -> None:
        tree = shutil.copytree(source, folder / "tree")
        asked = [sys.executable, "-m", "sphinx", *recipe[1].split(), "--no-color", "docs", folder / "html"]
        done = subprocess.run(
            asked, cwd=tree, capture_output=True, text=True, timeout=BUILD_PATIENCE_S, stdin=subprocess.DEVNULL
        )
        (folder / "said.json").write_text(json.dumps([done.returncode, done.stderr]), encoding="utf-8")

    folder = once("manual", fill)
    code, said = json.loads((folder / "said.json").read_text(encoding="utf-8"))
    if not (folder / "html" / "index.html").is_file():
        pytest.fail(f"nothing was built: {said[-4000:]}")
    return Manual(code, said, folder / "html", folder / "tree" / "docs")


@dataclass
class Page(HTMLParser):
    """What a page refers to, and what it can be referred to by."""

    links: list[str] = field(default_factory=list)
    fetched: list[str] = field(default_factory=list)
    styles: list[str] = field(default_factory=list)
    ids: set[str] = field(default_factory=set)
    nameless: list[str] = field(default_factory=list)
    formulas: int = 0
    _style: bool = False

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what a tag refers to."""
        found = {name: value or "" for name, value in attrs}
        classes = found.get("class", "").split()
        self.ids |= {found[name] for name in ("id", "name") if name in found}
        self.fetched += [found[name] for name in FETCHED if found.get(name)]
        self.fetched += [one.split()[0] for one in found.get("srcset", "").split(",") if one.strip()]
        if tag == "link" and LOADED & set(found.get("rel", "").split()):
            self.fetched.append(found["href"])
        elif "href" in found:
            self.links.append(found["href"])
        if tag == "img" and not found.get("alt", "").strip():
            self.nameless.append(found.get("src", "")[:80])
        self.styles.append(found.get("style", ""))
        self._style = tag == "style"
        self.formulas += "math" in classes

    def handle_endtag(self, tag: str) -> None:
        """Leave a style sheet."""
        self._style = self._style and tag != "style"

    def handle_data(self, data: str) -> None:
        """Read a style sheet in the page."""
        if self._style:
            self.styles.append(data)


@cache
def read(page: Path) -> Page:
    """A page, read."""
    one = Page()
    one.feed(page.read_text(encoding="utf-8"))
    one.close()
    return one


def addresses(style: str) -> list[str]:
    """What a style sheet has the browser fetch."""
    return [
        found.strip("'\" ")
        for found in re.findall(r"url\(([^)]*)\)|@import\s+([^;]*)", style)
        for found in found
        if found
    ]


def is_outside(address: str) -> bool:
    """Whether an address is of another machine."""
    return bool(urlsplit(address).netloc) or urlsplit(address).scheme in ("http", "https", "ftp", "ws", "wss")


def test_it_is_built_without_a_warning(manual: Manual) -> None:
    told = [line for line in manual.said.splitlines() if ": WARNING: " in line or ": ERROR: " in line]
    assert told == []
    assert manual.code == 0, manual.said[-6000:]


def test_there_is_a_page_for_each_source(manual: Manual) -> None:
    names = {manual.name(page) for page in manual.pages}
    assert len(manual.written) >= 20
    assert [path.name for path in manual.written if not manual.page(path).is_file()] == []
    assert [name for name in names if name.startswith("api/")], "no reference"


def test_no_link_is_dead(manual: Manual) -> None:
    dead = []
    for page in manual.pages:
        found = read(page)
        for link in [*found.links, *found.fetched]:
            parts = urlsplit(link)
            if is_outside(link) or parts.scheme in ("data", "mailto"):
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            there = target.is_file() and target.is_relative_to(manual.html.resolve())
            if there and parts.fragment and target.suffix == ".html":
                there = unquote(parts.fragment) in read(target).ids
            if not there:
                dead.append(f"{manual.name(page)}: {link}")
    assert dead == []


def test_readers_are_sent_to_known_places_only(manual: Manual) -> None:
    found = {(link, manual.name(page)) for page in manual.pages for link in read(page).links if is_outside(link)}
    assert {link for link, _ in found} - OUTSIDE == set(), sorted(one for one in found if one[0] not in OUTSIDE)
    assert all(link.startswith("https://") for link, _ in found)


def test_nothing_is_fetched_from_elsewhere(manual: Manual) -> None:
    for page in manual.pages:
        found = read(page)
        asked = [*found.fetched, *(one for style in found.styles for one in addresses(style))]
        assert [one for one in asked if is_outside(one)] == [], manual.name(page)
    for sheet in sorted(manual.html.rglob("*.css")):
        for one in addresses(sheet.read_text(encoding="utf-8")):
            assert not is_outside(one), sheet.name
            assert one.startswith(("data:", "#")) or (sheet.parent / urlsplit(one).path).is_file(), (
                f"{sheet.name}: {one}"
            )


def test_pictures_say_what_they_show(manual: Manual) -> None:
    found = {manual.name(page): read(page).nameless for page in manual.pages}
    assert {name: pictures for name, pictures in found.items() if pictures} == {}


def test_every_block_of_code_is_run() -> None:
    wrong = []
    for page in sorted((ROOT / "docs").glob("*.md")):
        for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
            language, *words = token.info.split() if token.type == "fence" else ("",)
            runs = {word.partition("=")[0] for word in words} & {"run", "write", "from", "output"}
            if token.type == "code_block" or (token.type == "fence" and not runs and language not in SHOWN):
                wrong.append(f"{page.name}: {token.info or token.content.strip()[:60]!r} is not run")
    assert wrong == []


def without_numbers(text: str) -> str:
    """Return a page with its numbers and gaps replaced. Another processor or version of Python may change numbers."""
    return renew.GAPS.sub(" ", re.sub(r"[-+]?\d[\d.,]*", "0", text))


def test_outputs_and_pictures_are_up_to_date(once: Once, source: Path) -> None:
    def fill(folder: Path) -> None:
        tree = shutil.copytree(source, folder / "tree")
        command = [sys.executable, "docs/renew.py"]
        # The commands of the pages import the copy, not the project.
        done = subprocess.run(
            command,
            cwd=tree,
            env=os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            timeout=RENEWAL_PATIENCE_S,
            stdin=subprocess.DEVNULL,
        )
        (folder / "said.json").write_text(json.dumps([done.returncode, done.stdout + done.stderr]), encoding="utf-8")

    folder = once("renewal", fill)
    code, said = json.loads((folder / "said.json").read_text(encoding="utf-8"))
    assert code == 0, said[-8000:]
    differences = []
    for path in sorted(path for path in (folder / "tree" / "docs").rglob("*") if path.is_file()):
        name = path.relative_to(folder / "tree")
        old = source / name
        if path.suffix == ".md":
            texts = [file.read_text(encoding="utf-8") for file in (old, path)]
            if without_numbers(texts[0]) != without_numbers(texts[1]):
                lines = (text.splitlines() for text in texts)
                differences += unified_diff(*lines, f"{name} (committed)", f"{name} (renewed)", lineterm="", n=1)
        elif path.suffix == ".webp" and (not old.is_file() or old.read_bytes() != path.read_bytes()):
            differences.append(f"{name} looks different")
    assert not differences, "run make docs and commit what changes:\n" + "\n".join(differences)


#: What a page has to show once it is drawn: formulas, and pictures that did not come; and what sticks out sideways.
STATE = """async () => {
    if (window.MathJax && MathJax.startup) await MathJax.startup.promise;
    for (const one of document.images) { one.loading = 'eager'; await one.decode().catch(() => null); }
    const width = document.documentElement.clientWidth;
    const inside = (one) => { for (let up = one.parentElement; up; up = up.parentElement)
        if (getComputedStyle(up).overflowX !== 'visible' && up !== document.body && up !== document.documentElement)
            return true; };
    return {
        formulas: document.querySelectorAll('mjx-container').length,
        failed: document.querySelectorAll('mjx-merror, [data-mjx-error]').length,
        empty: [...document.images].filter((one) => !one.naturalWidth).map((one) => one.src.slice(-80)),
        over: document.scrollingElement.scrollWidth - width,
        wide: [...document.body.querySelectorAll('article *')].filter((one) =>
            one.getBoundingClientRect().right > width + 1 && !inside(one)).slice(0, 3).map((one) =>
            one.tagName + '.' + one.className + ' ' + one.textContent.slice(0, 40)),
    };
}"""


def complaints(manual: Manual, browser: Any, width: int, pages: tuple[Path, ...]) -> list[str]:
    """What is wrong with pages, opened from disk one after another in a window of a width."""
    window = browser.new_page(viewport={"width": width, "height": 800})
    asked: list[str] = []
    said: list[str] = []
    window.on("request", lambda request: asked.append(request.url))
    window.on("console", lambda word: said.append(word.text) if word.type == "error" else None)
    window.on("pageerror", lambda error: said.append(str(error)))
    wrong = []
    for page in pages:
        asked.clear()
        said.clear()
        window.goto(page.as_uri(), wait_until="load", timeout=PAGE_PATIENCE_MS)
        state = window.evaluate(STATE)
        inside = manual.html.as_uri() + "/"
        strangers = [url for url in asked if not url.startswith((inside, "data:", "blob:"))]
        found = {
            "asks for": strangers,
            "complains": said,
            "shows no": state["empty"],
            "formulas": [] if state["formulas"] >= read(page).formulas and not state["failed"] else [state["formulas"]],
            "is too wide": [] if state["over"] <= 0 else [state["over"], *state["wide"]],
        }
        wrong += [f"{manual.name(page)} at {width} px {what}: {found[what]}" for what in found if found[what]]
    window.close()
    return wrong


@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_shows_the_written_pages(manual: Manual, browser: Any, width: int) -> None:
    pages = tuple(page for page in manual.pages if page.parent == manual.html)
    assert complaints(manual, browser, width, pages) == []
    assert sum(read(page).formulas for page in pages) > 0, "no formula anywhere"


def test_a_browser_shows_the_reference_on_a_phone(manual: Manual, browser: Any) -> None:
    pages = tuple(page for page in manual.pages if page.parent != manual.html)
    assert complaints(manual, browser, 390, pages) == []


def test_what_is_sought_is_found(manual: Manual, browser: Any) -> None:
    window = browser.new_page()
    asked: list[str] = []
    window.on("request", lambda request: asked.append(request.url))
    window.goto(f"{(manual.html / 'search.html').as_uri()}?q=holder", timeout=PAGE_PATIENCE_MS)
    window.wait_for_selector("#search-results li a[href^='holder.html']", timeout=PAGE_PATIENCE_MS)
    assert [url for url in asked if not url.startswith(manual.html.as_uri())] == []
    window.close()
