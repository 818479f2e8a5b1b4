"""The public names: all of them can be imported, none costs anything before it is used."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import housing
import tacbench_cad
from tacbench_cad import Block, CheckFailedError, InputError, as_part, check, export

HEAVY = ("numpy", "scipy", "OCP", "build123d", "cadquery", "matplotlib", "rich")


@pytest.mark.parametrize("package", [tacbench_cad, housing], ids=lambda package: package.__name__)
def test_every_public_name_is_there(package: object) -> None:
    pytest.importorskip("OCP")
    names = package.__all__  # type: ignore[attr-defined]
    assert len(names) == len(set(names)) > 5
    for name in names:
        assert getattr(package, name) is not None


def test_no_public_name_is_a_folder_or_module_beside_it() -> None:
    for package in (tacbench_cad, housing):
        inside = {path.stem for path in Path(package.__file__).parent.iterdir()}
        modules = {name for name in package.__all__ if type(getattr(package, name)) is type(sys)}
        assert not (set(package.__all__) - modules) & inside


def test_importing_loads_nothing_heavy() -> None:
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
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_a_wrong_file_leaves_nothing(tmp_path: Path) -> None:
    right = as_part(Block.of(1, scale=0.5))
    wrong = replace(right, size_mm=(right.size_mm[0] + 1.0, *right.size_mm[1:]))
    with pytest.raises(CheckFailedError, match="box"):
        export(wrong, tmp_path / "wrong.stl")
    with pytest.raises(InputError, match="its ending must be one of"):
        export(right, tmp_path / "wrong.obj")
    with pytest.raises(InputError, match="must be a Block"):
        export("block", tmp_path / "wrong.stl")
    assert not list(tmp_path.iterdir())
