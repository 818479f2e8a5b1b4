"""``tacbench acquire``: press blocks on a rig, real, simulated or mixed."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import note, number_of
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.text import counted

NAME = "acquire"

#: How many times faster than real time the rig of ``--virtual`` runs.
_VIRTUAL_SPEED = 50.0


def command(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE.toml", help="Blocks, protocol and rig.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the run folders. Default: the file's own.")
    ] = None,
    init: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Write such a file, every key explained, and stop.")
    ] = None,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="One block on a rig that is simulated throughout; needs no file.")
    ] = False,
    texture: Annotated[str | None, typer.Option(metavar="T", help="With --virtual: the texture. Default: 1.")] = None,
    driver: Annotated[
        str | None,
        typer.Option(metavar="D", help="With --virtual: virtual-grbl (default) or virtual-marlin."),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(metavar="N", help="With --virtual: times faster than real time. Default: 50."),
    ] = None,
) -> None:
    """Press blocks by the paper's protocol: travel, approach, press to the force, read, lift; a run folder a block.

    A run may be interrupted at any instant; the same command goes on at the first missing press of any block. It
    refuses where block, protocol, rig or sensor settings changed, and names what did. On Ctrl-C, and whenever a device
    fails, the sensor is lifted if the stage still answers. Of a study it says which block to put in next and asks for
    the block's label. While it runs, last.png in the output folder is the newest image.

    Exit codes: 0 done, 1 a finished run is not sound, 2 bad input, 3 a device failed and the run was stopped safely,
    130 interrupted.

    Examples:
      tacbench acquire --init study.toml         a file to begin with
      tacbench acquire study.toml
      tacbench acquire study.toml --out /data/runs
      tacbench acquire --virtual --out runs      150 presses without any hardware
      tacbench acquire --virtual --texture 4 --driver virtual-marlin --speed 20 --out runs
    """
    if init is not None:
        from tacbench_cad.lab.acquire.template import write_template

        if virtual or file is not None:
            raise InputError("init", str(init), "goes with no other option; it only writes a file")
        write_template(init)
        note(f"wrote {init}; edit it, then: tacbench acquire {init}")
        return
    from tacbench_cad.lab.acquire.person import Typing
    from tacbench_cad.lab.acquire.progress import ProgressLines
    from tacbench_cad.lab.acquire.safety import RunInterruptedError
    from tacbench_cad.lab.acquire.session import acquire_study
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.lab.study.file import read_study, virtual_study
    from tacbench_cad.virtual_rig.devices import open_rig

    if virtual:
        if file is not None:
            raise InputError("virtual", str(file), "needs no file; leave one of the two out")
        chosen = virtual_study(
            texture=texture or "1",
            driver=driver or "virtual-grbl",
            speed=_VIRTUAL_SPEED if speed is None else number_of("speed", speed),
            out=out,
        )
    else:
        for name, value in (("texture", texture), ("driver", driver), ("speed", speed)):
            if value is not None:
                raise InputError(name, value, "goes with --virtual; otherwise the file says it")
        if file is None:
            raise InputError("file", None, "name a TOML file (--init writes one), or use --virtual")
        chosen = read_study(file)
    folder = out or chosen.out
    if folder is None:
        raise InputError("out", None, "name the folder of the run folders")
    options = {"--texture": texture, "--driver": driver, "--speed": speed, "--out": out}
    given = [word for name, value in options.items() if value is not None for word in (name, str(value))]
    try:
        results = acquire_study(
            chosen.study,
            chosen.required_rig,
            folder,
            person=Typing(_ask, note),
            progress=ProgressLines(folder),
            opener=open_rig,
        )
    except RunInterruptedError as error:
        again = shlex.join(["tacbench", "acquire", "--virtual" if virtual else str(file), *given])
        note(f"{error}; resume with: {again}")
        raise
    for result in results:
        missed = f", {result.missed} of them out of their band" if result.missed else ""
        note(f"{result.folder}: {counted(result.presses, 'press')}{missed}")
    unsound = [str(result.folder) for result in results if not check_run(result.folder).ok]
    if unsound:
        raise CheckFailedError(f"complete but not sound: tacbench runs check {' '.join(unsound)}")
    typer.echo(f"{counted(len(chosen.study.blocks), 'run')} complete in {folder}")


def _ask(prompt: str) -> str:
    """One line of the standard input, a terminal's or a script's; prompt and a script's line go where notes go."""
    typer.echo(prompt, nl=False, err=True)
    line = input()
    if not sys.stdin.isatty():
        typer.echo(line, err=True)
    return line
