"""Bad input gives one line with the field, the value and the allowed values, exit code 2, and changes no file."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.cases import mostly_long

from tacbench_cad.cli import main
from tacbench_cad.util.files import locked

Capture = pytest.CaptureFixture[str]

LIGHT = ("--formats", "stl", "--parts", "blocks")


@pytest.fixture
def out(tmp_path: Path) -> Iterator[Path]:
    """Return an output folder with one file; after the test, the folder must contain only the same file."""
    folder = tmp_path / "out"
    folder.mkdir()
    precious = folder / "texture-1_paper_x1.stl"
    precious.write_bytes(b"made before")
    yield folder
    assert precious.read_bytes() == b"made before"
    assert [path.name for path in folder.iterdir()] == [precious.name]


def refusal(capsys: Capture, *argv: str) -> str:
    """Run a command that must end with exit code 2, and return its one line of output."""
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = [line for line in err.splitlines() if not line.startswith("[0/")]
    assert len(lines) == 1 and lines[0].startswith("error: "), err
    return lines[0]


@pytest.mark.parametrize(
    ("options", "needles"),
    [
        (["--scale", "-1"], ["scale", "-1", "from 0.01 to 100"]),
        (["--scale", "nan"], ["scale", "nan", "from 0.01 to 100"]),
        (["--scale", "two"], ["scale", "two", "number"]),
        (["--scale", "1,5"], ["scale", "'1,5'", "must be a number; write 1.5"]),
        (["--key", "3,5"], ["key", "'3,5'", "must be a number; write 3.5"]),
        (["--size", "0,30"], ["size x", "0.0", "mm"]),
        (["--size", "30"], ["size", "'30'", "X,Y"]),
        (["--size", "a,b"], ["size", "a,b", "numbers"]),
        (["--height", "inf"], ["height", "inf"]),
        (["--height", "2.5"], ["height", "2.5", "relief of 4.718", "use a height of at least 5.52 mm"]),
        (["--mm-per-unit", "1,1"], ["mm per unit", "X,Y,Z"]),
        (["--mm-per-unit", "1,0,1"], ["mm per unit y", "0.0"]),
        (["--tolerance", "0"], ["tolerance", "0.0", "positive"]),
        (["--grid", "1x5"], ["grid nx", "1", "from 2"]),
        (["--grid", "189"], ["grid", "189", "NXxNY"]),
        (["--grid", "-1x4"], ["No such option '-1'", "make --help"]),
        (["--grid", "--tolerance", "0.1"], ["grid", "--tolerance", "leave out one"]),
        (["--key", "-3"], ["No such option '-3'", "make --help"]),
        (["--key", "20"], ["key", "20.0", "7.767"]),
        (["--key", "0.2"], ["key", "0.2", "turned by 180 degrees", "above 0.5121"]),
        (["--copies", "0"], ["copies", "0", "from 1"]),
        (["--copies", "2.5"], ["copies", "2.5", "whole number"]),
        (["--preset", "relesed"], ["preset", "relesed", 'did you mean "released"']),
        (["--texture", "7"], ["texture", "'7'", "1 to 6"]),
        (["--texture", "texture4"], ["texture4", 'did you mean "texture-4"']),
        (["--texture", ""], ["texture", "give at least one texture"]),
        (["--texture", "4,texture-4"], ["texture", "texture-4", "twice"]),
        (["--step-tolerance", "0"], ["step tolerance", "0.0"]),
        (["--verify", "all"], ["verify", "all", "default, full"]),
        (["--jig", "al"], ["jig", "al", 'did you mean "all"']),
        (["--preset", "released", "--height", "9"], ["released", "--grid or --tolerance"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) and value and value[0].startswith("-") else "",
)
def test_an_option_with_a_wrong_value(options: list[str], needles: list[str], out: Path, capsys: Capture) -> None:
    line = refusal(capsys, "make", *LIGHT, *options, "--out", str(out))
    for needle in needles:
        assert needle in line


@pytest.mark.parametrize(
    "command", [["make", *LIGHT, "--texture"], ["view"], ["show"], ["check-part", "a.stl", "--texture"]]
)
def test_a_texture_without_the_ending_of_its_file_names_the_file(
    command: list[str], tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cross60.toml").write_text("")
    (tmp_path / "a.stl").write_text("")
    line = refusal(capsys, *command, "cross60")
    assert "'cross60': did you mean the file \"cross60.toml\"?" in line


@pytest.mark.parametrize(
    "command", [["acquire", "--virtual"], ["simulate"], ["export-runs", "runs", "--to", "npz"], ["publish", "runs"]]
)
def test_a_missing_output_folder_names_its_option(command: list[str], tmp_path: Path, capsys: Capture) -> None:
    about = tmp_path / "about.toml"
    words = [*command, *(["--about", str(about)] if command[0] == "publish" else [])]
    assert "error: --out DIR: is missing; " in refusal(capsys, *words)


@pytest.mark.parametrize(
    ("options", "needles"),
    [
        (["--formats", "stp"], ["formats", "stp", 'did you mean "step"']),
        (["--formats", "obj"], ["formats", "obj", "stl, 3mf, step"]),
        (["--formats", ","], ["formats", "stl, 3mf, step"]),
        (["--parts", "block"], ["parts", "block", 'did you mean "blocks"']),
        (["--parts", "blocks", "--slots", "2"], ["slots", "2", "--parts does not contain"]),
        (["--parts", "holder", "--fit", "tight"], ["fit", "tight", "slip"]),
        (["--parts", "holder", "--fit", "0,2"], ["fit", "'0,2'", "a number of mm per side; write 0.2"]),
        (["--parts", "holder", "--rim", "nan"], ["rim", "nan"]),
        (["--parts", "holder", "--nozzle", "inf"], ["nozzle", "inf"]),
        (["--unknown"], ["--unknown"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) and value and value[0].startswith("-") else "",
)
def test_an_unknown_part_or_format(options: list[str], needles: list[str], out: Path, capsys: Capture) -> None:
    line = refusal(capsys, "make", *options, "--out", str(out))
    for needle in needles:
        assert needle in line


@pytest.mark.parametrize(
    ("words", "needle"),
    [
        ("show 7", "texture = '7'"),
        ("show all -o all.png", "is the name of one picture, but there are 6"),
        ("show 1 -o picture.stl", "must end in .png, .pdf or .svg"),
        ("show 1 -o nowhere/picture.png", "nowhere"),
        ("show 1 --preset papers", 'did you mean "paper"'),
        ("check-part", "FILE"),
        ("check-part nothing.stl", "No such file"),
        ("check-part .", "is a folder"),
        ("check-part picture.png", "must end in .stl"),
        ("check-part part.stl --texture 9", "'9'"),
        ("check-part part.stl --scale big", "scale = 'big'"),
        ("make --textur 1", "Did you mean '--texture'?"),
        ("mak", "'make'"),
        ("rig prob", "Did you mean 'probe'?"),
    ],
)
def test_a_wrong_command_is_one_line_and_writes_nothing(
    words: str, needle: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("picture.png", "part.stl"):
        (tmp_path / name).write_bytes(b"a")
    assert needle in refusal(capsys, *words.split())
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"picture.png": b"a", "part.stl": b"a"}


SERIES = '[texture]\nname = "mine"\nfamily = "series"\nlaw = "square"\nN = 5\n'


@pytest.mark.parametrize(
    ("text", "needles"),
    [
        (SERIES.replace("N = 5", "N = 4"), ["N", "4", "must be odd", "3 and 5"]),
        (SERIES + "[block]\nsize_m = [20.0, 20.0]\n", ["size_m", 'did you mean "size_mm"']),
        ("[texture\n", ["not valid TOML"]),
        ("", ["texture", "missing"]),
    ],
)
def test_a_texture_file_with_a_mistake(
    text: str, needles: list[str], out: Path, tmp_path: Path, capsys: Capture
) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    line = refusal(capsys, "make", *LIGHT, "--texture", str(file), "--out", str(out))
    assert "mine.toml" in line
    for needle in needles:
        assert needle in line


def test_a_tolerance_that_needs_too_many_triangles(out: Path, capsys: Capture) -> None:
    # Texture 1 would be small enough. It must not be written before texture 4 is refused.
    options = ("--texture", "1,4", "--tolerance", "3e-5")
    line = refusal(capsys, "make", *LIGHT, *options, "--out", str(out))
    assert "tolerance" in line and "triangles" in line and "20,000,000" in line


def test_a_request_for_only_a_solid_that_does_not_exist(out: Path, capsys: Capture) -> None:
    argv = ("make", "--texture", "4", "--preset", "released", "--formats", "step", "--parts", "blocks")
    line = refusal(capsys, *argv, "--out", str(out))
    assert "step" in line and "texture-4" in line


def test_a_file_instead_of_the_output_folder(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "out"
    file.write_text("precious")
    for folder in (file, file / "inner"):
        line = refusal(capsys, "make", *LIGHT, "--texture", "1", "--out", str(folder))
        assert "output folder" in line and str(folder) in line
    assert file.read_text() == "precious"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_an_output_folder_without_write_permission(tmp_path: Path, capsys: Capture) -> None:
    tmp_path.chmod(0o500)
    try:
        assert "not writable" in refusal(capsys, "make", *LIGHT, "--texture", "1", "--out", str(tmp_path))
    finally:
        tmp_path.chmod(0o700)


def test_a_full_disk(out: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    from tacbench_cad.formats import FORMATS
    from tacbench_cad.geometry.part import PrintPart

    def write(part: PrintPart, path: Path) -> None:
        path.write_bytes(b"half of it")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setitem(FORMATS, "stl", type(FORMATS["stl"])(**{**vars(FORMATS["stl"]), "write": write}))
    assert main(["make", *LIGHT, "--texture", "1", "--out", str(out)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith("error: ") and "no space left" in line and str(out) in line


@pytest.mark.skipif(sys.platform == "win32", reason="limits of POSIX")
@pytest.mark.parametrize("format_name", mostly_long(["stl", "3mf", "step"], "stl", "3mf"))
def test_a_file_system_that_stores_only_half_of_a_file(format_name: str, tmp_path: Path) -> None:
    if format_name != "stl":
        pytest.importorskip({"3mf": "lib3mf", "step": "OCP"}[format_name])
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
        "from tacbench_cad.cli import main; sys.exit(main())"
    )
    argv = ["make", "--parts", "blocks", "--formats", format_name, "--texture", "1", "--out", str(tmp_path)]
    precious = tmp_path / f"texture-1_paper_x1.{format_name}"
    precious.write_bytes(b"made before")
    process = subprocess.run([sys.executable, "-c", code, *argv], capture_output=True, text=True, check=False)
    assert process.returncode == 2, process.stderr
    line = process.stderr.splitlines()[-1]
    assert line.startswith("error: output folder") and "File too large" in line and "Traceback" not in process.stderr
    assert precious.read_bytes() == b"made before"
    assert [path.name for path in tmp_path.iterdir()] == [precious.name]


def test_a_manifest_of_another_program(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "manifest.json").write_text('{"name": "a web page"}')
    line = refusal(capsys, "make", *LIGHT, "--texture", "1", "--out", str(tmp_path))
    assert "manifest" in line and "move it away" in line
    assert (tmp_path / "manifest.json").read_text() == '{"name": "a web page"}'
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]


def test_a_second_process_in_one_folder_is_refused(tmp_path: Path) -> None:
    code = "import sys; from tacbench_cad.cli import main; sys.exit(main())"
    argv = [sys.executable, "-c", code, "make", *LIGHT, "--texture", "1", "--out", str(tmp_path)]
    with locked(tmp_path):
        process = subprocess.run(argv, capture_output=True, text=True, check=False)
    assert process.returncode == 2
    assert "another tacbench is writing" in process.stderr and "Traceback" not in process.stderr
    assert list(tmp_path.iterdir()) == []
