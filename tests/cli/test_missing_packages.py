"""A command that needs a package of an extra that is not installed says which, and how to install it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from studies import write_study

CODE = """
import sys
blocked = sys.argv[1]
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker())
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name == blocked else found(name, *rest)
from tacbench_cad.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize(
    ("module", "words", "needles"),
    [
        ("joblib", ["variance", "{runs}"], ["joblib", "tacbench-cad[analysis]"]),
        ("joblib", ["classify", "{runs}", "-o", "{out}"], ["joblib", "tacbench-cad[analysis]"]),
        ("cv2", ["runs", "check", "{runs}"], ["opencv-python-headless", "tacbench-cad[lab]"]),
        ("serial", ["rig", "probe"], ["pyserial", "tacbench-cad[lab]"]),
        ("matplotlib", ["report", "{runs}", "-o", "{out}/report.html", "--no-classify"], ["matplotlib", "plot"]),
    ],
)
def test_a_missing_package_is_named_in_one_line(
    tmp_path: Path, module: str, words: list[str], needles: list[str]
) -> None:
    write_study(tmp_path / "runs", textures=(1,), copies=2, still=0)
    places = {"runs": tmp_path / "runs", "out": tmp_path / "out"}
    argv = [word.format(**places) for word in words]
    done = subprocess.run([sys.executable, "-c", CODE, module, *argv], capture_output=True, text=True, timeout=120)
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr and len(errors) == 1
    for needle in needles:
        assert needle in errors[0]
