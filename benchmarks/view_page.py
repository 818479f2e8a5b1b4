"""Measure the size of the 3D page of the whole set, and the time until a browser shows the first picture.

    python benchmarks/view_page.py [--runs 5] [--preset paper]

Debian's Chromium without a screen draws with the processor alone (SwiftShader). Every round uses a fresh browser with
a fresh profile. The figure is the median time from the start of navigation to the first picture, measured by the page
itself. Claim: less than 5 MB and less than 4 seconds, at 1200 and at 390 pixels.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from tacbench_cad.making.request import Request
from tacbench_cad.making.showing import request_of, scene_of
from tacbench_cad.render.viewing.page import write_page

FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZES = ((1200, 800), (390, 844))
MAX_BYTES, MAX_S = 5_000_000, 4.0


def first_picture_s(page: Path, size: tuple[int, int]) -> float:
    """Return the time until the first picture in a new browser, in s."""
    flags = [*FLAGS, "--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else FLAGS
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
        tab.goto(page.as_uri())
        tab.wait_for_selector("body[data-ready]", state="attached", timeout=60_000)
        seconds = float(tab.evaluate("Number(document.body.dataset.ready)")) / 1000.0
        browser.close()
    return seconds


def main() -> int:
    """Print the table; the exit code is 1 if the claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5, help="rounds (default 5)")
    parser.add_argument("--preset", default="paper", help="paper (default) or released")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "view.html"
        start = time.perf_counter()
        scene = scene_of(request_of((), Request(preset=options.preset)))
        built = time.perf_counter()
        write_page(scene, page)
        written = time.perf_counter()
        size = page.stat().st_size
        print(f"{len(scene.things)} parts, {sum(len(part.mesh.faces) for part in scene.things):,} triangles")
        print(f"parts built in {built - start:.1f} s, page written in {written - built:.1f} s")
        print(f"page: {size / 1e6:.2f} MB (claim: below {MAX_BYTES / 1e6:g})")
        holds = size < MAX_BYTES
        for width, height in SIZES:
            times = [first_picture_s(page, (width, height)) for _ in range(options.runs)]
            median = statistics.median(times)
            holds = holds and median < MAX_S
            print(f"first picture at {width} x {height}: median {median:.2f} s, worst {max(times):.2f} s")
    print(f"claim: {'holds' if holds else 'DOES NOT HOLD'}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
