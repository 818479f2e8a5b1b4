"""The project's source files as syntax trees, for tests that read the sources without importing them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: The file of every module, by the module's dotted name.
FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("tacbench_cad", "housing")
    for path in sorted((ROOT / package).rglob("*.py"))
}


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def defined(statements: list[ast.stmt]) -> Iterator[str]:
    """Yield the names that statements at the first level of a module define."""
    for node in statements:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from (alias.asname or alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.If | ast.Try | ast.With | ast.For):
            for _, body in ast.iter_fields(node):
                if isinstance(body, list):
                    yield from defined([child for child in body if isinstance(child, ast.stmt)])
            yield from defined([line for child in getattr(node, "handlers", []) for line in child.body])
        yield from (
            child.id for child in ast.walk(node) if isinstance(child, ast.Name) and isinstance(child.ctx, ast.Store)
        )
