"""The manual: outputs and pictures are current, links work, no page loads external files, and a browser shows it."""

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

#: The time limits for renewing all pages and for the build, in s, and for one page in the browser, in ms.
MAX_RENEWAL_S, MAX_BUILD_S, MAX_PAGE_MS = 3600.0, 1800.0, 60_000
#: The external pages that a page may link to. A person has checked each of them.
OUTSIDE = {
    "https://github.com/gnea/grbl/wiki",
    "https://github.com/pradyunsg/furo",
    "https://pradyunsg.me",
    "https://www.iso.org/standard/74591.html",
    "https://www.sphinx-doc.org/",
}
#: The attributes with addresses that a browser fetches.
FETCHED = ("src", "data", "poster", "background", "xlink:href")
#: The relations of links whose targets a browser fetches.
LOADED = {"stylesheet", "icon", "preload", "prefetch", "modulepreload", "manifest"}
#: The languages of blocks that are shown and not run.
SHOWN = {"sh", "text", "toml", "csv", "json", "bibtex", "gcode", "xml", "yaml"}


@dataclass(frozen=True)
class Manual:
    """The result of a build."""

    code: int
    messages: str
    html: Path
    docs: Path

    @property
    def written(self) -> tuple[Path, ...]:
        """The Markdown sources of the pages."""
        return tuple(sorted(self.docs.glob("*.md")))

    def page(self, source: Path) -> Path:
        """Return the HTML page of a source."""
        return self.html / f"{source.stem}.html"

    @property
    def pages(self) -> tuple[Path, ...]:
        """All HTML pages."""
        return tuple(sorted(self.html.rglob("*.html")))

    def name(self, page: Path) -> str:
        """Return the path of a page relative to the first page."""
        return page.relative_to(self.html).as_posix()


@pytest.fixture(scope="session")
def manual(once: Once, source: Path) -> Manual:
    """Build the manual of a clean checkout with the command of the Makefile."""
    recipe = re.search(r"sphinx-build (.*) docs docs/_build/html$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe, "the Makefile builds the manual with another command"

    def fill(folder: Path) -> None:
        tree = shutil.copytree(source, folder / "tree")
        command = [sys.executable, "-m", "sphinx", *recipe[1].split(), "--no-color", "docs", folder / "html"]
        process = subprocess.run(
            command, cwd=tree, capture_output=True, text=True, timeout=MAX_BUILD_S, stdin=subprocess.DEVNULL
        )
        (folder / "messages.json").write_text(json.dumps([process.returncode, process.stderr]), encoding="utf-8")

    folder = once("manual", fill)
    code, messages = json.loads((folder / "messages.json").read_text(encoding="utf-8"))
    if not (folder / "html" / "index.html").is_file():
        pytest.fail(f"nothing was built: {messages[-4000:]}")
    return Manual(code, messages, folder / "html", folder / "tree" / "docs")


@dataclass
class Page(HTMLParser):
    """The links, loaded files, styles and link targets of a page."""

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
        """Collect the links and files that a tag refers to."""
        attributes = {name: value or "" for name, value in attrs}
        classes = attributes.get("class", "").split()
        self.ids |= {attributes[name] for name in ("id", "name") if name in attributes}
        self.fetched += [attributes[name] for name in FETCHED if attributes.get(name)]
        self.fetched += [source.split()[0] for source in attributes.get("srcset", "").split(",") if source.strip()]
        if tag == "link" and LOADED & set(attributes.get("rel", "").split()):
            self.fetched.append(attributes["href"])
        elif "href" in attributes:
            self.links.append(attributes["href"])
        if tag == "img" and not attributes.get("alt", "").strip():
            self.nameless.append(attributes.get("src", "")[:80])
        self.styles.append(attributes.get("style", ""))
        self._style = tag == "style"
        self.formulas += "math" in classes

    def handle_endtag(self, tag: str) -> None:
        """Note the end of a style sheet."""
        self._style = self._style and tag != "style"

    def handle_data(self, data: str) -> None:
        """Collect the style sheets in the page."""
        if self._style:
            self.styles.append(data)


@cache
def read(page: Path) -> Page:
    """Parse a page."""
    parsed = Page()
    parsed.feed(page.read_text(encoding="utf-8"))
    parsed.close()
    return parsed


def addresses(style: str) -> list[str]:
    """Return the addresses in a style sheet that a browser fetches."""
    return [
        address.strip("'\" ")
        for groups in re.findall(r"url\(([^)]*)\)|@import\s+([^;]*)", style)
        for address in groups
        if address
    ]


def is_external(address: str) -> bool:
    """Return whether an address is on another machine."""
    return bool(urlsplit(address).netloc) or urlsplit(address).scheme in ("http", "https", "ftp", "ws", "wss")


def test_the_manual_is_built_without_a_warning(manual: Manual) -> None:
    warnings = [line for line in manual.messages.splitlines() if ": WARNING: " in line or ": ERROR: " in line]
    assert warnings == []
    assert manual.code == 0, manual.messages[-6000:]


def test_there_is_a_page_for_each_source(manual: Manual) -> None:
    names = {manual.name(page) for page in manual.pages}
    assert len(manual.written) >= 20
    assert [path.name for path in manual.written if not manual.page(path).is_file()] == []
    assert [name for name in names if name.startswith("api/")], "no reference"


def test_no_link_is_dead(manual: Manual) -> None:
    dead = []
    for page in manual.pages:
        parsed = read(page)
        for link in [*parsed.links, *parsed.fetched]:
            parts = urlsplit(link)
            if is_external(link) or parts.scheme in ("data", "mailto"):
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            exists = target.is_file() and target.is_relative_to(manual.html.resolve())
            if exists and parts.fragment and target.suffix == ".html":
                exists = unquote(parts.fragment) in read(target).ids
            if not exists:
                dead.append(f"{manual.name(page)}: {link}")
    assert dead == []


def test_external_links_are_known(manual: Manual) -> None:
    links = {(link, manual.name(page)) for page in manual.pages for link in read(page).links if is_external(link)}
    assert {link for link, _ in links} - OUTSIDE == set(), sorted(item for item in links if item[0] not in OUTSIDE)
    assert all(link.startswith("https://") for link, _ in links)


def test_no_page_loads_external_files(manual: Manual) -> None:
    for page in manual.pages:
        parsed = read(page)
        fetched = [*parsed.fetched, *(address for style in parsed.styles for address in addresses(style))]
        assert [address for address in fetched if is_external(address)] == [], manual.name(page)
    for sheet in sorted(manual.html.rglob("*.css")):
        for address in addresses(sheet.read_text(encoding="utf-8")):
            assert not is_external(address), sheet.name
            assert address.startswith(("data:", "#")) or (sheet.parent / urlsplit(address).path).is_file(), (
                f"{sheet.name}: {address}"
            )


def test_pictures_have_an_alternative_text(manual: Manual) -> None:
    pictures_without_text = {manual.name(page): read(page).nameless for page in manual.pages}
    assert {name: pictures for name, pictures in pictures_without_text.items() if pictures} == {}


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
        # The commands of the pages must import the copy and not the project.
        process = subprocess.run(
            command,
            cwd=tree,
            env=os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            timeout=MAX_RENEWAL_S,
            stdin=subprocess.DEVNULL,
        )
        (folder / "messages.json").write_text(
            json.dumps([process.returncode, process.stdout + process.stderr]), encoding="utf-8"
        )

    folder = once("renewal", fill)
    code, messages = json.loads((folder / "messages.json").read_text(encoding="utf-8"))
    assert code == 0, messages[-8000:]
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


#: A script that returns, for a drawn page, its formulas, its missing pictures, and the elements that are too wide.
STATE = """async () => {
    if (window.MathJax && MathJax.startup) await MathJax.startup.promise;
    for (const image of document.images) { image.loading = 'eager'; await image.decode().catch(() => null); }
    const width = document.documentElement.clientWidth;
    const inside = (element) => { for (let up = element.parentElement; up; up = up.parentElement)
        if (getComputedStyle(up).overflowX !== 'visible' && up !== document.body && up !== document.documentElement)
            return true; };
    return {
        formulas: document.querySelectorAll('mjx-container').length,
        failed: document.querySelectorAll('mjx-merror, [data-mjx-error]').length,
        empty: [...document.images].filter((element) => !element.naturalWidth).map((element) => element.src.slice(-80)),
        over: document.scrollingElement.scrollWidth - width,
        wide: [...document.body.querySelectorAll('article *')].filter((element) =>
            element.getBoundingClientRect().right > width + 1 && !inside(element)).slice(0, 3).map((element) =>
            element.tagName + '.' + element.className + ' ' + element.textContent.slice(0, 40)),
    };
}"""


def browser_problems(manual: Manual, browser: Any, width: int, pages: tuple[Path, ...]) -> list[str]:
    """Open the pages from disk, one after another, in a window of the given width, and return the problems."""
    window = browser.new_page(viewport={"width": width, "height": 800})
    requests: list[str] = []
    messages: list[str] = []
    window.on("request", lambda request: requests.append(request.url))
    window.on("console", lambda word: messages.append(word.text) if word.type == "error" else None)
    window.on("pageerror", lambda error: messages.append(str(error)))
    wrong = []
    for page in pages:
        requests.clear()
        messages.clear()
        window.goto(page.as_uri(), wait_until="load", timeout=MAX_PAGE_MS)
        state = window.evaluate(STATE)
        inside = manual.html.as_uri() + "/"
        foreign = [url for url in requests if not url.startswith((inside, "data:", "blob:"))]
        findings = {
            "requests": foreign,
            "reports errors": messages,
            "does not show": state["empty"],
            "formulas": [] if state["formulas"] >= read(page).formulas and not state["failed"] else [state["formulas"]],
            "is too wide": [] if state["over"] <= 0 else [state["over"], *state["wide"]],
        }
        wrong += [f"{manual.name(page)} at {width} px {kind}: {findings[kind]}" for kind in findings if findings[kind]]
    window.close()
    return wrong


@pytest.mark.parametrize("width", [1200, 390])
def test_a_browser_shows_the_pages(manual: Manual, browser: Any, width: int) -> None:
    pages = tuple(page for page in manual.pages if page.parent == manual.html)
    assert browser_problems(manual, browser, width, pages) == []
    assert sum(read(page).formulas for page in pages) > 0, "no formula anywhere"


def test_a_browser_shows_the_reference_on_a_phone(manual: Manual, browser: Any) -> None:
    pages = tuple(page for page in manual.pages if page.parent != manual.html)
    assert browser_problems(manual, browser, 390, pages) == []


def test_the_search_finds_a_page(manual: Manual, browser: Any) -> None:
    window = browser.new_page()
    requests: list[str] = []
    window.on("request", lambda request: requests.append(request.url))
    window.goto(f"{(manual.html / 'search.html').as_uri()}?q=holder", timeout=MAX_PAGE_MS)
    window.wait_for_selector("#search-results li a[href^='holder.html']", timeout=MAX_PAGE_MS)
    assert [url for url in requests if not url.startswith(manual.html.as_uri())] == []
    window.close()
