"""One block of a simulated study, which the press loop presses on an ideal simulated rig.

The rig knows the contact model, so it needs no search for a force. Its clock never waits.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacbench_cad.lab.acquire.block_presses import press_block
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import is_complete
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import OpenRig
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.stage import LimitedStage, Limits
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.printrecord import FIELDS
from tacbench_cad.lab.simulate.appearances import CLEAN, look_named
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.simulate.prints import Printers, printer_of, seeded
from tacbench_cad.lab.simulate.simulated_devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.simulate.simulated_stage import SimulatedStage
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import (
    NO_GAUGE,
    ContactMode,
    GaugeSettings,
    PlannedBlock,
    PrintedBlock,
    RigSettings,
    Seed,
    SensorSettings,
    StageSettings,
    Study,
)
from tacbench_cad.util.convert import Checked, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, write_text

#: The time from one simulated press to the next, in s.
SECONDS_PER_PRESS = 4.0
#: The limits of the stage of an ideal rig, in mm.
EVERYWHERE: Limits = ((-1e5, 1e5), (-1e5, 1e5), (-1e5, 1e5))


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(Checked):
    """The options of a simulation.

    Args:
        colour: Whether images are in colour (BGR) or grey.
        seed: The seed. Another seed gives other prints and other noise.
        look: The name of the sensor's look, see :data:`tacbench_cad.lab.simulate.appearances.LOOKS`.
        printers: Simulated printers that replace the virtual printers of the same printer and filament.
    """

    colour: bool = False
    seed: Seed = 0
    look: str = CLEAN.name
    printers: Printers = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        look_named(self.look)


@dataclass(frozen=True, kw_only=True)
class SimulatedBlock:
    """The result of a call that simulated a block.

    Args:
        name: The name of the run folder.
        presses: The number of new presses.
        images: The number of new images, including references, frames without motion and moving frames.
        worst_n: The largest distance of a new force from its target, in N; 0 in depth mode.
    """

    name: str
    presses: int
    images: int
    worst_n: float


def run_info(study: Study, planned: PlannedBlock, options: SimulationOptions) -> RunInfo:
    """Return the contents of ``run.json`` for a block's simulated run."""
    rig = ideal_rig(planned.printed, study.protocol.targets.contact, options)
    return RunInfo.of(study, planned, None, 0, **rig.info)


def ideal_rig(printed: PrintedBlock, contact: ContactMode, options: SimulationOptions) -> OpenRig:
    """Return a simulated rig without a block, whose clock never waits.

    Its stage moves at once, so the time of a press does not depend on the way to it. Its gauge has no noise.

    Args:
        printed: The block that the rig will press.
        contact: ``force``, or ``depth`` for a rig without a gauge.
        options: The options of the simulation.
    """
    clock, printer = Clock(speed=math.inf), printer_of(printed, options.printers)
    simulated = SimulatedStage(Clock(speed=math.inf), EVERYWHERE)
    simulated.simulated = f"simulated stage; block from a virtual printer, {printer.name}"
    stage = LimitedStage(simulated, EVERYWHERE)
    gauge = SimulatedGauge(stage.position, clock, noise_n=0.0) if contact == "force" else None
    look = {"colour": options.colour, "look": options.look}
    sensor = SimulatedSensor(stage.followed_mm, clock, look, in_motion=lambda: stage.moving_mm is not None)
    known = {
        "virtual_printer": to_plain(printer, without_none=True),
        "seed": options.seed,
        "seconds_a_press": SECONDS_PER_PRESS,
    }
    settings = RigSettings(
        stage=StageSettings(driver="simulated", limits_mm=EVERYWHERE, home=False, options=known),
        gauge=GaugeSettings(driver=NO_GAUGE if gauge is None else "simulated"),
        sensor=SensorSettings(driver="simulated", options=look),
    )
    following = (sensor,) if gauge is None else (gauge, sensor)
    return OpenRig(stage=stage, gauge=gauge, sensor=sensor, clock=clock, settings=settings, following=following)


def lay_block(rig: OpenRig, info: RunInfo, options: SimulationOptions) -> Callable[[Press], float]:
    """Print the block of a run and lay it on an ideal rig.

    Returns:
        A function that returns the height at which a press reaches its force or depth, in mm of the work frame. It
        raises ``InputError`` if the force cannot be reached there, or the height is below the depth limit.
    """
    plan = info.plan
    contact = contact_for(plan.printed, plan.holder, printer_of(plan.printed, options.printers), seed=options.seed)
    for device in rig.following:
        device.lay(contact, plan.frame)
    limit_mm = plan.protocol.limits.depth_limit_mm

    def height_mm(press: Press) -> float:
        if press.target_n is not None:
            z = contact.z_for_force(press.x_mm, press.y_mm, press.target_n)
        else:
            assert press.depth_mm is not None, "a press has a force or a depth"
            z = contact.first_touch(press.x_mm, press.y_mm) - press.depth_mm
        if z < -limit_mm:
            below = f"press {press.number} of {plan.printed.name} would go {-z:.3f} mm below the block's top"
            raise InputError("depth_limit_mm", limit_mm, below)
        return z

    rig.known_mm = height_mm
    return height_mm


class _Pace(PressProgress):
    """Gives each press a time and a noise of its own, so that a resumed run ends like an uninterrupted one."""

    def __init__(self, clock: Clock, sensor: Any, seed: int) -> None:
        self._clock, self._sensor, self._seed, self._name = clock, sensor, seed, ""
        self._target_n: float | None = None
        self.worst_n = 0.0

    def begin(self, name: str, done: int, total: int) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self._name = name
        self._start("session", done)

    def before(self, press: Press, check: Callable[[], None]) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self._target_n = press.target_n
        self._start("press", press.number)

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        if force is not None and self._target_n is not None:
            self.worst_n = max(self.worst_n, abs(force.mean_n - self._target_n))

    def _start(self, what: str, number: int) -> None:
        self._clock.sleep(SECONDS_PER_PRESS * number - self._clock.now_s())
        self._sensor.reseed(seeded("image", self._seed, self._name, what, number))


def simulate_block(out: Path, info: RunInfo, options: SimulationOptions) -> SimulatedBlock:
    """Write a block's run folder, or the missing part of it.

    Args:
        out: The folder of the runs.
        info: The run, see :func:`run_info`.
        options: The options of the simulation.

    Raises:
        InputError: The folder contains another run, is used by another process, or cannot be written; or a force
            cannot be reached.
    """
    import cv2

    cv2.setNumThreads(1)  # blocks run in parallel processes, so threads would only slow each other down
    name = info.printed.name
    folder, plan = out / name, info.plan
    _record_print(folder, info, options)
    if is_complete(folder, info):
        return SimulatedBlock(name=name, presses=0, images=0, worst_n=0.0)
    before = images_there(folder)
    rig = ideal_rig(plan.printed, plan.protocol.targets.contact, options)
    lay_block(rig, info, options)
    pace = _Pace(rig.clock, rig.sensor, options.seed)
    result = press_block(rig, info, folder, signals=Signals(), progress=pace, durable=False)
    images = images_there(folder) - before
    return SimulatedBlock(name=name, presses=result.presses, images=images, worst_n=pace.worst_n)


def images_there(folder: Path) -> int:
    """Return the number of images in a run folder."""
    frames = sum(1 for name in schema.FRAME_FOLDERS for _ in (folder / name).glob("*.png"))
    return frames + sum(1 for _ in (folder / schema.SERIES_FOLDER).glob("*/*.png"))


def other_images(info: RunInfo) -> int:
    """Return the number of reference, stationary and moving images of a run."""
    presses_each = math.floor(info.plan.protocol.checks.reference_every_s / SECONDS_PER_PRESS) + 1
    moving = len(info.presses) * info.series_frames
    return 1 + len(info.presses) // presses_each + 4 * info.plan.protocol.checks.stationary_frames + moving


def _record_print(folder: Path, info: RunInfo, options: SimulationOptions) -> None:
    """Write the print record of a new run. For a virtual printer, the values are known."""
    printed, printer = info.plan.printed, printer_of(info.plan.printed, options.printers)
    known: dict[str, Any] = {
        "printer": f"{printed.printer}, virtual",
        "filament": f"{printed.filament}, virtual",
        "slicer": "none: a virtual printer",
        "slicer_profile": f"{printer.name}, seed {options.seed}, copy {printed.copy}; parameters in run.json",
        "nozzle_mm": printer.nozzle_mm,
        "layer_height_mm": printer.layer_mm,
        "orientation": "relief up",
    }
    lines = [f"# Record of the simulated print {printed.name}. Nothing was printed."]
    for name in FIELDS:
        empty: Any = [] if name == "photos" else ""
        lines.append(f"{name} = {json.dumps(known.get(name, empty))}")
    with locked(folder):
        if not (folder / schema.RUN_FILE).exists() and not (folder / schema.PRINT_FILE).exists():
            write_text(folder / schema.PRINT_FILE, "\n".join(lines) + "\n")
