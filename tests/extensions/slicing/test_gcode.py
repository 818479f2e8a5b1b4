"""Reading G-code as beads: modes, arcs, features and their heights, and files that are not G-code."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.extensions.slicing import gcode
from tacbench_cad.extensions.slicing.gcode import CHORD_MM, Sliced, read_gcode
from tacbench_cad.util.errors import InputError

FILAMENT_MM2 = math.pi / 4.0 * 1.75**2
HEAD = "G21\nG90\nM83\nG1 Z0.2 F600\n"
WALL, FILL = ";TYPE:External perimeter\n", ";TYPE:Solid infill\n"


def sliced(tmp_path: Path, text: str, filament_mm: float | None = None) -> Sliced:
    path = tmp_path / "part.gcode"
    path.write_text(text)
    return read_gcode(path, filament_mm)


def beads(tmp_path: Path, text: str) -> np.ndarray:
    """Return the beads of a file, after a fixed beginning, as rows of x0, y0, x1, y1, top and area."""
    table = sliced(tmp_path, HEAD + WALL + text).beads
    return np.column_stack([table.start_mm, table.end_mm, table.top_mm, table.area_mm2])


PLAIN = "G1 X10 Y10\nG1 X20 Y10 E0.5\nG1 X20 Y30 E1\n"


@pytest.mark.parametrize(
    "same",
    [
        "M82\nG92 E0\nG1 X10 Y10\nG1 X20 Y10 E0.5\nG1 X20 Y30 E1.5\n",
        "M82\nG92 E7\nG1 X10 Y10\nG1 X20 Y10 E7.5\nG92 E0\nG1 X20 Y30 E1\n",
        "M82\nG92 E0\nG1 X10 Y10 E-2\nG1 E0\nG1 X20 Y10 E.5\nM83\nG1 Y30 E1\n",
        "G1 X10 Y10\nG1 E-2\nG1 X15 Y30\nG1 X10 Y10\nG1 E2\nG1 X20 Y10 E0.5\nG1 X20 Y30 E1\n",
        "G91\nG1 X10 Y10\nG1 X10 E0.5\nG90\nG1 Y30 E1\n",
        "N1 G1 X10 Y10*71\nN2 G1 X20 Y10 E0.5*22\ng1x20y30e1\n",
        "G1 X10 Y10\nG92 X0 Y0\nG1 X10 Y0 E+0.50 ; a comment with X99\nG1 X10 Y20 E1.\nM106 S255\nT0\n",
        f"M200 D1.75\nG1 X10 Y10\nG1 X20 Y10 E{0.5 * FILAMENT_MM2}\nG1 X20 Y30 E{FILAMENT_MM2}\n",
        f"M200 D1.75\nG1 X10 Y10\nG1 X20 Y10 E{0.5 * FILAMENT_MM2}\nM200 D0\nG1 X20 Y30 E1\n",
        "G1 X10 Y10 Z0.6\nG1 Z0.2\nG1 X20 Y10 E0.5\n;WIPE_START\nG1 X10 E-0.3\n;WIPE_END\nG1 X20\nG1 X20 Y30 E1\n",
    ],
)
def test_equivalent_gcode_gives_the_same_beads(tmp_path: Path, same: str) -> None:
    expected = beads(tmp_path, PLAIN)
    assert expected == pytest.approx(
        np.array([[10, 10, 20, 10, 0.2, 0.05 * FILAMENT_MM2], [20, 10, 20, 30, 0.2, 0.05 * FILAMENT_MM2]])
    )
    assert beads(tmp_path, same) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("arc", "centre", "sweep"),
    [
        ("G2 X20 Y0 I10 J0 E2", (10.0, 0.0), -math.pi),
        ("G3 X20 Y0 I10 J0 E2", (10.0, 0.0), math.pi),
        ("G3 X10 Y10 J10 E2", (0.0, 10.0), math.pi / 2.0),
        ("G2 X10 Y10 I10 E2", (10.0, 0.0), -math.pi / 2.0),
        ("G2 X10 Y10 J10 E2", (0.0, 10.0), -1.5 * math.pi),
        ("G2 X10 Y10 R10 E2", (10.0, 0.0), -math.pi / 2.0),
        ("G3 X10 Y10 R10 E2", (0.0, 10.0), math.pi / 2.0),
        ("G2 X10 Y10 R-10 E2", (0.0, 10.0), -1.5 * math.pi),
        ("G3 X10 Y10 R-10 E2", (10.0, 0.0), 1.5 * math.pi),
        ("G2 X0 Y0 I5 E2", (5.0, 0.0), -2.0 * math.pi),
        ("G3 I5 E2", (5.0, 0.0), 2.0 * math.pi),
    ],
)
def test_arcs(tmp_path: Path, arc: str, centre: tuple[float, float], sweep: float) -> None:
    rows = beads(tmp_path, f"G1 X0 Y0\n{arc}\n")
    radius = math.hypot(*centre)
    assert rows[0, :2] == pytest.approx([0.0, 0.0])
    assert rows[1:, :2] == pytest.approx(rows[:-1, 2:4])
    ends = rows[:, 2:4] - centre
    assert np.hypot(*ends.T) == pytest.approx(radius)
    middles = (rows[:, :2] + rows[:, 2:4]) / 2.0 - centre
    assert (radius - np.hypot(*middles.T)).max() <= CHORD_MM + 1e-9
    around = np.unwrap(np.arctan2(*np.vstack([rows[:1, :2] - centre, ends]).T[::-1]))
    assert around[-1] - around[0] == pytest.approx(sweep)
    assert rows[:, 5] == pytest.approx(2.0 * FILAMENT_MM2 / (abs(sweep) * radius), rel=1e-3)


def test_the_width_comes_from_the_extrusion(tmp_path: Path) -> None:
    """The first bead is 0.45 mm wide and 0.2 mm high. The second is too thin for that and becomes a round string."""
    area = (0.45 - 0.2) * 0.2 + math.pi / 4.0 * 0.2**2
    text = f"{HEAD}{WALL}G1 X0 Y0\nG1 X10 E{10 * area / FILAMENT_MM2:.7f}\nG1 X20 E{10 * 0.01 / FILAMENT_MM2:.7f}\n"
    assert sliced(tmp_path, text).beads.width_mm == pytest.approx([0.45, math.sqrt(0.04 / math.pi)], abs=1e-5)


def test_moves_that_do_not_print_the_part_are_left_out(tmp_path: Path) -> None:
    words = ("Custom", "Skirt/Brim", "Support material", "Support material interface", "Wipe tower")
    other = "".join(f";TYPE:{word}\nG1 X0\nG1 X50 E1\n" for word in words)
    part = sliced(tmp_path, f"{HEAD}G1 X99 E5\n{other}{WALL}G1 X0\nG1 X9 E1\n{FILL}G1 X0 E1\n;TYPE:Lace\nG1 X3 E1\n")
    assert part.beads.wall.tolist() == [True, False, False]
    assert part.left_out == {"before the first feature": 1, **dict.fromkeys(words, 1)}
    assert part.unknown == ("Lace",)


@pytest.mark.parametrize(
    ("dialect", "wall", "fill", "skirt"),
    [
        ("PrusaSlicer", ";TYPE:External perimeter", ";TYPE:Top solid infill", ";TYPE:Skirt/Brim"),
        ("Cura", ";TYPE:WALL-OUTER", ";TYPE:SKIN", ";TYPE:SKIRT"),
        ("Bambu Studio", "; FEATURE: Outer wall", "; FEATURE: Top surface", "; FEATURE: Brim"),
        ("OrcaSlicer", ";TYPE:Outer wall", ";TYPE:Bottom surface", ";TYPE:Prime tower"),
    ],
)
def test_dialects(tmp_path: Path, dialect: str, wall: str, fill: str, skirt: str) -> None:
    part = sliced(tmp_path, f"{HEAD}{skirt}\nG1 X9 E1\n{wall}\nG1 X0 E1\n{fill}\nG1 X9 E1\n")
    assert part.dialect == dialect and not part.unknown
    assert part.beads.wall.tolist() == [True, False]


def _layers(*tops: float, words: str = "") -> str:
    return "M83\n" + WALL + "".join(f"{words}G1 X0 Z{top}\nG1 X10 E1\n" for top in tops)


def test_heights_come_from_the_file_or_from_the_layers(tmp_path: Path) -> None:
    plain = sliced(tmp_path, _layers(0.3, 0.5, 0.7))
    assert plain.beads.height_mm == pytest.approx([0.3, 0.2, 0.2])
    assert plain.layer_mm == pytest.approx(0.2) and plain.floor_mm == 0.0
    stated = sliced(tmp_path, _layers(0.3, 0.5, 0.7, words=";HEIGHT:0.15\n"))
    assert stated.beads.height_mm == pytest.approx([0.15] * 3) and stated.floor_mm == pytest.approx(0.15)


def test_a_raft_lies_below_the_part(tmp_path: Path) -> None:
    raft = "M83\n;TYPE:Support material\nG1 X0 Z0.8\nG1 X50 E1\n"
    part = sliced(tmp_path, raft + _layers(1.2, 1.4, 1.6))
    assert part.floor_mm == pytest.approx(1.0)
    # Cura presses the first layer into the raft.
    pressed = sliced(tmp_path, raft + _layers(1.2, *(1.18 + 0.2 * n for n in range(9))))
    assert pressed.floor_mm == pytest.approx(0.78)
    assert pressed.beads.height_mm == pytest.approx([0.2] * 10, abs=0.021)


@pytest.mark.parametrize(
    ("text", "filament", "expected", "assumed"),
    [
        ("; filament_diameter = 2.85\n", None, 2.85, False),
        ("; filament_diameter: 1.75,1.75\n", None, 1.75, False),
        ("; filament_diameter = 2.85\n", 1.7, 1.7, False),
        ("", None, 1.75, True),
    ],
)
def test_filament(tmp_path: Path, text: str, filament: float | None, expected: float, assumed: bool) -> None:
    part = sliced(tmp_path, _layers(0.2) + text, filament)
    assert (part.filament_mm, part.filament_assumed) == (expected, assumed)
    assert part.beads.area_mm2 == pytest.approx(math.pi / 4.0 * expected**2 / 10.0)


@pytest.mark.parametrize(
    ("content", "needle"),
    [
        (b"", "empty"),
        (b" \n\n", "empty"),
        (b"GCDE\x01\x00\x00\x00", "binary"),
        (bytes(range(256)), "binary"),
        (b"PK\x03\x04rest", "ZIP"),
        (b"solid block\nendsolid\n", "unknown dialect"),
        (b"G1 X0 Y0\nG1 X10 E5\n", "unknown dialect"),
        (b"%\nO1000\nG17 G21 G90\nG1 X10 F100\nM30\n", "unknown dialect"),
        (WALL.encode() + b"G1 X10 Y10\nG1 X20\n", "extrudes nothing"),
        (WALL.encode() + b";TYPE:Skirt/Brim\nM83\nG1 X10 Y10 Z.2 E1\n", "outside the part (Skirt/Brim)"),
        (WALL.encode() + b"G1 X10 Y1O E1\n", "line 2 = 'G1 X10 Y1O E1'"),
        (WALL.encode() + b"G1 X{width} Y10 E1\n", "'X{width}'"),
        (WALL.encode() + b"G1 Xnan Y10 E1\n", "not a letter followed by a number"),
        (WALL.encode() + b"G20\nG1 X1 Y1 E1\n", "inches"),
        (WALL.encode() + b"G18\nG2 X1 Z1 I1 E1\n", "another plane"),
        (WALL.encode() + b"G2 X1 Y1 E1\n", "I and J, or R"),
        (WALL.encode() + b"G2 X50 Y1 R2 E1\n", "cannot connect the two points"),
        (WALL.encode() + b"M83\nG1 Z.2\nG1 X9 Z.3 E1\n", "spiral vase"),
        (WALL.encode() + b"M83\nG1 X9 E1\n", "z = 0"),
        (WALL.encode() + b"; filament_diameter = 0.0\nM83\nG1 X9 Z1 E1\n", "from 0.5 to 5 mm"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, content: bytes, needle: str) -> None:
    path = tmp_path / "bad.gcode"
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        read_gcode(path)
    assert needle in str(refused.value) and "bad.gcode" in str(refused.value)


@pytest.mark.parametrize(
    ("text", "needle"),
    [
        ("G1 X" + "9" * 400 + " E1\n", "line 6.*Xinf.*must be from -10,000 mm to 10,000 mm"),
        ("G1 X10001 E1\n", "line 6"),
        ("G91\n" + "G1 X9000 E1\n" * 2, "line 8"),
        ("G1 X1 E" + "9" * 9 + "\n", "line 6"),
        ("G2 X10 Y0 R1000000000000 E1\n", "line 6"),
        ("G2 X10 Y0 I1000000000000 J0 E1\n", "line 6"),
        ("G1 X1 E1" + " " * 2_000_000 + ";\n", "line 6.*characters"),
        (";" + "x" * 2_000_000 + "\n", "line 6.*characters"),
        (";HEIGHT:0.001\n", "line 6.*0.009 to 5 mm"),
        ("".join(f"G1 Z{0.2 + i / 1000:.3f}\nG1 X{i % 2 * 10} E1\n" for i in range(50)), "prints layers of 0.001 mm"),
        ("G2 X9000 Y0 R4500 E1\nG2 X0 Y0 R4500 E1\n" * 40, r"line \d+.*more than the 50,000"),
    ],
)
def test_the_message_about_an_impossible_number_names_its_line(
    tmp_path: Path, text: str, needle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gcode, "MAX_BEADS", 50_000)
    with pytest.raises(InputError, match=needle):
        sliced(tmp_path, HEAD + WALL + text)
