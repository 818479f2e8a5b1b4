"""The manual: outputs are current, every block is run, no page loads files from elsewhere, and a browser shows it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from difflib import unified_diff
from pathlib import Path
from typing import Any

import pytest
from helpers.cases import mostly_long
from helpers.checkout import ROOT, Once

pytest.importorskip("sphinx", reason="the manual needs the extra docs")

from markdown_it import MarkdownIt

sys.path.insert(0, str(ROOT / "docs"))

import renew

pytestmark = pytest.mark.real

#: The time limits for renewing a page and for the build, in s, and for one page in the browser, in ms.
MAX_RENEWAL_S, MAX_BUILD_S, MAX_PAGE_MS = 3600.0, 1800.0, 60_000
PAGES = sorted((ROOT / "docs").glob("*.md"))
NAMES = [path.stem for path in PAGES] + ["api/index"]
#: The pages that are always renewed. ``make docs`` and the long tests renew all.
RENEWED = ("start", "textures", "view", "commands", "api/index")
#: The languages of blocks that are shown and not run.
SHOWN = {"sh", "text", "toml", "csv", "json", "bibtex", "gcode", "xml", "yaml"}


@pytest.fixture(scope="session")
def html(once: Once, source: Path) -> Path:
    """Build the manual of a clean checkout with the command of the Makefile, and return the folder of its pages."""
    recipe = re.search(r"sphinx-build (.*) docs docs/_build/html$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe, "the Makefile builds the manual with another command"

    def fill(folder: Path) -> None:
        tree = shutil.copytree(source, folder / "tree")
        command = [sys.executable, "-m", "sphinx", *recipe[1].split(), "--no-color", "docs", folder / "html"]
        process = subprocess.run(
            command, cwd=tree, capture_output=True, text=True, timeout=MAX_BUILD_S, stdin=subprocess.DEVNULL
        )
        (folder / "messages.txt").write_text(process.stderr if process.returncode else "", encoding="utf-8")

    return once("manual", fill) / "html"


def test_the_manual_is_built_without_a_warning(html: Path) -> None:
    assert (html.parent / "messages.txt").read_text(encoding="utf-8")[-6000:] == ""
    assert [path.stem for path in PAGES if not (html / f"{path.stem}.html").is_file()] == []
    assert list((html / "api").rglob("*.html")), "no reference"


def test_every_block_of_code_is_run() -> None:
    wrong = []
    for page in PAGES:
        for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
            language, *words = token.info.split() if token.type == "fence" else ("",)
            runs = {word.partition("=")[0] for word in words} & {"run", "write", "from", "output"}
            if token.type == "code_block" or (token.type == "fence" and not runs and language not in SHOWN):
                wrong.append(f"{page.name}: {token.info or token.content.strip()[:60]!r} is not run")
    assert wrong == []


def without_numbers(text: str) -> str:
    """Return a page with its numbers and gaps replaced. Another processor or version of Python may change numbers."""
    return renew.GAPS.sub(" ", re.sub(r"[-+]?\d[\d.,]*", "0", text))


@pytest.mark.parametrize("name", mostly_long(NAMES, *RENEWED))
def test_outputs_and_pictures_are_up_to_date(name: str, once: Once, source: Path) -> None:
    tree = once("renewal", lambda folder: shutil.copytree(source, folder, dirs_exist_ok=True) and None)
    # The commands of the pages must import the copy and not the project.
    process = subprocess.run(
        [sys.executable, "docs/renew.py", name],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        timeout=MAX_RENEWAL_S,
        stdin=subprocess.DEVNULL,
    )
    assert process.returncode == 0, process.stdout + process.stderr
    old, new = (folder / "docs" / f"{name}.md" for folder in (source, tree))
    texts = [file.read_text(encoding="utf-8") for file in (old, new)]
    lines = unified_diff(*(text.splitlines() for text in texts), "committed", "renewed", lineterm="", n=1)
    assert without_numbers(texts[0]) == without_numbers(texts[1]), "run make docs and commit:\n" + "\n".join(lines)
    for picture in (tree / "docs" / "images" / name).glob("*.webp"):
        committed = source / picture.relative_to(tree)
        assert committed.is_file() and committed.read_bytes() == picture.read_bytes(), f"{picture.name} looks different"


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


@pytest.mark.parametrize(
    ("folder", "width"), mostly_long([("", 1200), ("", 390), ("api", 1200), ("api", 390)], ("", 390))
)
def test_a_browser_shows_the_pages(html: Path, browser: Any, folder: str, width: int) -> None:
    """Each page opens from the disk, loads no file from elsewhere, and shows its pictures and formulas."""
    window = browser.new_page(viewport={"width": width, "height": 800})
    requests: list[str] = []
    messages: list[str] = []
    window.on("request", lambda request: requests.append(request.url))
    window.on("console", lambda word: messages.append(word.text) if word.type == "error" else None)
    window.on("pageerror", lambda error: messages.append(str(error)))
    wrong, formulas = [], 0
    for page in sorted((html / folder).glob("**/*.html" if folder else "*.html")):
        requests.clear()
        messages.clear()
        window.goto(page.as_uri(), wait_until="load", timeout=MAX_PAGE_MS)
        state = window.evaluate(STATE)
        formulas += state["formulas"]
        findings = {
            "requests": [url for url in requests if not url.startswith((html.as_uri() + "/", "data:", "blob:"))],
            "reports errors": messages,
            "does not show": state["empty"],
            "has wrong formulas": state["failed"],
            "is too wide": [] if state["over"] <= 0 else [state["over"], *state["wide"]],
        }
        wrong += [f"{page.name} {kind}: {findings[kind]}" for kind in findings if findings[kind]]
    window.close()
    assert wrong == []
    assert formulas > 0 or folder, "no formula anywhere"
