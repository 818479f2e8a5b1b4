"""Tab completion: the offered commands, options and values, the speed, and the scripts for the shells."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete, get_completion_class

from tacbench_cad import cli
from tacbench_cad.cli import main
from tacbench_cad.cli.completing import VARIABLE
from tacbench_cad.cli.completion import INSTALL
from tacbench_cad.cli.options import TEXTURES

Capture = pytest.CaptureFixture[str]


def offered(*words: str) -> list[str]:
    """Return the values that are offered for the last word."""
    shell = ShellComplete(cli.tacbench, {}, "tacbench", VARIABLE)
    return [item.value for item in shell.get_completions(list(words[:-1]), words[-1])]


def kinds(*words: str) -> set[str]:
    """Return the kinds of paths that the shell itself must list: files, folders, or nothing."""
    shell = ShellComplete(cli.tacbench, {}, "tacbench", VARIABLE)
    return {item.type for item in shell.get_completions(list(words[:-1]), words[-1])} - {"plain"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["check-"], ["check-part", "check-runs", "check-gcode"]),
        (["rig", ""], ["probe", "wizard", "drivers", "calibrate-force", "align"]),
        (["make", "--tex"], ["--texture"]),
        (["make", "--texture", ""], list(TEXTURES)),
        (["make", "--texture", "1,4,"], [f"1,4,{name}" for name in TEXTURES if name not in "14"]),
        (["make", "--texture", "1,4,d"], ["1,4,diamond", "1,4,dunes", "1,4,dimples"]),
        (["make", "--preset", "r"], ["released"]),
        (["make", "--preset=r"], ["released"]),
        (["make", "--formats", "stl,"], ["stl,3mf", "stl,step"]),
        (["make", "--parts", "h"], ["holder"]),
        (["make", "--fit", ""], ["press", "slip", "loose"]),
        (["make", "--copies", ""], []),
        (["draw", "4", "--part", ""], ["block", "holder", "jig", "coupon"]),
        (["view", "1,2", "ho"], ["holder"]),
        (["plate", "--printer", "ender"], ["ender-3", "ender-3-v3-se"]),
        (["plate", "--printer", "form-3", "--filament", ""], ["grey-v4"]),
        (["acquire", "--virtual", "--driver", ""], ["simulated", "virtual-grbl", "virtual-marlin"]),
        (["simulate", "--look", "tactip-"], ["tactip-bristol", "tactip-sussex"]),
        (["import-frames", "x", "--columns", "label=a,pr"], ["label=a,print=", "label=a,printer="]),
        (["classify", "r", "--protocol", ""], ["leak-free", "paper", "as-published"]),
        (["classify", "r", "--hold-out", "copy,p"], ["copy,press", "copy,position", "copy,printer-filament"]),
        (["export-runs", "r", "--to", "z"], ["zarr"]),
        (["export-simulator", "--to", "mjcf,u"], ["mjcf,urdf", "mjcf,usd"]),
        (["completion", ""], ["bash", "zsh", "fish"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_values_of_commands_and_options(words: list[str], expected: list[str], folder: Path) -> None:
    assert offered(*words) == expected


def test_texture_files_are_offered_with_the_paper_textures(folder: Path) -> None:
    for name in ("hex.toml", "hexagon.stl", ".hidden.toml"):
        (folder / name).touch()
    (folder / "mine").mkdir()
    (folder / "mine" / "waves.toml").touch()
    assert offered("make", "--texture", "1,h") == ["1,hexagons", "1,hex.toml"]
    assert offered("show", "") == [*TEXTURES, "hex.toml"]
    assert offered("show", "mine/") == ["mine/waves.toml"]
    assert kinds("show", "other/") == {"file"}


def test_own_printers_are_offered_and_a_broken_file_is_ignored(folder: Path) -> None:
    (folder / "own.toml").write_text(
        '[printer.lab-delta]\nbed_mm = [200, 200]\nheight_mm = 200\nfilaments = ["petg"]\n'
    )
    assert "lab-delta" in offered("plate", "--printers", "own.toml", "--printer", "")
    assert offered("plate", "--printers", "own.toml", "--printer", "lab-delta", "--filament", "") == ["petg"]
    (folder / "own.toml").write_text("[printer")
    assert "ender-3" in offered("plate", "--printers", "own.toml", "--printer", "")


def test_run_folders_are_offered_before_other_folders(folder: Path) -> None:
    for name in ("runs/texture-1", "runs/texture-2", "results", "other/deep/run"):
        (folder / name).mkdir(parents=True)
    for name in ("runs/texture-1/run.json", "runs/texture-2/targets.csv", "other/deep/run/run.json"):
        (folder / name).touch()
    assert offered("variance", "") == ["runs"]
    assert offered("check-runs", "runs/") == ["runs/texture-1", "runs/texture-2"]
    assert offered("publish", "runs/texture-2") == ["runs/texture-2"]
    assert kinds("variance", "resu") == {"dir"}


def test_files_and_folders_are_listed_by_the_shell() -> None:
    assert kinds("check-part", "") == {"file"}
    assert kinds("acquire", "stu") == {"file"}
    assert kinds("make", "--out", "") == {"dir"}
    assert kinds("make", "-o", "") == {"dir"}


@pytest.mark.parametrize("shell", INSTALL)
def test_the_script_calls_this_program_and_explains_its_installation(shell: str, capsys: Capture) -> None:
    assert main(["completion", shell]) == 0
    out, err = capsys.readouterr()
    assert f"{VARIABLE}={shell}_complete" in out
    assert err == f"Next: {INSTALL[shell]}\n"
    assert get_completion_class(shell) is not None


def test_completion_loads_no_heavy_module(folder: Path) -> None:
    lines = ("tacbench ", "tacbench make --texture ", "tacbench plate --printer ", "tacbench variance ")
    code = (
        "import os, sys\n"
        "from tacbench_cad.cli import main\n"
        f"for line in {lines!r}:\n"
        "    os.environ |= {'COMP_WORDS': line, 'COMP_CWORD': str(len(line.split()))}\n"
        "    print(main([]), file=sys.stderr)\n"
        "print(*({name.split('.')[0] for name in sys.modules}"
        " & {'numpy', 'scipy', 'OCP', 'cv2', 'matplotlib'}), file=sys.stderr)\n"
    )
    environment = os.environ | {VARIABLE: "bash_complete"}
    process = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert process.stderr == "0\n0\n0\n0\n\n"
    assert "make" in process.stdout and "ender-3" in process.stdout
