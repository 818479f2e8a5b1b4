"""The public names can be imported, load nothing before they are used, and are sufficient for examples and docs."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import housing
import tacbench_cad
from tacbench_cad import Block, CheckFailedError, InputError, as_part, check, export

ROOT = Path(__file__).parents[1]
#: The packages that list their public names in a stub, and the modules for CadQuery and build123d.
PUBLIC = (
    *("tacbench_cad.cq", "tacbench_cad.bd", "housing.cq", "housing.bd"),
    *(
        ".".join(stub.relative_to(ROOT).parent.parts)
        for package in ("tacbench_cad", "housing")
        for stub in sorted((ROOT / package).rglob("__init__.pyi"))
    ),
)
HEAVY = ("numpy", "scipy", "OCP", "build123d", "cadquery", "matplotlib", "rich")


@pytest.mark.parametrize("module", [name for name in PUBLIC if not name.endswith((".cq", ".bd"))])
def test_every_public_name_can_be_imported(module: str) -> None:
    pytest.importorskip("OCP")
    package = importlib.import_module(module)
    names = package.__all__
    assert len(names) == len(set(names)) > 1
    for name in names:
        assert getattr(package, name) is not None


def test_no_public_name_is_also_a_module() -> None:
    for package in (tacbench_cad, housing):
        inside = {path.stem for path in Path(package.__file__).parent.iterdir()}
        modules = {name for name in package.__all__ if type(getattr(package, name)) is type(sys)}
        assert not (set(package.__all__) - modules) & inside


def test_the_import_loads_no_heavy_module() -> None:
    code = f"import sys, tacbench_cad, housing; print([m for m in {HEAVY!r} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.mark.parametrize("ending", ["stl", "3mf", "step"])
def test_a_block_is_exported_and_checked(ending: str, tmp_path: Path) -> None:
    pytest.importorskip("OCP" if ending == "step" else "lib3mf" if ending == "3mf" else "numpy")
    block, path = Block.of(2, scale=0.5, key_mm=2.0), tmp_path / f"block.{ending}"
    report = export(block, path)
    assert report.ok and report.path == path and (report.deviation_mm or 0.0) < 0.011
    assert check(path, block).ok and check(path, full=False).ok
    assert not check(path, Block.of(2, scale=0.5)).ok
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_wrong_file_leaves_nothing(tmp_path: Path) -> None:
    part = as_part(Block.of(1, scale=0.5))
    wrong = replace(part, size_mm=(part.size_mm[0] + 1.0, *part.size_mm[1:]))
    with pytest.raises(CheckFailedError, match="box"):
        export(wrong, tmp_path / "wrong.stl")
    with pytest.raises(InputError, match="the file name must end in"):
        export(part, tmp_path / "wrong.obj")
    with pytest.raises(InputError, match="must be a Block"):
        export("block", tmp_path / "wrong.stl")
    assert not list(tmp_path.iterdir())


def _sources() -> dict[str, list[str]]:
    """Return the Python code of the examples and of the pages that people read."""
    sources = {path.name: [path.read_text(encoding="utf-8")] for path in sorted((ROOT / "examples").glob("*.py"))}
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        sources[path.name] = re.findall(r"^```python\b[^\n]*\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S)
    return sources


SOURCES = _sources()


def _imports(code: str) -> list[tuple[str, str]]:
    """Return the module and the name of each import from this project; the name is empty if a module is imported."""
    imports = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            imports += [(node.module, alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            imports += [(alias.name, "") for alias in node.names]
    return [(module, name) for module, name in imports if module.partition(".")[0] in ("tacbench_cad", "housing")]


@pytest.mark.parametrize("source", [name for name, codes in SOURCES.items() if any(codes)])
def test_examples_and_pages_import_public_names_only(source: str) -> None:
    imports = [imported for code in SOURCES[source] for imported in _imports(code)]
    private = {f"{module}.{name}" for module, name in imports if module not in PUBLIC}
    assert not private
    for module, name in imports:
        if name and not module.endswith((".cq", ".bd")):
            assert name in importlib.import_module(module).__all__
