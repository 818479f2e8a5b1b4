"""If a package of an extra is not installed, the command that needs it names the package and its installation."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import write_study

CODE = """
import contextlib, io, json, sys
blocked = sys.argv[1].split(",")
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker())
import importlib.util
find_spec = importlib.util.find_spec
importlib.util.find_spec = lambda name, *rest: None if name in blocked else find_spec(name, *rest)
from pathlib import Path
from tacbench_cad.cli import main
folder = Path(sys.argv[2])
results = []
for words in json.loads(sys.argv[3]):
    with contextlib.redirect_stderr(io.StringIO()) as err:
        code = main(words)
    results.append([code, err.getvalue(), sorted(str(path) for path in folder.rglob("*"))])
print(json.dumps(results))
"""


#: The modules of the extra ``analysis``.
ANALYSIS = "serial,cv2,matplotlib,sklearn"


#: The missing modules, and for each of them the commands with the words that their messages must contain.
MISSING: dict[str, list[tuple[list[str], list[str]]]] = {
    "cv2": [
        (["check-runs", "{runs}"], ["opencv-python-headless", "tacbench-cad[lab]"]),
        (["export-runs", "{runs}", "--to", "tactile-data", "--out", "{out}"], ["tacbench-cad[lab]"]),
        (["export-runs", "{runs}", "--to", "tactile-data"], ["opencv-python-headless", "tacbench-cad[lab]"]),
        (["import-frames", "{authors}", "--out", "{out}"], ["opencv-python-headless", "tacbench-cad[lab]"]),
    ],
    "serial": [(["rig", "probe"], ["pyserial", "tacbench-cad[lab]"])],
    "matplotlib": [
        (["report", "{runs}", "-o", "{out}/report.html", "--no-classify"], ["matplotlib", "plot"]),
        (["report", "{runs}", "-o", "{folder}/report.html", "--no-classify"], ["matplotlib", "plot"]),
    ],
    "sklearn": [(["report", "{runs}", "-o", "{folder}/report.html"], ["scikit-learn", "tacbench-cad[analysis]"])],
    ANALYSIS: [
        (["classify", "{runs}", "-o", "{out}"], ["scikit-learn", "tacbench-cad[analysis]"]),
        (["report", "{runs}", "-o", "{folder}/report.html"], ["scikit-learn", "tacbench-cad[analysis]"]),
        (["compare", "{runs}", "{others}", "-o", "{out}/b"], ["scikit-learn", "tacbench-cad[analysis]"]),
        (["variance", "{runs}", "-o", "{out}"], ["scikit-learn", "tacbench-cad[analysis]"]),
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two studies and a file of the authors. No command may change it."""
    folder = tmp_path_factory.mktemp("missing")
    for name in ("runs", "others"):
        write_study(folder / name, textures=(1,), copies=2, still=0)
    authors = folder / "PLAminus_z0_P30_Bambu.npy"
    np.lib.format.open_memmap(authors, mode="w+", dtype=np.uint8, shape=(50, 480, 640, 3)).flush()
    return folder


@pytest.mark.parametrize("modules", MISSING)
def test_a_missing_package_is_named_in_one_line_and_nothing_is_left(folder: Path, modules: str) -> None:
    before = sorted(str(path) for path in folder.rglob("*"))
    places = {"folder": folder, "out": folder / "out", "authors": folder / "PLAminus_z0_P30_Bambu.npy"}
    places |= {name: folder / name for name in ("runs", "others")}
    commands = [[word.format(**places) for word in words] for words, _ in MISSING[modules]]
    argv = [sys.executable, "-c", CODE, modules, str(folder), json.dumps(commands)]
    process = subprocess.run(argv, capture_output=True, text=True, timeout=120)
    assert process.returncode == 0, process.stderr
    results = json.loads(process.stdout.splitlines()[-1])
    for (words, needles), (code, message, files) in zip(MISSING[modules], results, strict=True):
        errors = [line for line in message.splitlines() if line.startswith("error: ")]
        assert code == 2, (words, message)
        assert "Traceback" not in message and len(errors) == 1, (words, message)
        for needle in needles:
            assert needle in errors[0]
        assert files == before, words
