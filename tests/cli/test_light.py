"""The modules that a command loads: help and catalogue must not import a CAD kernel."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tacbench_cad.cli import tacbench

KERNEL = ("OCP", "cadquery", "build123d", "pymeshlab", "gmsh", "vtkmodules")
HEAVY = (*KERNEL, "matplotlib", "scipy", "numba")


def modules_after(*commands: Sequence[str]) -> list[set[str]]:
    """Run the commands in this order in one new process; return the top-level modules that are loaded after each."""
    code = (
        "import json, sys\n"
        "from tacbench_cad.cli import main\n"
        "after = []\n"
        f"for words in {[list(words) for words in commands]!r}:\n"
        "    code = main(words)\n"
        "    after.append([code, sorted({name.split('.')[0] for name in sys.modules})])\n"
        "print(json.dumps(after), file=sys.stderr)\n"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    after = json.loads(process.stderr.splitlines()[-1])
    assert [code for code, _ in after] == [0] * len(commands), process.stderr
    return [set(names) for _, names in after]


def test_no_help_loads_a_heavy_module_numpy_or_a_device_library() -> None:
    context = tacbench.make_context("tacbench", [], resilient_parsing=True)
    commands = [(name, "--help") for name in tacbench.list_commands(context)]
    groups = [("rig", name, "--help") for name in ("probe", "align", "calibrate-force")]
    (*helps, catalogue) = modules_after(*commands, *groups, ("textures",))
    assert helps[-1] & {*HEAVY, "numpy", "cv2", "serial", "pydantic", "filelock"} == set()
    assert catalogue & set(HEAVY) == set()


def test_meshes_are_made_and_checked_without_the_kernel(tmp_path: Path) -> None:
    argv = ("make", "--texture", "1", "--formats", "stl,3mf", "--parts", "blocks", "--out", str(tmp_path))
    (loaded,) = modules_after(argv)
    assert loaded & set(KERNEL) == set()
    assert "manifold3d" in loaded, "the files must have been checked"


def test_solids_are_built_in_child_processes(tmp_path: Path) -> None:
    argv = ("make", "--texture", "1", "--formats", "step", "--parts", "blocks", "--out", str(tmp_path))
    (loaded,) = modules_after(argv)
    assert loaded & set(KERNEL) == set()
    assert (tmp_path / "texture-1_paper_x1.step").is_file()
