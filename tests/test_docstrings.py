"""What the linter does not ask of docstrings: every field of a public class and every public constant is explained."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    path
    for package in ("tacbench_cad", "housing")
    for path in (ROOT / package).rglob("*.py")
    if "cli" not in path.parts and path.name != "__main__.py"
)


def unexplained(source: str) -> Iterator[str]:
    """Public fields that neither their class's docstring nor a ``#:`` explains, and constants without a ``#:``."""
    tree, lines = ast.parse(source), source.splitlines()
    for name, line in _assigned(tree.body):
        if name.isupper() and len(name) > 1 and not _has_comment(lines, line):
            yield name
    for kind in ast.walk(tree):
        if isinstance(kind, ast.ClassDef) and not kind.name.startswith("_"):
            told = set(re.findall(r"^ {4,}(\w+): ", ast.get_docstring(kind, clean=False) or "", re.MULTILINE))
            for name, line in _assigned(kind.body, annotated=True):
                if name not in told and not _has_comment(lines, line):
                    yield f"{kind.name}.{name}"


def _assigned(body: list[ast.stmt], annotated: bool = False) -> Iterator[tuple[str, int]]:
    for node in body:
        targets = [node.target] if isinstance(node, ast.AnnAssign) else []
        if isinstance(node, ast.Assign) and not annotated:
            targets = node.targets
        if isinstance(node, ast.AnnAssign) and "ClassVar" in ast.unparse(node.annotation):
            continue
        for target in targets:
            for one in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(one, ast.Name) and not one.id.startswith("_"):
                    yield one.id, node.lineno


def _has_comment(lines: list[str], line: int) -> bool:
    return lines[line - 2].lstrip().startswith("#:") or "  #: " in lines[line - 1]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_field_and_constant_is_explained(path: Path) -> None:
    assert list(unexplained(path.read_text(encoding="utf-8"))) == []


def test_what_is_missing_is_found() -> None:
    source = '''
#: Told.
TOLD = 1
BARE = 2
class Point:
    """A point.

    Args:
        x: In mm.
    """
    x: float
    y: float
'''
    assert list(unexplained(source)) == ["BARE", "Point.y"]
