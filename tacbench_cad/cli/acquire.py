"""``tacbench acquire``: press blocks on a rig, real, simulated or mixed."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import ask_line, note
from tacbench_cad.util.errors import CheckFailedError, InputError, located
from tacbench_cad.util.text import counted

#: How many times faster than real time the rig of ``--virtual`` runs.
_VIRTUAL_SPEED = 50.0
_VIRTUAL = "With --virtual"


@options.command("acquire")
@options.argument("study", options.file("FILE.toml"), "Blocks, protocol and rig.", required=False)
@options.option("--init", options.file("FILE.toml"), "Write such a file, every key explained, and stop.")
@options.flag("--virtual", "One block on a rig that is simulated throughout; needs no file.")
@options.option("--texture", options.text("T"), "The texture. Default: 1.", panel=_VIRTUAL)
@options.option("--driver", options.text("D"), "virtual-grbl (default) or virtual-marlin.", panel=_VIRTUAL)
@options.option("--speed", options.NUMBER, "Times faster than real time. Default: 50.", panel=_VIRTUAL)
@options.out("DIR", "Folder of the run folders. Default: the file's own.")
def command(
    study: Path | None,
    init: Path | None,
    virtual: bool,
    texture: str | None,
    driver: str | None,
    speed: float | None,
    out: Path | None,
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

        if virtual or study is not None:
            raise InputError("init", str(init), "goes with no other option; it only writes a file")
        write_template(init)
        note(f"wrote {init}; edit it, then: tacbench acquire {init}")
        return
    from tacbench_cad.lab.acquire.person import Typing
    from tacbench_cad.lab.acquire.progress import ProgressLines
    from tacbench_cad.lab.acquire.session import acquire_study
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.lab.study.file import read_study, virtual_study
    from tacbench_cad.virtual_rig.devices import open_rig

    if virtual:
        if study is not None:
            raise InputError("virtual", str(study), "needs no file; leave one of the two out")
        chosen = virtual_study(
            texture=texture or "1",
            driver=driver or "virtual-grbl",
            speed=_VIRTUAL_SPEED if speed is None else speed,
            out=out,
        )
    else:
        for name, value in (("texture", texture), ("driver", driver), ("speed", speed)):
            if value is not None:
                raise InputError(name, value, "goes with --virtual; otherwise the file says it")
        if study is None:
            raise InputError("file", None, "name a TOML file (--init writes one), or use --virtual")
        chosen = read_study(study)
    folder = out or chosen.out
    if folder is None:
        raise InputError("out", None, "name the folder of the run folders")
    with located("" if study is None else f"{study}: ", fields="["):
        results = acquire_study(
            chosen.study,
            chosen.required_rig,
            folder,
            person=Typing(partial(ask_line, err=True), note),
            progress=ProgressLines(folder),
            opener=open_rig,
        )
    for result in results:
        missed = f", {result.missed} of them out of their band" if result.missed else ""
        note(f"{result.folder}: {counted(result.presses, 'press')}{missed}")
    unsound = [str(result.folder) for result in results if not check_run(result.folder).ok]
    if unsound:
        raise CheckFailedError(f"complete but not sound: tacbench check-runs {' '.join(unsound)}")
    click.echo(f"{counted(len(chosen.study.blocks), 'run')} complete in {folder}")
