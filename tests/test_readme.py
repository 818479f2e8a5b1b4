"""The code of the README runs, and its commands exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tacbench_cad.cli import main

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
#: The pages whose commands are checked, also in blocks that the build of the manual skips because they need hardware.
PAGES = [README, ROOT / "CONTRIBUTING.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: A command, with the name of its group if it has one, and the words after it.
_COMMAND = re.compile(r"tacbench (rig [\w-]+|[\w-]+)(.*)")


def blocks(page: Path, language: str) -> list[str]:
    """Return the fenced blocks of one language, without those that are run."""
    fences = re.findall(r"^```([^\n]*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [code for info, code in fences if info == language]


@pytest.mark.parametrize("code", blocks(README, "python"))
def test_python_blocks_run(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("OCP")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    assert {path.suffix for path in (tmp_path / "stl_out").iterdir()} >= {".stl", ".step"}


@pytest.mark.long
def test_the_texture_file_makes_checked_stl_and_step(tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    file = tmp_path / "towers.toml"
    file.write_text(blocks(README, "toml")[0], encoding="utf-8")
    assert main(["make", "--texture", str(file), "--parts", "blocks", "--out", str(tmp_path / "made")]) == 0
    files = sorted((tmp_path / "made").glob("towers*"))
    assert {path.suffix for path in files} == {".stl", ".3mf", ".step"}
    assert main(["check-part", *map(str, files), "--texture", str(file)]) == 0


def test_options_in_blocks_that_are_not_run_exist(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    named = set()
    for page in PAGES:
        for command, rest in _COMMAND.findall("\n".join([*blocks(page, ""), *blocks(page, "sh")])):
            named |= {(command, option) for option in re.findall(r"--[a-z][a-z-]*", rest)}
    assert named
    for command in {command for command, _ in named}:
        assert main([*command.split(), "--help"]) == 0
        text = capsys.readouterr().out
        for option in {option for name, option in named if name == command}:
            assert option in text, f"tacbench {command} {option}"
