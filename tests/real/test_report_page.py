"""The report in a real browser: the first screen, no content cut off, and the pages in A4."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from helpers.studies import write_study

pytest.importorskip("sklearn", reason="a report with a classification needs the extra analysis")
pytest.importorskip("matplotlib", reason="a report needs the extra analysis")
pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")

from tacbench_cad.lab import read
from tacbench_cad.lab import report as write_report

pytestmark = pytest.mark.real

#: The sides of A4 in points of PDF, and the width and height inside the page margins of 15 mm in pixels of CSS.
A4_PT = (595.28, 841.89)
PRINTED_PX = (180.0 * 96.0 / 25.4, 267.0 * 96.0 / 25.4)
MAX_PAGES = 20

#: The box of an element on the page.
BOX = "(e) => { const box = e.getBoundingClientRect(); return [box.right, box.bottom, box.width, box.height]; }"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a report with every section about simulated data, with a long list of simulated devices."""
    folder = tmp_path_factory.mktemp("report")
    simulated = "simulated TacTip; " + "; ".join(f"block from a virtual printer, number {n}" for n in range(9))
    write_study(folder / "runs", textures=(1, 2, 3, 4, 5, 6), simulated=simulated, levels=(1, 2))
    write_report(read(folder / "runs"), folder / "report.html")
    return folder / "report.html"


def open_report(browser: Any, report: Path, width: int, height: int, media: str | None = None) -> tuple[Any, list[str]]:
    """Open the report in a window of the given size; return the page, and a list of its requests and messages."""
    page = browser.new_page(viewport={"width": width, "height": height})
    events: list[str] = []
    page.on("request", lambda request: events.append(request.url))
    page.on("console", lambda message: events.append(message.text))
    if media is not None:  # the PDF also uses this setting
        page.emulate_media(media=media)
    page.goto(report.as_uri())
    return page, [event for event in events if event != report.as_uri() and not event.startswith("data:")]


def boxes(page: Any, selector: str) -> list[list[float]]:
    """Return the right end, the lower end, the width and the height of elements, in pixels."""
    return [element.evaluate(BOX) for element in page.locator(selector).all()]


@pytest.mark.parametrize(("width", "height"), [(1366, 768), (390, 844)])
def test_the_first_screen_shows_the_answers_and_nothing_is_wider(
    browser: Any, report: Path, width: int, height: int
) -> None:
    page, events = open_report(browser, report, width, height)
    assert events == []
    assert page.evaluate("document.scrollingElement.scrollWidth") == width
    assert len(boxes(page, "dd")) == 5
    assert all(bottom < height for _, bottom, _, _ in boxes(page, "dd"))
    if width > 1000:
        assert boxes(page, "figure img")[0][1] < height, "five sentences and the figure must be on the first screen"
    assert not page.locator("details table").first.is_visible()
    page.locator("summary").nth(1).click()
    assert page.locator("details#design table").first.is_visible()
    page.close()


def test_on_paper_everything_is_open_and_nothing_is_cut(browser: Any, report: Path) -> None:
    width, height = PRINTED_PX
    page, _ = open_report(browser, report, int(width), int(height), "print")
    assert page.evaluate("document.scrollingElement.scrollWidth") <= width
    for selector in ("table", "img", "p", "li", "pre"):
        for right, _, box_width, box_height in boxes(page, selector):
            assert box_width > 0 and box_height > 0, f"a {selector} is folded away"
            assert right <= width + 0.5, f"a {selector} leaves the page"
    assert all(box_height < height for _, _, _, box_height in boxes(page, "figure")), "a figure is longer than a page"
    cut = "(cell) => cell.scrollWidth > cell.clientWidth + 1"
    assert not any(cell.evaluate(cut) for cell in page.locator("th, td, figcaption").all())
    assert boxes(page, "figure")[0][1] < height, "five sentences and the figure must be on page 1"
    page.close()


def test_its_pdf_has_pages_of_a4(browser: Any, report: Path) -> None:
    page, _ = open_report(browser, report, 1366, 768)
    data: bytes = page.pdf(prefer_css_page_size=True)
    page.close()
    sizes = re.findall(rb"/MediaBox ?\[ ?0 0 ([\d.]+) ([\d.]+) ?\]", data)
    assert 5 <= len(sizes) <= MAX_PAGES, "folded sections must be printed"
    for size in sizes:
        assert tuple(map(float, size)) == pytest.approx(A4_PT, abs=1.0)
    title = re.search(rb"/Title ?(.*)", data)
    assert title and rb"\(simulated\)" in title[1]
