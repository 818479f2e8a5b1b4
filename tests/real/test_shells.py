"""Tab completion in real shells: the test types a line with the tab key at a terminal and runs it."""

from __future__ import annotations

import os
import select
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pty = pytest.importorskip("pty", reason="there are no pseudo-terminals on this system")

pytestmark = pytest.mark.real

#: The options that start each shell without the user's settings, and the command that loads the script.
SHELLS = {
    "bash": (["--norc", "--noprofile", "-i"], 'eval "$(tacbench completion bash 2>/dev/null)"'),
    "zsh": (["-f", "-i"], 'autoload -U compinit; compinit -D; eval "$(tacbench completion zsh 2>/dev/null)"'),
    "fish": (["--no-config", "-i"], "tacbench completion fish 2>/dev/null | source"),
}
#: The time limit for a shell, in s.
MAX_SECONDS = 60.0
#: The time without output after which a completion is regarded as finished, in s.
QUIET_S = 2.0
TAB, ENTER = "\t", "\r"

Type = Callable[[str], list[str]]


def wait_for(path: Path) -> str:
    end = time.monotonic() + MAX_SECONDS
    while not path.is_file() or not path.read_text().endswith("\n"):
        assert time.monotonic() < end, f"{path.name} was not written"
        time.sleep(0.05)
    return path.read_text()


@pytest.fixture(params=SHELLS)
def type_and_run(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Type]:
    """Return a function that types a line with tabs at a shell and returns the arguments that the command received."""
    shell = request.param
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed: apt-get install {shell}")
    (tmp_path / "bin").mkdir()
    command = tmp_path / "bin" / "tacbench"
    # The program answers requests for completion. A line that is run writes its arguments to a file.
    command.write_text(
        "#!/bin/sh\n"
        'if [ -n "$_TACBENCH_COMPLETE" ] || [ "$1" = completion ]; then\n'
        f'  exec "{sys.executable}" -m tacbench_cad "$@"\n'
        "fi\n"
        f"printf '%s\\n' \"$*\" > {tmp_path}/arguments\n"
    )
    command.chmod(0o755)
    environment = {
        "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}",
        "HOME": str(tmp_path),
        "TERM": "xterm",
        "LC_ALL": "C.UTF-8",
        **{name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ},
    }
    work = tmp_path / "work"
    (work / "runs" / "texture-1").mkdir(parents=True)
    (work / "runs" / "texture-1" / "run.json").touch()
    (work / "mesh-like.toml").touch()
    options, setup = SHELLS[shell]
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(work)
        os.execve(program, [shell, *options], environment)
    output: list[bytes] = []

    def drain(quiet_s: float) -> None:
        while select.select([terminal], [], [], quiet_s)[0]:
            try:
                output.append(os.read(terminal, 65536))
            except OSError:
                return

    def type_line(line: str) -> list[str]:
        (tmp_path / "arguments").unlink(missing_ok=True)
        for part in line.split(TAB)[:-1]:
            os.write(terminal, f"{part}{TAB}".encode())
            drain(QUIET_S)
        os.write(terminal, ENTER.encode())
        drain(0.5)
        return wait_for(tmp_path / "arguments").split()

    drain(QUIET_S)
    os.write(terminal, f"{setup}; echo yes > {tmp_path}/ready{ENTER}".encode())
    end = time.monotonic() + MAX_SECONDS
    while not (tmp_path / "ready").is_file() and time.monotonic() < end:
        drain(0.2)
    assert (tmp_path / "ready").is_file(), b"".join(output).decode(errors="replace")
    drain(QUIET_S)
    yield type_line
    os.close(terminal)
    os.waitpid(child, 0)


def test_a_typed_line_is_completed(type_and_run: Type) -> None:
    assert type_and_run(f"tacbench simul{TAB}") == ["simulate"]
    assert type_and_run(f"tacbench make --pres{TAB}rel{TAB}") == ["make", "--preset", "released"]
    assert type_and_run(f"tacbench make --texture 1,mesh{TAB}") == ["make", "--texture", "1,mesh-like.toml"]
    assert type_and_run(f"tacbench plate --printer bamb{TAB}") == ["plate", "--printer", "bambu-p1p"]
    assert type_and_run(f"tacbench variance ru{TAB}") == ["variance", "runs"]
    assert type_and_run(f"tacbench classify runs --hold-out copy,prin{TAB}") == [
        *("classify", "runs", "--hold-out", "copy,printer-filament"),
    ]
