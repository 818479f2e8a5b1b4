"""The example for CAD viewers: in CQ-editor's way, and in OCP CAD Viewer with its page in a browser."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from helpers.checkout import ROOT
from helpers.outsiders import PATIENCE_S, free_port

pytest.importorskip("OCP", reason="solids need the extra cad")

from housing import Holder, Jig
from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real

EXAMPLE = ROOT / "examples" / "show_in_viewer.py"

#: Builds the script as CQ-editor and other hosts of CQGI do, in a process of its own.
HOST = """
import json, pathlib, sys
from cadquery import cqgi
built = cqgi.parse(pathlib.Path(sys.argv[1]).read_text()).build()
if built.exception:
    raise built.exception
(shown,) = built.results
solids = shown.shape.toCompound().Solids()
parts = [name for name, part in shown.shape.objects.items() if part.obj is not None]
print("\\n" + json.dumps([shown.options["name"], parts, [solid.Volume() for solid in solids]]))
"""


def test_a_host_of_cqgi_shows_the_assembly(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOST, str(EXAMPLE)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    name, parts, volumes = json.loads(done.stdout.splitlines()[-1])
    block = Block.of(2, key_mm=3.0)
    holder = Holder(block=block)
    jig = Jig(holder=holder)
    assert name == "print set"
    assert {jig.name, holder.name} <= {part.rpartition("/")[2] for part in parts}
    expected = [block.volume_mm3(block.solid_datum_mm), holder.volume_mm3, jig.volume_mm3]
    assert sorted(volumes) == pytest.approx(sorted(expected), rel=1e-5)


def test_ocp_cad_viewer_shows_the_assembly(browser: Any, tmp_path: Path) -> None:
    """The page shows the names of the parts and draws them, and it loads nothing from another machine."""
    for name in ("ocp_vscode", "ocp_viewer"):
        pytest.importorskip(name, reason=f"{name} is not installed: pip install {name}")
    port = free_port()
    # The viewer writes its settings into the home folder.
    variables = os.environ | {"HOME": str(tmp_path), "OCP_PORT": str(port), "PYTHONPATH": os.pathsep.join(sys.path[1:])}
    command = [sys.executable, "-m", "ocp_viewer", "--port", str(port)]
    with subprocess.Popen(command, cwd=tmp_path, env=variables, stdout=subprocess.DEVNULL) as viewer:
        try:
            address = f"http://127.0.0.1:{port}"
            wait_for(address)
            page, elsewhere = browser.new_page(viewport={"width": 1000, "height": 700}), []
            page.on("request", lambda asked: elsewhere.append(asked.url) if is_elsewhere(asked.url, address) else None)
            page.goto(address)
            page.wait_for_timeout(1500)
            done = subprocess.run(
                [sys.executable, str(EXAMPLE)],
                cwd=tmp_path,
                env=variables,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
                check=False,
            )
            assert done.returncode == 0, done.stderr
            jig = Jig(holder=Holder(block=Block.of(2, key_mm=3.0)))
            page.get_by_text(jig.name).wait_for(timeout=30_000)
            page.get_by_text("print set").wait_for()
            assert page.locator("canvas").count() > 0
            assert elsewhere == []
            page.close()
        finally:
            viewer.terminate()


def is_elsewhere(address: str, here: str) -> bool:
    """Whether an address leads to another machine."""
    return not address.startswith((here, "data:", "blob:"))


def wait_for(address: str) -> None:
    """Wait until a server answers."""
    end = time.monotonic() + 30.0
    while True:
        try:
            urllib.request.urlopen(address, timeout=1.0).close()
            return
        except (urllib.error.URLError, OSError):
            assert time.monotonic() < end, "the viewer did not start"
            time.sleep(0.2)
