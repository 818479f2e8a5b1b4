"""ADMesh, a program that repairs STL files, finds nothing to repair."""

from __future__ import annotations

import re

import pytest
from helpers.outsiders import Run, Written, each_part, part_named

pytestmark = pytest.mark.real

REPAIRS = (
    "Degenerate facets",
    "Edges fixed",
    "Facets removed",
    "Facets added",
    "Facets reversed",
    "Backwards edges",
    "Normals fixed",
    "Facets with 1 disconnected edge",
    "Facets with 2 disconnected edges",
    "Facets with 3 disconnected edges",
    "Total disconnected facets",
)


@each_part
def test_finds_nothing_to_fix(admesh: Run, written: Written, name: str) -> None:
    part = part_named(name)
    mesh, body = part.mesh
    output = admesh([written(name, "stl")])
    # Some lines contain two entries, and some contain two numbers (before and after).
    rows = dict(re.findall(r"([A-Z][A-Za-z0-9 ]*?) +: +([\d.]+(?: +[\d.]+)?)", output))
    counts = {name: int(rows[name].split()[0]) for name in REPAIRS}
    assert counts == dict.fromkeys(REPAIRS, 0)
    assert rows["Number of facets"].split() == [str(len(mesh.faces))] * 2
    assert rows["Number of parts"].split()[0] == "1"
    slack = body.volume_slack_mm3 + 2e-5 * body.volume_mm3
    assert float(rows["Volume"]) == pytest.approx(body.volume_mm3, abs=slack)
