"""The watch page in a real browser: a whole study, a kill, the keyboard, Pause, names, a phone."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from helpers.served_pages import address_of, command, served

pytest.importorskip("starlette", reason="the watch page needs the extra web")
pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")

from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run, find_runs

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(sys.platform == "win32", reason="the virtual rig's pseudo-terminals do not exist on Windows"),
]

MAX_S = 60.0
AUDIT, MIN_CONTRAST = Path(__file__).parents[1] / "helpers" / "page_audit.js", 4.5
STUDY = """
out = "runs"
[study]
textures = [1, 4]
prints = [{ printer = "bambu-p1p", filament = "pla-minus" }]
[protocol]
positions.grid = { x_mm = [4.0, 9.0], y_mm = [18.0, 23.0] }
targets.forces_n = [0.5, 1.5]
targets.bands_n = [0.02, 0.02]
repeats = 1
checks.stationary_frames = 1
[stage]
driver = "virtual-grbl"
options = { speed = SPEED, faults = FAULTS }
[gauge]
driver = "virtual-serial"
[sensor]
driver = "simulated"
"""


def until(condition: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + MAX_S
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.02)
    raise AssertionError("it did not happen in time")


def file_of(folder: Path, speed: float, *faults: str) -> Path:
    path = folder / "study.toml"
    path.write_text(STUDY.replace("SPEED", str(speed)).replace("FAULTS", str(list(faults))))
    return path


@contextmanager
def pressing(folder: Path, speed: float, *faults: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the study with its page; yield the process and the address of the page."""
    with command("acquire", str(file_of(folder, speed, *faults)), "--page") as process:
        try:
            yield process, address_of(process)
        finally:
            process.kill()


def open_tab(browser: Any, address: str, **options: Any) -> Any:
    tab = browser.new_page(**{"viewport": {"width": 1280, "height": 900}, **options})
    tab.set_default_timeout(1000.0 * MAX_S)
    tab.goto(address)
    return tab


def confirm(tab: Any, label: str) -> None:
    tab.get_by_text(f"Put the block with the label {label} into the holder").wait_for()
    assert tab.get_by_role("img", name=f"The underside of the block, with the label {label}").is_visible()
    tab.get_by_label("Its label").fill(label)
    tab.get_by_role("button", name="Block is in").click()


def rows(folder: Path) -> int:
    return sum(len(Run.open(path).rows) for path in find_runs([folder / "runs"]))


def test_a_whole_study_is_made_by_the_page(browser: Any, tmp_path: Path) -> None:
    with pressing(tmp_path, 50.0) as (process, address):
        tab = open_tab(browser, address)
        requests: list[str] = []
        messages: list[str] = []
        tab.on("request", lambda request: requests.append(request.url))
        tab.on("console", lambda message: messages.append(message.text))
        tab.on("pageerror", lambda error: messages.append(str(error)))
        for label in ("T1 PAPER X1 01", "T4 PAPER X1 01"):
            confirm(tab, label)
            tab.locator("#status", has_text="Pressing").wait_for()
        tab.locator("#status", has_text="The session has ended (done): 2 runs complete").wait_for()
        assert process.wait(timeout=MAX_S) == 0
        assert tab.locator("#runs li").all_inner_texts() == [
            f"texture-{number}_paper_x1_bambu-p1p_pla-minus_copy01 8 of 8 presses" for number in (1, 4)
        ]
        assert all(url.startswith(address) or url == "data:," for url in requests)
        assert [text for text in messages if "WebSocket" not in text] == [], "the socket ends with the run"
    assert [check_run(folder).findings for folder in find_runs([tmp_path / "runs"])] == [(), ()]


def test_a_study_by_the_page_survives_a_kill_and_a_dead_stage(browser: Any, tmp_path: Path) -> None:
    """The same command resumes the study, and everything else is done on the page."""
    saved = 0
    for end in ("kill", "dead stage", "done"):
        faults = ["unplug where=stage after_bytes=15000"] if end == "dead stage" else []
        with pressing(tmp_path, 25.0, *faults) as (process, address):
            tab = open_tab(browser, address)
            confirm(tab, "T1 PAPER X1 01")
            tab.locator("#status", has_text="Pressing").wait_for()
            if end == "done":
                confirm(tab, "T4 PAPER X1 01")
                tab.locator("#status", has_text="The session has ended (done): 2 runs complete").wait_for()
                assert process.wait(timeout=MAX_S) == 0
                break
            if end == "kill":
                until(lambda: rows(tmp_path) > 0)
                process.kill()
                process.wait(timeout=MAX_S)
                tab.get_by_role("alert").wait_for()
            else:
                assert process.wait(timeout=MAX_S) == 3
                tab.locator("#status", has_text="The session has ended (failed)").wait_for()
            tab.close()
        assert saved <= rows(tmp_path) < 8
        saved = rows(tmp_path)
    for folder in find_runs([tmp_path / "runs"]):
        assert sorted(row.number for row in Run.open(folder).rows) == list(range(1, 9))
        assert check_run(folder).findings == ()


def test_the_keyboard_pauses_and_continues_and_controls_have_names(browser: Any, tmp_path: Path) -> None:
    with pressing(tmp_path, 10.0) as (_, address):
        tab = open_tab(browser, address)
        field = tab.get_by_label("Its label")
        field.wait_for()
        assert tab.locator("#question-text").get_attribute("role") == "alert"
        field.focus()
        tab.keyboard.type("T4 PAPER X1 01")
        tab.keyboard.press("Enter")
        tab.get_by_role("alert").filter(has_text="is not the label of this block").wait_for()
        assert not list((tmp_path / "runs").glob("*/run.json"))
        field.fill("t1 paper x1 01")
        tab.keyboard.press("Enter")
        tab.locator("#newest").wait_for()
        tab.get_by_role("button", name="Pause").focus()
        tab.keyboard.press("Space")
        tab.get_by_role("button", name="Continue").wait_for()
        assert tab.locator("#status").inner_text().startswith("Paused.")
        assert tab.locator("#status").get_attribute("aria-live") == "polite"
        tab.wait_for_timeout(3000)  # a press that is under way is finished
        held = rows(tmp_path)
        tab.wait_for_timeout(2500)
        assert rows(tmp_path) == held
        audit = tab.evaluate(AUDIT.read_text(encoding="utf-8").partition("\n")[2])
        assert (audit["nameless"], audit["repeated"]) == ([], [])
        assert len(audit["contrasts"]) > 20
        assert [row for row in audit["contrasts"] if row[1] < MIN_CONTRAST] == []
        pictures = tab.locator("img:visible, svg[role=img]:visible").all()
        assert all(picture.get_attribute("alt") or picture.get_attribute("aria-label") for picture in pictures)
        tab.set_viewport_size({"width": 390, "height": 844})
        tab.wait_for_timeout(300)
        assert tab.evaluate("document.scrollingElement.scrollWidth") == 390
        columns = {round(box["x"]) for box in (each.bounding_box() for each in tab.locator("section:visible").all())}
        assert len(columns) == 1, "a phone shows one column"
        assert tab.locator("#stop").bounding_box()["height"] >= 40
        tab.keyboard.press("Space")
        tab.get_by_role("button", name="Pause").wait_for()
        until(lambda: rows(tmp_path) > held)


def test_watch_shows_a_study_that_is_over_without_buttons(browser: Any, tmp_path: Path) -> None:
    assert subprocess.run([sys.executable, "-m", "tacbench_cad", "acquire", file_of(tmp_path, 100.0)]).returncode == 0
    with served("watch", str(tmp_path / "runs")) as address:
        tab = open_tab(browser, address)
        tab.locator("#newest").wait_for()
        tab.locator("#marker-words", has_text="markers found").wait_for()
        tab.locator("#findings-words", has_text="Nothing is wrong").wait_for()
        assert tab.locator("#map td").count() == 4
        assert all(abs(float(text)) <= 1.0 for text in tab.locator("#map td").all_inner_texts())
        assert tab.locator("#force polyline.old").count() == 8 and tab.locator("#force circle").count() == 8
        assert tab.locator("#newest").evaluate("image => image.naturalWidth") > 100
        assert [tab.locator(name).is_visible() for name in ("#buttons", "#question")] == [False, False]
        tab.get_by_role("link", name="texture-1_paper").click()
        tab.locator("#counts", has_text="texture-1_paper").wait_for()
        assert tab.locator("#runs a[aria-current]").inner_text().startswith("texture-1")
    tab.get_by_role("alert").filter(has_text="The page has lost its connection").wait_for()
