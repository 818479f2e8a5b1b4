"""Tab completion: the offered commands, options and values, the speed, and the scripts for the shells."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete, get_completion_class

from tacbench_cad import cli
from tacbench_cad.cli import classify, import_frames, main, options, simulate
from tacbench_cad.cli.completing import RUN_FILES, VARIABLE
from tacbench_cad.cli.completion import INSTALL
from tacbench_cad.cli.options import TEXTURES
from tacbench_cad.extensions.simulators import command as export_simulator

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


def test_an_unknown_or_old_command_completes_to_nothing(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "bash_complete")
    monkeypatch.setenv("COMP_CWORD", "2")
    for words in ("tacbench mkae ", "tacbench check "):
        monkeypatch.setenv("COMP_WORDS", words)
        assert main([]) == 1
        assert capsys.readouterr() == ("", "")


def test_the_completed_words_agree_with_the_program() -> None:
    from tacbench_cad.extensions.simulators import SIMULATOR_TARGETS
    from tacbench_cad.formats import FORMATS
    from tacbench_cad.lab.analysis.classification.splits import HOLD_OUT_LEVELS
    from tacbench_cad.lab.analysis.classification.sweep import PARAMETERS
    from tacbench_cad.lab.runs import schema
    from tacbench_cad.lab.runs.importing.sources import FIELDS
    from tacbench_cad.lab.simulate.appearances import LOOKS
    from tacbench_cad.making.request import PARTS

    assert set(options.FILE_FORMATS) == set(FORMATS)
    assert tuple(PARTS) == options.PART_NAMES
    assert (*HOLD_OUT_LEVELS, "session") == options.LEVELS
    assert set(export_simulator.FORMATS) == set(SIMULATOR_TARGETS)
    assert tuple(LOOKS) == simulate.LOOK_NAMES
    assert tuple(PARAMETERS) == classify.SWEPT
    assert RUN_FILES == (schema.RUN_FILE, schema.TARGETS_FILE)
    assert set(import_frames.COLUMNS) == set(FIELDS) - {"array"}


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


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes_a_line(folder: Path) -> None:
    """Run the script in bash, with a command ``tacbench`` in the search path."""
    (folder / "bin").mkdir()
    command = folder / "bin" / "tacbench"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tacbench_cad "$@"\n')
    command.chmod(0o755)
    script = (
        'eval "$(tacbench completion bash 2>/dev/null)"\n'
        "complete -p tacbench >/dev/null || exit 9\n"
        "COMP_WORDS=(tacbench make --texture 1,4,); COMP_CWORD=3; COMP_LINE=x; _tacbench_completion tacbench\n"
        'printf "%s " "${COMPREPLY[@]}"\n'
    )
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    process = subprocess.run(
        ["bash", "--norc", "-c", script], env=os.environ | {"PATH": path}, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    assert process.stdout.split() == [f"1,4,{name}" for name in TEXTURES if name not in "14"]
