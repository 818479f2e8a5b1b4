"""Take the pictures of the watch page for the manual: ``python docs/watch_picture.py PAGE.png BLOCK.png``.

It needs Chromium and Playwright. A study on the virtual rig is started and stopped by the page.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

MAX_MS = 240_000
STUDY = """
out = "runs"
[study]
textures = [4, 1]
prints = [{ printer = "bambu-p1p", filament = "pla-minus" }]
[protocol]
repeats = 1
checks.stationary_frames = 2
[stage]
driver = "virtual-grbl"
options = { speed = 30 }
[gauge]
driver = "virtual-serial"
[sensor]
driver = "simulated"
"""


def main(page: str, block: str) -> None:
    """Start the study, confirm the first block, save both pictures, and press Stop."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        study = Path(folder) / "study.toml"
        study.write_text(STUDY)
        command = [sys.executable, "-m", "tacbench_cad", "acquire", str(study), "--page", "--no-browser"]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as run:
            assert run.stderr is not None
            address = run.stderr.readline().split()[1]
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            tab = browser.new_page(viewport={"width": 480, "height": 900})
            tab.set_default_timeout(MAX_MS)
            tab.goto(address)
            tab.get_by_role("button", name="Block is in").wait_for()
            tab.locator("#question").screenshot(path=block)
            tab.set_viewport_size({"width": 1280, "height": 900})
            tab.get_by_label("Its label").fill("T4 PAPER X1 01")
            tab.get_by_role("button", name="Block is in").click()
            tab.locator("#counts", has_text="number 44").wait_for()
            tab.locator("#marker-words", has_text="markers found").wait_for()
            tab.locator("#force polyline.now").wait_for()
            tab.screenshot(path=page, full_page=True)
            tab.get_by_role("button", name="Stop").click()
            run.stderr.read()
            browser.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
