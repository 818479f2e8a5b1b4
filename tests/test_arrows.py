"""Imports run one way: no circle of modules, no import of a higher layer, and only the commands import the lab."""

from __future__ import annotations

import ast
import graphlib
from functools import cache
from pathlib import Path

import pytest
from helpers.sources import FILES, defined, tree

#: The places that each place may import. ``tacbench_cad`` itself contains the version and the lazy public names.
BELOW = {
    "util": set(),
    "spec": {"util"},
    "geometry": {"util", "spec"},
    "formats": {"util", "spec", "geometry"},
    "render": {"util", "spec", "geometry"},
    "cq": {"util", "spec", "geometry"},
    "bd": {"util", "spec", "geometry"},
    "checks": {"util", "spec", "geometry", "formats"},
    "housing": {"util", "spec", "geometry", "formats", "render", "cq", "bd"},
    "making": {"util", "spec", "geometry", "formats", "render", "checks", "housing"},
    "lab": {"util", "spec"},
}
BELOW["cli"] = set(BELOW)
#: The extensions that use another extension.
USED = {
    "design": {"serving"},
    "printer_models": {"scan"},
    "scan": {"slicing"},
    "watch": {"markers", "serving"},
}
LAB = FILES["tacbench_cad.lab"].parent
#: The rooms of the core: packages that export the names which extensions use.
ROOMS = {
    "tacbench_cad",
    "tacbench_cad.lab",
    "housing",
    *(f"tacbench_cad.lab.{path.parent.name}" for path in LAB.glob("*/__init__.py")),
} | {f"tacbench_cad.{room}" for room in ("spec", "geometry", "formats", "render", "checks", "making", "cli")}


def imported(path: Path) -> set[str]:
    """Return the modules of the project that a file imports, also for type hints and inside functions."""
    modules: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            members = {f"{node.module}.{alias.name}" for alias in node.names} & FILES.keys()
            modules |= members if len(members) == len(node.names) else members | {node.module}
    return modules & FILES.keys()


def place(module: str) -> str:
    """Return the folder or file at the first level that contains a module; empty for the package itself.

    The place of an extension is its own folder.
    """
    first, _, rest = module.partition(".")
    if rest.startswith("extensions."):
        return ".".join(rest.split(".")[:2])
    return first if first == "housing" else rest.partition(".")[0]


MODULES = [name for name in FILES if name != "tacbench_cad"]


@cache
def arrows(name: str) -> set[str]:
    """Return the modules that a module imports."""
    return imported(FILES[name])


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert arrows("tacbench_cad.spec.block") >= {"tacbench_cad.spec.textures", "tacbench_cad.spec.label"}
    graphlib.TopologicalSorter(
        {name: arrows(name) for name in MODULES}
    ).prepare()  # raises a CycleError that names the circle


def test_the_rooms_of_a_rig_its_study_and_its_runs_use_each_other_one_way() -> None:
    rooms = ("study", "rig", "runs")
    used = {
        room: {
            other
            for name in MODULES
            if name.startswith(f"tacbench_cad.lab.{room}.")
            for other in rooms
            if other != room and any(each.startswith(f"tacbench_cad.lab.{other}") for each in arrows(name))
        }
        for room in rooms
    }
    assert used == {"study": set(), "rig": {"study"}, "runs": {"study", "rig"}}


@cache
def exported(room: str) -> set[str]:
    """Return the names that a room exports: the names of its stub, or of its ``__init__`` if it has no stub."""
    stub = FILES[room].with_suffix(".pyi")
    return set(defined(tree(stub if stub.exists() else FILES[room]).body))


@pytest.mark.parametrize("name", [name for name in MODULES if name.startswith("tacbench_cad.extensions.")])
def test_an_extension_imports_only_names_that_a_room_of_the_core_exports(name: str) -> None:
    """Extensions use the same names of the core as packages of other people.

    The modules of ``util`` count as rooms. They do not depend on each other much, and users need none of their names.
    """
    for node in ast.walk(tree(FILES[name])):
        if isinstance(node, ast.Import):
            assert not [alias.name for alias in node.names if alias.name.startswith(("tacbench_cad", "housing"))]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("tacbench_cad", "housing")):
            assert node.module is not None
            if not node.module.startswith("tacbench_cad.extensions"):
                room = node.module
                assert room in ROOMS or room.startswith("tacbench_cad.util."), room
                assert {alias.name for alias in node.names} <= exported(room), room


@pytest.mark.parametrize("name", [name for name in MODULES if name != "tacbench_cad.__main__"])
def test_a_module_imports_only_what_lies_below(name: str) -> None:
    level = place(name)
    extension = level.removeprefix("extensions.")
    below = BELOW[level] if level in BELOW else {*BELOW, *(f"extensions.{other}" for other in USED.get(extension, ()))}
    assert {other for other in arrows(name) if place(other) not in below | {level, "", "extensions"}} == set()
