"""Take the picture of the design page for the manual: ``python docs/design_picture.py TEXTURE FILE.png``.

It needs Chromium and Playwright.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile

from playwright.sync_api import sync_playwright

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MAX_MS = 120_000


def main(texture: str, target: str) -> None:
    """Start the command, open its page, and save a picture with the facts about the block."""
    command = [sys.executable, "-m", "tacbench_cad", "design", texture, "--no-browser"]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=folder) as server,
        sync_playwright() as playwright,
    ):
        assert server.stderr is not None
        address = server.stderr.readline().split()[1]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        tab = browser.new_page(viewport={"width": 1280, "height": 860})
        tab.goto(address)
        tab.get_by_role("status").filter(has_text="Relief").wait_for(timeout=MAX_MS)
        tab.wait_for_timeout(3000)
        tab.screenshot(path=target)
        browser.close()
        server.send_signal(signal.SIGINT)


if __name__ == "__main__":
    main(*sys.argv[1:])
