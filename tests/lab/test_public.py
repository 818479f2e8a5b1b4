"""Test the public names of ``tacbench_cad.lab``: they exist, load lazily, and are the same for type checkers."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tacbench_cad import lab

FOLDER = Path(lab.__file__).parent
STUB = ast.parse((FOLDER / "__init__.pyi").read_text(encoding="utf-8"))
#: The module that defines each public name.
DEFINED_IN = {
    alias.name: f"tacbench_cad.lab.{node.module}"
    for node in STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}


def test_the_stub_declares_every_public_name_as_an_export() -> None:
    exported = [
        alias.asname == alias.name for node in STUB.body if isinstance(node, ast.ImportFrom) for alias in node.names
    ]
    assert len(exported) == len(DEFINED_IN) and all(exported)
    assert sorted(lab.__all__) == sorted(DEFINED_IN) == sorted(dir(lab))


@pytest.mark.parametrize("name", sorted(DEFINED_IN))
def test_a_public_name_is_the_object_of_its_module(name: str) -> None:
    value = getattr(lab, name)
    assert value is getattr(sys.modules[DEFINED_IN[name]], name)
    assert getattr(value, "__module__", DEFINED_IN[name]) in (DEFINED_IN[name], "typing", "types")


def test_importing_the_lab_loads_no_other_module() -> None:
    code = "import sys; before = set(sys.modules); import tacbench_cad.lab; print(*(set(sys.modules) - before))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(result.stdout.split())
    assert {name for name in loaded if name.startswith("tacbench_cad")} == {"tacbench_cad", "tacbench_cad.lab"}
    assert loaded & {"numpy", "scipy", "cv2", "sklearn", "matplotlib", "serial", "OCP"} == set()
