"""``check-part`` accepts every file that this package makes: random blocks in all formats, and plates."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad.checks import meshcheck, solidcheck
from tacbench_cad.checks.claim import claimed_blocks
from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.report import Report
from tacbench_cad.cli import main
from tacbench_cad.formats import FORMATS
from tacbench_cad.formats.step import read_step
from tacbench_cad.formats.stl import read_stl
from tacbench_cad.formats.threemf import read_3mf, write_plate
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.making.manifest import read_rows, write_manifest
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.storage import block_values
from tacbench_cad.spec.textures import Texture

#: The number of random requests of the long run.
MANY = 200
_WEAVE = """[texture]
name = "weave"
family = "plane-waves"
[[wave]]
amplitude = 0.6
f = 1.0
g = 0.5
[[wave]]
amplitude = 0.5
f = 0.7
g = -0.8
[block]
"""


def _faults(report: Report) -> str:
    return f"{report.path.name}: " + "; ".join(f"{check.name}: {check.detail}" for check in report.faults)


def _random_words(rng: random.Random, folder: Path) -> list[str]:
    """Return random options of ``make`` for one block. Some combinations are not allowed."""
    toml = folder / "weave.toml"
    low = [round(rng.uniform(-9.0, 2.0), rng.choice((0, 1, 3, 7))) for _ in range(2)]
    high = [round(start + rng.uniform(5.0, 12.0), rng.choice((1, 4))) for start in low]
    units = f"mm_per_unit = [{rng.uniform(1.0, 2.5)!r}, {rng.uniform(1.0, 2.5):.3g}, 1.0]\n"
    toml.write_text(f"{_WEAVE}domain = [[{low[0]}, {high[0]}], [{low[1]}, {high[1]}]]\n{units}")
    released = rng.random() < 0.3
    words = ["--texture", rng.choice(["1", "2", "3", "4", "5", "6", "dunes", "diamond", str(toml), str(toml)])]
    words += ["--preset", "released"] if released else []
    words += ["--scale", f"{rng.uniform(0.6, 1.6):.{rng.choice((1, 2, 5))}f}"] if rng.random() < 0.5 else []
    words += ["--size", ",".join(f"{rng.uniform(16.0, 45.0):.2f}" for _ in "xy")] if rng.random() < 0.4 else []
    if rng.random() < 0.25:
        words += [
            "--outline",
            rng.choice(["disc:25", "ring:34,11", "hexagon:27", "triangle:40", "polygon:0,0,30,0,20,25"]),
        ]
    elif rng.random() < 0.5:
        words += ["--key", f"{rng.uniform(1.5, 4.0):.2f}"]
    words += ["--height", f"{rng.uniform(7.5, 11.0):.2f}"] if rng.random() < 0.6 else []
    if rng.random() < 0.2:
        words += ["--mm-per-unit", ",".join(repr(rng.uniform(0.9, 1.6)) for _ in "xyz")]
    if rng.random() < 0.25:
        words += ["--grid"]
    elif rng.random() < 0.7 or released:
        words += ["--tolerance", f"{rng.choice((0.02, 0.05, 0.1, 0.2)) * rng.uniform(1.0, 1.4):.4f}"]
    words += rng.choice([[], [], ["--label"], ["--copies", "2"]])
    return [*words, "--formats", "stl,3mf" if rng.random() < 0.6 else "stl,3mf,step", "--parts", "blocks"]


def _check_request(seed: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> int:
    """Make the files of a random request and check them. Return their number."""
    words = _random_words(random.Random(seed), folder)
    out = folder / "out"
    code = main(["make", *words, "--out", str(out)])
    said = capsys.readouterr().err
    assert code in (0, 2), f"{words}: {said}"
    rows = read_rows(out) if code == 0 else []
    texture = words[1] if words[1].endswith(".toml") else None
    for row in rows:
        report = examine(out / row["file"], texture=texture)
        assert report.ok, f"seed {seed}: {words}: {_faults(report)}"
    return len(rows)


def _check_plate(seed: int, folder: Path) -> int:
    """Write random plates and check them. Return their number."""
    rng = random.Random(seed)
    words = ["--printer", rng.choice(["ender-3", "ender-3-v3-se", "bambu-p1p", "form-3"])]
    words += ["--texture", ",".join(rng.sample(["1", "2", "3", "4", "5", "6"], 2)), "--copies", str(rng.randint(2, 5))]
    words += rng.choice([[], ["--key"], ["--key", "2.2"]])
    words += rng.choice([[], ["--scale", f"{rng.uniform(0.7, 1.4):.2f}"]])
    assert main(["plate", *words, "--out", str(folder)]) == 0
    files = sorted(folder.glob("*.3mf"))
    for path in files:
        report = examine(path)
        assert report.ok, f"seed {seed}: {words}: {_faults(report)}"
    return len(files)


@pytest.mark.parametrize("seed", mostly_long(range(1, MANY), 2))
def test_random_blocks_pass_their_own_check(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("lib3mf")
    pytest.importorskip("OCP")
    _check_request(seed, tmp_path, capsys)


@pytest.mark.parametrize("seed", mostly_long(range(1, 30), 1))
def test_random_plates_pass_their_own_check(seed: int, tmp_path: Path) -> None:
    pytest.importorskip("lib3mf")
    assert _check_plate(seed, tmp_path)


@pytest.mark.parametrize("form", ["3mf", "step"])
def test_a_negative_origin_is_kept_in_the_file(form: str, tmp_path: Path) -> None:
    pytest.importorskip({"3mf": "lib3mf", "step": "OCP"}[form])
    block = replace(Block.of(2, copy=3, key_mm=2.5), origin_uv=(-3.25, -0.5))
    path = tmp_path / f"renamed.{form}"
    FORMATS[form].write(block_part(block), path)
    metadata = read_3mf(path)[1] if form == "3mf" else None
    assert list(claimed_blocks(path, metadata).values()) == [block]
    assert examine(path, full=False).ok


@pytest.mark.usefixtures("no_preview")
def test_a_height_map_larger_than_a_text_of_lib3mf_is_kept_in_the_file(tmp_path: Path) -> None:
    pytest.importorskip("lib3mf")
    heights = np.random.default_rng(1).normal(size=(140, 180)).cumsum(axis=0).cumsum(axis=1)
    block = Block.of(Texture.from_heights(heights / np.ptp(heights), mm_per_pixel=0.17, name="map"))
    path = tmp_path / "map.3mf"
    FORMATS["3mf"].write(block_part(block), path)
    metadata = read_3mf(path)[1]
    assert "blocks1" in metadata
    assert list(claimed_blocks(path, metadata).values()) == [block]


def test_a_renamed_stl_file_is_recognised_by_the_manifest_beside_it(tmp_path: Path) -> None:
    words = [
        "--texture",
        "1",
        "--size",
        "23.123,29.456",
        "--mm-per-unit",
        "1.1234567,1.2345678,0.9876543",
        "--key",
        "2.25",
    ]
    assert main(["make", *words, "--formats", "stl", "--parts", "blocks", "--out", str(tmp_path)]) == 0
    (path,) = tmp_path.glob("*.stl")
    assert examine(path, full=False).ok
    renamed = path.rename(tmp_path / "renamed.stl")
    assert examine(renamed, full=False).ok
    (tmp_path / "manifest.json").unlink()
    assert not examine(renamed, full=False).ok


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"waves": [[1.0, 2.0, 0.0, 0.0]]}, "of a texture of the paper, but its surface is another one"),
        ({"texture": "own", "number": 4}, "of a texture of the paper, but its surface is another one"),
        ({"sampling": None}, "is not a block that this program wrote"),
        ({"scale": "large"}, "scale"),
    ],
)
def test_a_damaged_claim_is_a_fault(change: dict[str, Any], message: str, tmp_path: Path) -> None:
    part = block_part(Block.of(2))
    FORMATS["stl"].write(part, tmp_path / "a.stl")
    row = {"file": "a.stl", "sha256": "", "part": "a", "block": {**block_values(Block.of(2)), **change}}
    write_manifest(tmp_path, [row])
    (fault,) = examine(tmp_path / "a.stl", full=False).faults
    assert fault.name == "file" and message in fault.detail


def test_a_claim_that_takes_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tacbench_cad.checks.claim.LIMITS_S", (0.5, 0.0))
    waves = [[1e-4, 1e4 - 3.0 * i, 1e4 - 7.0 * i, 0.1 * i] for i in range(2000)]
    values = {**block_values(Block.of(2)), "texture": "own", "number": None, "waves": waves}
    FORMATS["stl"].write(block_part(Block.of(2)), tmp_path / "a.stl")
    write_manifest(tmp_path, [{"file": "a.stl", "sha256": "", "part": "a", "block": values}])
    (fault,) = examine(tmp_path / "a.stl", full=False).faults
    assert "takes the check of its blocks longer than" in fault.detail


def test_a_solid_keeps_its_own_tolerance(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    for limit in (0.05, 0.001):
        FORMATS["step"].write(block_part(Block.of(1, step_tolerance_mm=limit)), tmp_path / "a.step")
        (claim,) = claimed_blocks(tmp_path / "a.step").values()
        assert claim.sampling == Tolerance(mm=0.05 if limit == 0.05 else 0.01)


@pytest.mark.parametrize("number", mostly_long(range(1, 7), 2))
def test_the_mesh_and_the_solid_of_a_released_block_have_the_same_height(number: int, tmp_path: Path) -> None:
    """With a tolerance, the highest point of the paper's formula lies at the height, in the mesh and in the solid."""
    pytest.importorskip("OCP")
    words = ["--texture", str(number), "--preset", "released", "--tolerance", "0.02", "--size", "44.13,20.68"]
    assert main(["make", *words, "--formats", "stl,step", "--parts", "blocks", "--out", str(tmp_path)]) == 0
    i = np.arange(1, (25 if number in (3, 5) else 101) + 1, 2)
    triangle, square = 8.0 / np.pi**2 * (-1.0) ** ((i - 1) // 2) / i**2, 4.0 / np.pi / i
    laws = {1: ([1.0], [1.0]), 2: ([1.0], [1.0]), 3: (triangle, i), 4: (square, i), 5: (triangle, i), 6: (square, i)}
    weights, waves = map(np.asarray, laws[number])

    def half(t: np.ndarray, shift: float = 0.0) -> np.ndarray:
        return np.concatenate([np.sin(np.outer(part, waves) + shift) @ weights for part in np.array_split(t, 40)])

    shift = np.pi / 2 if number == 2 else 0.0
    along_v = number in (2, 3, 4)
    highest = half(np.linspace(0.0, 44.13, 400_001)).max()
    highest += half(np.linspace(0.0, 20.68, 200_001), shift).max() if along_v else 0.0

    mesh = read_stl(next(tmp_path.glob("*.stl")))
    top = mesh.vertices[mesh.vertices[:, 2] > 0.8]
    solid = solidcheck.points_on(solidcheck.curved(read_step(next(tmp_path.glob("*.step"))))[0], 4000)
    assert top[:, 2].max() == 7.0
    for (x, y, z), allowed in ((top.T, 0.021), (solid.T, 0.0011)):
        off = z - (7.0 - highest) - half(x) - (half(y, shift) if along_v else 0.0)
        assert np.median(np.abs(off)) <= allowed


@pytest.mark.parametrize(("texture", "mm"), [("dunes", 0.2), ("diamond", 0.1)])
def test_the_highest_vertex_of_an_adaptive_mesh_is_exactly_at_the_height(texture: str, mm: float) -> None:
    mesh, _ = block_part(Block.of(texture, sampling=Tolerance(mm=mm))).mesh
    assert mesh.vertices[:, 2].max() == 7.0


@pytest.mark.parametrize("scale", [0.80001, 1.15422, 1.25653, 1.45998])
def test_no_triangle_around_a_label_is_without_area(scale: float) -> None:
    mesh, expected = block_part(Block.of(1, scale=scale, height_mm=9.0, copy=34, sampling=Tolerance(mm=0.1))).mesh
    assert not meshcheck.degenerate(mesh).any() and meshcheck.edges(mesh).ok
    assert mesh.volume_mm3 == pytest.approx(expected.volume_mm3, abs=0.01)
    flat = mesh.doubled_normals[(mesh.vertices[mesh.faces][:, :, 2] == 0.0).all(axis=1)]
    assert (flat[:, 2] < 0.0).all(), "all triangles of the underside face down"


def test_the_bodies_of_a_plate_do_not_cut_each_other(tmp_path: Path) -> None:
    """Far from the origin, pymeshlab finds cuts where none are; a real one must still be found."""
    pytest.importorskip("lib3mf")
    pytest.importorskip("pymeshlab")
    part = block_part(Block.of(6, key_mm=3.0, copy=5))
    for name, places, cut in (
        ("apart", ((200.0, 130.0), (150.0, 130.0)), False),
        ("over", ((0.0, 0.0), (20.0, 0.5)), True),
    ):
        path = tmp_path / f"{name}.3mf"
        write_plate([(part, place) for place in places], "plate", path)
        faults = {check.name for check in examine(path).faults}
        assert faults == ({"self-intersection"} if cut else set()), name
