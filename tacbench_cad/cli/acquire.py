"""``tacbench acquire``: press blocks on a rig, real or simulated."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import ask_line, note, print_next, say_interrupted
from tacbench_cad.util.errors import CheckFailedError, InputError, MissingToolError, located
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.acquire.person import Person
    from tacbench_cad.lab.acquire.safety import RunInterruptedError
    from tacbench_cad.lab.acquire.study_file import StudyFile

#: How many times faster than real time the rig of ``--virtual`` runs.
_VIRTUAL_SPEED, _SPEEDS = 50.0, (0.1, 1000.0)


@options.command("acquire", "Press")
@options.argument("study", options.file("FILE.toml"), "Study file: blocks, protocol and rig.", required=False)
@options.flag(
    "--virtual",
    "Rehearse FILE.toml on simulated devices in the place of its own; without a file, press one block.",
    options.VIRTUAL_RIG,
)
@options.option("--texture", options.TEXTURE, "Texture of the block. Default: 1.", options.VIRTUAL_RIG)
@options.option(
    "--driver",
    options.text("NAME", complete=completing.of_simulated_stages),
    "Driver of the simulated stage, for example virtual-grbl. Default: simulated.",
    options.VIRTUAL_RIG,
)
@options.option(
    "--speed", options.NUMBER, "Speed of the virtual rig; 1 is real time. Default: 50.", options.VIRTUAL_RIG
)
@options.flag(
    "--page", "Show the run on a page in the browser, with buttons for Stop, Pause and the blocks.", options.PAGE
)
@options.host
@options.port
@options.no_browser
@options.out("DIR", "Folder of the runs. You can leave it out if the study file names a folder.")
@options.option(
    "--init", options.file("FILE.toml"), "Write a study file whose usual keys are explained, and stop.", options.OUTPUT
)
def command(
    study: Path | None,
    init: Path | None,
    virtual: bool,
    texture: str | None,
    driver: str | None,
    speed: float | None,
    out: Path | None,
    page: bool,
    host: str,
    port: int,
    no_browser: bool,
) -> None:
    """Press blocks on a rig, real or simulated.

    For each press, the sensor moves to a position and presses the block until the force is reached. It records a frame
    and is lifted. With [protocol.motion], it first slides in contact while frames and forces are recorded. Each block
    gets its own run folder. If a study has several blocks, the command says which block comes next and asks for its
    label. While it runs, the newest frame is in last.png in the output folder.

    Before it starts, the command says how long the run will take and how many files it will write. With --virtual, it
    rehearses your file: the blocks, protocol, holder and limits are yours, and only the devices are simulated. The runs
    of a rehearsal are written to the folder of your runs with "-rehearsal" in its name.

    With --page, a page in the browser shows the run. Its buttons do the same as Ctrl-C (Stop), wait before the next
    press (Pause) and confirm a block by its typed label (Block is in). They work only on this machine: with the second
    printed address, and from other machines, the page can only be watched. The run goes on if the page is closed.

    You can interrupt a run at any time with Ctrl-C. The same command resumes it at the first missing press. If the
    block, the protocol, the rig or the sensor settings have changed since then, the command names the change and
    refuses to resume. After Ctrl-C or a fault of a device, the sensor is lifted if the stage still answers. Then the
    position of the last presses is checked, because they would otherwise be made again; a second Ctrl-C skips this. If
    a driver does not return after Ctrl-C, the second Ctrl-C gives it up.

    Exit codes: 0 done, 1 all presses were made but a run has faults, 2 wrong input, 3 a device failed and the run was
    stopped safely, 130 interrupted.

    Examples:
      tacbench acquire --init study.toml     # write a study file to edit
      tacbench acquire study.toml
      tacbench acquire study.toml --out /data/runs
      tacbench acquire study.toml --page
      tacbench acquire study.toml --virtual  # rehearse it without touching a device
      tacbench acquire --virtual --out runs  # 150 presses without any hardware
      tacbench acquire --virtual --texture 4 --driver virtual-marlin --out runs
    """
    if init is not None:
        from tacbench_cad.lab.study.editing import write_template

        if virtual or study is not None:
            raise InputError("init", str(init), "cannot be combined with other options; it only writes a file")
        write_template(init)
        note(f'wrote {init}; fill in the empty keys ("tacbench rig probe" lists ports and cameras)')
        print_next("rig", "align", init, err=True)
        return
    from tacbench_cad.lab.acquire.study_file import read_study, virtual_study

    if virtual:
        stage, speed = driver or "simulated", _VIRTUAL_SPEED if speed is None else speed
        if not _SPEEDS[0] <= speed <= _SPEEDS[1]:
            raise InputError("speed", speed, "must be from {:g} to {:g}".format(*_SPEEDS))
        if study is None:
            chosen = virtual_study(texture=texture or "1", driver=stage, speed=speed, out=out)
        elif texture is not None:
            raise InputError("texture", texture, "is only for --virtual without a file, which names its own blocks")
        else:
            with located(f"{study}: ", fields="["):
                chosen = read_study(study).rehearsal(stage, speed)
    else:
        for name, value in (("texture", texture), ("driver", driver), ("speed", speed)):
            if value is not None:
                raise InputError(name, value, "is only for --virtual; otherwise write it into the file")
        if study is None:
            raise InputError("FILE.toml", None, "is missing; name a study file (--init writes one), or use --virtual")
        chosen = read_study(study)
    folder = out or chosen.out
    if folder is None:
        raise InputError("--out DIR", None, "is missing; name the folder of the runs")
    if not page and (host != options.LOCAL or port or no_browser):
        raise InputError("--host, --port, --no-browser", None, "are only for --page")
    settings = {"host": host, "port": port, "browser": not no_browser} if page else None
    with located("" if study is None else f"{study}: ", fields="["):
        _press(chosen, folder, settings)
    print_next("check-runs", folder)


def _press(chosen: StudyFile, folder: Path, page: Mapping[str, Any] | None) -> None:
    """Press the blocks of a study, check the runs, and report the outcome. ``page`` has the settings of its page."""
    from tacbench_cad.lab.acquire.estimate import estimate
    from tacbench_cad.lab.acquire.events import ProgressFile
    from tacbench_cad.lab.acquire.person import Typing
    from tacbench_cad.lab.acquire.progress import PressProgress, ProgressLines, Several
    from tacbench_cad.lab.acquire.session import acquire_study
    from tacbench_cad.lab.runs.checking import check_run
    from tacbench_cad.util.entries import entries, load
    from tacbench_cad.util.packages import require

    # Frames are stored with this package. Without it, no file must be written.
    require("acquire", "cv2")
    rig = chosen.required_rig
    file = ProgressFile(folder)
    person: Person = Typing(partial(ask_line, err=True), note)
    receivers: list[PressProgress] = [ProgressLines(folder), file]

    def give_up(error: RunInterruptedError) -> None:
        say_interrupted(error, sys.argv[1:])
        file.ended(error)

    note(str(estimate(chosen.study, rig)))
    with ExitStack() as stack:
        stack.callback(file.close)
        if page is not None:
            pages = entries("tacbench.pages")
            if not pages:
                raise MissingToolError("no installed package has a page for acquire; leave out --page")
            opened = load(next(iter(pages.values())))(folder, **page, file=file, terminal=person, say=note)
            person = link = stack.enter_context(opened)
            receivers.append(link)
        stack.enter_context(file.finishing(f"{counted(len(chosen.study.blocks), 'run')} complete"))
        results = acquire_study(
            chosen.study,
            rig,
            folder,
            person=person,
            progress=Several(*receivers),
            give_up=give_up,
        )
        for result in results:
            missed = f", {result.missed} of them outside of their force band" if result.missed else ""
            note(f"{result.folder}: {counted(result.presses, 'press')}{missed}")
        faulty = [str(result.folder) for result in results if not check_run(result.folder).ok]
        if faulty:
            raise CheckFailedError(f"the runs are complete, but have faults: tacbench check-runs {shlex.join(faulty)}")
    click.echo(f"{counted(len(chosen.study.blocks), 'run')} complete in {folder}")
