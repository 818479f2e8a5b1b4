"""The design page in a real browser: pictures, sliders, files, the keyboard, names for screen readers, a phone."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.served_pages import served

pytest.importorskip("starlette", reason="the design page needs the extra web")
pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")

from PIL import Image
from trimesh import load

from tacbench_cad.spec.families import equation1
from tacbench_cad.spec.texture_files import read_texture
from tacbench_cad.util.types import Bytes

pytestmark = pytest.mark.real

#: The time limits, in ms. They are far above the figures of benchmarks/design_page.py: this machine may be busy.
MAX_MS = 60_000
#: A script that looks for controls without names and texts without contrast, and the contrast of level AA.
AUDIT, MIN_CONTRAST = Path(__file__).parents[1] / "helpers" / "page_audit.js", 4.5
#: The number of pictures so far; the page's policy does not allow the browser to wait for an expression.
PICTURES = "() => Number(document.body.dataset.pictures || 0)"


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("design") / "out"


@pytest.fixture(scope="module")
def address(out: Path) -> Iterator[str]:
    with served("design", "2", "-o", str(out)) as found:
        yield found


@pytest.fixture
def page(browser: Any, address: str) -> Iterator[Any]:
    """Return the page with its first picture; at the end, nothing was loaded from elsewhere and nothing was logged."""
    clipboard = ["clipboard-read", "clipboard-write"]
    context = browser.new_context(viewport={"width": 1280, "height": 900}, permissions=clipboard)
    tab = context.new_page()
    requests: list[str] = []
    messages: list[str] = []
    tab.on("request", lambda request: requests.append(request.url))
    tab.on("console", lambda message: messages.append(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: messages.append(str(error)))
    tab.goto(address)
    tab.wait_for_selector("body[data-ready]", state="attached", timeout=MAX_MS)
    settle(tab)
    yield tab
    context.close()
    assert messages == []
    loaded = {url.removeprefix(address).partition("?")[0] for url in requests}
    files = {"", "page.css", "page.js", "block.html", "ask"}
    assert files <= {name for name in loaded if not name.startswith("blob:")} <= {*files, "upload", "data:,"}


def settle(tab: Any, status: str = "Relief") -> None:
    """Wait until the facts of the last state are shown."""
    tab.wait_for_timeout(600)
    tab.locator("#status", has_text=status).wait_for(timeout=MAX_MS)


def picture_after(tab: Any, action: Any) -> None:
    """Do something and wait for the next picture."""
    before = tab.evaluate(PICTURES)
    action()
    for _ in range(MAX_MS // 50):
        if tab.evaluate(PICTURES) > before:
            return
        tab.wait_for_timeout(50)
    raise AssertionError("no picture followed")


def shot(tab: Any, selector: str) -> Bytes:
    return np.asarray(Image.open(io.BytesIO(tab.locator(selector).screenshot())).convert("RGB"))


def changed(first: Bytes, second: Bytes) -> float:
    """Return the fraction of pixels that differ clearly."""
    return float((np.abs(first.astype(int) - second.astype(int)).max(axis=2) > 24).mean())


def slider(tab: Any, path: str) -> Any:
    return tab.locator(f'input[data-path="{path}"]')


def test_the_block_the_cut_and_the_facts_follow_a_slider(page: Any) -> None:
    pictures = {name: shot(page, name) for name in ("#block", "#cut")}
    assert len(np.unique(pictures["#block"].reshape(-1, 3), axis=0)) > 500, "the block is shaded"
    assert "Relief 4 mm" in page.inner_text("#status")
    assert page.inner_text("#equation") == "z = sin u + sin(v + 1.5708)"
    field = page.get_by_label("Amplitude A1 along x, number")
    picture_after(page, lambda: field.fill("0.25"))
    settle(page, "Relief 2.5 mm")
    assert float(slider(page, "texture.A1").input_value()) == 0.25
    assert all(changed(picture, shot(page, name)) > 0.01 for name, picture in pictures.items())
    assert "0.25 sin u" in page.inner_text("#equation")
    assert "A1 = 0.25" in page.locator("#toml").input_value()


def test_everything_works_with_the_keyboard(page: Any, out: Path) -> None:
    page.get_by_label("Name").focus()
    page.keyboard.press("ControlOrMeta+A")
    page.keyboard.type("typed")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.dataset.path") == "texture.A1"
    for key in ("ArrowRight", "ArrowUp", "PageDown", "ArrowLeft"):
        picture_after(page, lambda key=key: page.keyboard.press(key))
    assert page.get_by_label("Amplitude A1 along x, number").input_value() == "0.91"
    page.locator("#block").focus()
    before = shot(page, "#block")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("+")
    page.wait_for_timeout(1000)
    assert changed(before, shot(page, "#block")) > 0.05
    settle(page)
    for box in ("3MF", "STEP"):
        page.get_by_role("checkbox", name=box).focus()
        page.keyboard.press("Space")
    page.get_by_role("button", name="Write the files").focus()
    page.keyboard.press("Enter")
    settle(page, "Wrote 2 files")
    assert page.locator("#files li").all_inner_texts() == ["typed_paper_x1.stl", "typed.toml"]
    assert load(out / "typed_paper_x1.stl").is_watertight
    assert read_texture(out / "typed.toml").surface == equation1(0.91, 1.0, 1.0, 1.0, np.pi / 2.0)
    page.get_by_role("button", name="Copy the texture file").focus()
    page.keyboard.press("Enter")
    settle(page, "Copied")
    assert page.evaluate("navigator.clipboard.readText()") == (out / "typed.toml").read_text(encoding="utf-8")


def test_files_are_opened_and_dropped_and_errors_are_announced(page: Any, tmp_path: Path) -> None:
    rows, columns = np.mgrid[:60, :80]
    values = 127 + 60 * np.sin(columns / 6.0) + 60 * np.cos(rows / 9.0)
    Image.fromarray(values.astype(np.uint8)).save(tmp_path / "map.png")
    picture_after(page, lambda: page.get_by_label("or open a file").set_input_files(tmp_path / "map.png"))
    settle(page, "Relief 1.0")
    assert "map.png, 80 x 60 samples" in page.inner_text("#equation")
    (tmp_path / "bad.toml").write_text('[texture]\nname = "bad"\nfamily = "serie"\n', encoding="utf-8")
    drop = """(text) => { const data = new DataTransfer(); data.items.add(new File([text], "bad.toml"));
        document.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true, cancelable: true })); }"""
    page.evaluate(drop, (tmp_path / "bad.toml").read_text(encoding="utf-8"))
    alert = page.get_by_role("alert")
    alert.wait_for(timeout=MAX_MS)
    assert "'series'" in alert.inner_text()
    page.get_by_label("Height (mm), number").fill("1")
    page.get_by_role("status").filter(has_text="This block cannot be made").wait_for(timeout=MAX_MS)
    assert "use a height of at least" in alert.inner_text()
    page.get_by_label("Height (mm), number").fill("7")
    settle(page)
    assert not alert.is_visible()


def test_controls_have_names_and_texts_have_contrast(page: Any) -> None:
    page.get_by_label("Begin with").select_option("three waves")
    settle(page)
    audit = page.evaluate(AUDIT.read_text(encoding="utf-8").partition("\n")[2])
    assert (audit["nameless"], audit["repeated"]) == ([], [])
    assert len(audit["contrasts"]) > 40
    assert [row for row in audit["contrasts"] if row[1] < MIN_CONTRAST] == []
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.locator("h1").count() == 1 and page.title()
    names = page.locator("#controls legend").all_inner_texts()
    assert names[:5] == ["Texture", "Wave 1", "Wave 2", "Wave 3", "Scale of the formula"]
    page.get_by_role("button", name="Add a wave").click()
    page.get_by_role("group", name="Wave 4").wait_for(timeout=MAX_MS)
    assert page.locator("#block").get_attribute("title").startswith("The block in 3D: size 23.3 x 30 x 7 mm, relief")


def test_the_page_says_when_the_server_has_stopped(browser: Any, tmp_path: Path) -> None:
    tab = browser.new_page()
    with served("design", "1", "-o", str(tmp_path)) as address:
        tab.goto(address)
        tab.wait_for_selector("body[data-ready]", state="attached", timeout=MAX_MS)
    tab.get_by_role("alert").filter(has_text="The server has stopped").wait_for(timeout=MAX_MS)
    tab.close()
