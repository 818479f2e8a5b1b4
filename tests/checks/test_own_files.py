"""``check-part`` accepts every file that this package makes: random blocks in all formats, and plates."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.report import Report
from tacbench_cad.cli import main
from tacbench_cad.making.manifest import read_rows

#: The numbers of random requests in ``make test`` and in ``make test-long``.
FEW, MANY = 4, 200
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


@pytest.mark.parametrize(
    "seed", [1, 2, 3, 4, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(FEW + 1, MANY))]
)
def test_random_blocks_pass_their_own_check(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("lib3mf")
    pytest.importorskip("OCP")
    _check_request(seed, tmp_path, capsys)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 30))])
def test_random_plates_pass_their_own_check(seed: int, tmp_path: Path) -> None:
    pytest.importorskip("lib3mf")
    assert _check_plate(seed, tmp_path)
