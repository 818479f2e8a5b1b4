"""A command that needs a package of an extra that is not installed says which, and how to install it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import write_study

CODE = """
import sys
blocked = sys.argv[1].split(",")
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker())
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in blocked else found(name, *rest)
from tacbench_cad.cli import main
sys.exit(main(sys.argv[2:]))
"""


#: The modules of extra analysis.
ANALYSIS = "serial,cv2,matplotlib,sklearn,joblib"


@pytest.mark.parametrize(
    ("modules", "words", "needles"),
    [
        ("joblib", ["variance", "{runs}"], ["joblib", "tacbench-cad[analysis]"]),
        ("joblib", ["classify", "{runs}", "-o", "{out}"], ["joblib", "tacbench-cad[analysis]"]),
        ("cv2", ["runs", "check", "{runs}"], ["opencv-python-headless", "tacbench-cad[lab]"]),
        ("serial", ["rig", "probe"], ["pyserial", "tacbench-cad[lab]"]),
        ("matplotlib", ["report", "{runs}", "-o", "{out}/report.html", "--no-classify"], ["matplotlib", "plot"]),
        ("matplotlib", ["report", "{runs}", "-o", "{folder}/report.html", "--no-classify"], ["matplotlib", "plot"]),
        ("sklearn", ["report", "{runs}", "-o", "{folder}/report.html"], ["scikit-learn", "tacbench-cad[analysis]"]),
        ("cv2", ["runs", "export", "{runs}", "--to", "tactile-data", "--out", "{out}"], ["tacbench-cad[lab]"]),
        ("cv2", ["runs", "export", "{runs}", "--to", "tactile-data"], ["opencv-python-headless", "tacbench-cad[lab]"]),
        ("cv2", ["import", "{authors}", "--out", "{out}"], ["opencv-python-headless", "tacbench-cad[lab]"]),
        (ANALYSIS, ["classify", "{runs}", "-o", "{out}"], ["scikit-learn", "tacbench-cad[analysis]"]),
        (ANALYSIS, ["report", "{runs}", "-o", "{folder}/report.html"], ["scikit-learn", "tacbench-cad[analysis]"]),
        (ANALYSIS, ["compare", "{runs}", "{others}", "-o", "{out}/b"], ["scikit-learn", "tacbench-cad[analysis]"]),
        (ANALYSIS, ["variance", "{runs}", "-o", "{out}"], ["joblib", "tacbench-cad[analysis]"]),
    ],
)
def test_a_missing_package_is_named_in_one_line_and_nothing_is_left(
    tmp_path: Path, modules: str, words: list[str], needles: list[str]
) -> None:
    for name in ("runs", "others"):
        write_study(tmp_path / name, textures=(1,), copies=2, still=0)
    authors = tmp_path / "PLAminus_z0_P30_Bambu.npy"
    np.lib.format.open_memmap(authors, mode="w+", dtype=np.uint8, shape=(50, 480, 640, 3)).flush()
    before = sorted(tmp_path.rglob("*"))
    places = {"folder": tmp_path, "out": tmp_path / "out", "authors": authors}
    places |= {name: tmp_path / name for name in ("runs", "others")}
    argv = [word.format(**places) for word in words]
    done = subprocess.run([sys.executable, "-c", CODE, modules, *argv], capture_output=True, text=True, timeout=120)
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr and len(errors) == 1
    for needle in needles:
        assert needle in errors[0]
    assert sorted(tmp_path.rglob("*")) == before
