"""Every name of the project that a test, a benchmark or an example uses must exist, because mypy does not check them.

Otherwise the old name of a function would be noticed only when the test runs, and ``tests/real`` needs other programs.
The sources are parsed and not imported.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from helpers.sources import FILES, ROOT, defined, tree

HELPERS = {f"helpers.{path.stem}": path for path in (ROOT / "tests" / "helpers").glob("*.py")}
MODULES = FILES | HELPERS
USERS = sorted(
    path
    for folder in ("tests", "benchmarks", "examples")
    for path in (ROOT / folder).rglob("*.py")
    if path != Path(__file__)
)
#: An import in the source of a program that a test runs in another process.
_IN_TEXT = re.compile(r"\bfrom ((?:tacbench_cad|housing)[\w.]*) import (\w+(?: *, *\w+)*)")
#: The arguments of ``monkeypatch.setattr``: a module and one of its names.
_DOTTED = re.compile(r"(?:tacbench_cad|housing)(?:\.\w+)+")


@cache
def names_of(module: str) -> frozenset[str]:
    """Return the names that a module provides: its own names, the names of its stub, and its modules."""
    path = MODULES[module]
    stub = path.with_suffix(".pyi")
    files = [path, *([stub] if stub.exists() else [])]
    inside = {name.removeprefix(f"{module}.") for name in MODULES if name.startswith(f"{module}.")}
    names = {name for file in files for name in defined(tree(file).body)}
    return frozenset(names | inside | {"__file__", "__name__", "__doc__", "__all__", "__path__"})


def exists(dotted: str) -> bool:
    """Return whether a dotted name is a module or a name in a module. Attributes of classes are not checked."""
    if dotted in MODULES:
        return True
    module, _, name = dotted.rpartition(".")
    while module and module not in MODULES:
        module, _, name = module.rpartition(".")
    return not module or name in names_of(module)


def used(path: Path) -> Iterator[str]:
    """Return the dotted names of the project that a file uses."""
    modules: dict[str, str] = {}
    nodes = list(ast.walk(tree(path)))
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
            modules |= {alias.asname: alias.name for alias in node.names if alias.asname and alias.name in MODULES}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                dotted = f"{node.module}.{alias.name}"
                yield dotted
                if dotted in MODULES:
                    modules[alias.asname or alias.name] = dotted
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            for module, names in _IN_TEXT.findall(node.value):
                yield from (f"{module}.{name.strip()}" for name in names.split(","))
            if _DOTTED.fullmatch(node.value):
                yield node.value
    stored = {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    stored |= {node.arg for node in nodes if isinstance(node, ast.arg)}
    for node in nodes:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id not in stored:
            module = modules.get(node.value.id)
            if module is not None:
                yield f"{module}.{node.attr}"


@pytest.mark.parametrize("folder", sorted({path.relative_to(ROOT).parts[0] for path in USERS}))
def test_every_name_that_is_used_exists(folder: str) -> None:
    missing = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in USERS
        if path.relative_to(ROOT).parts[0] == folder
        for name in sorted(set(used(path)))
        if name.partition(".")[0] in ("tacbench_cad", "housing", "helpers") and not exists(name)
    ]
    assert not missing, "\n".join(missing)
