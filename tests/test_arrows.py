"""Imports run one way: no circle of modules, and nothing but the commands knows of the lab."""

from __future__ import annotations

import ast
import graphlib
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("tacbench_cad", "housing")
    for path in sorted((ROOT / package).rglob("*.py"))
}


def imported(path: Path) -> set[str]:
    """The modules of the project that a file names in an import, for types and inside of functions too."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            modules = {f"{node.module}.{alias.name}" for alias in node.names} & FILES.keys()
            found |= modules if len(modules) == len(node.names) else modules | {node.module}
    return found & FILES.keys()


ARROWS = {name: imported(path) for name, path in FILES.items()}


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert ARROWS["tacbench_cad.spec.block"] >= {"tacbench_cad.spec.textures", "tacbench_cad.spec.label"}
    graphlib.TopologicalSorter(ARROWS).prepare()  # raises a CycleError that names the circle


def test_only_the_commands_import_the_lab() -> None:
    lab = {one for one in FILES if one == "tacbench_cad.lab" or one.startswith("tacbench_cad.lab.")}
    users = {name for name, others in ARROWS.items() if others & lab}
    assert {name.split(".")[1] for name in users} == {"cli", "lab", "virtual_rig"}
