"""One block of a simulated study: its presses are computed by the contact model and written to a run folder."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any

from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.printrecord import FIELDS
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.series import MovingFrame
from tacbench_cad.lab.simulate.appearances import CLEAN, look_named
from tacbench_cad.lab.simulate.contact import DomeContact, Drag, contact_for
from tacbench_cad.lab.simulate.prints import Printers, printer_of, seeded
from tacbench_cad.lab.simulate.tactip import SIMULATED, Pins, TacTip
from tacbench_cad.lab.study.motion import motion_of
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PlannedBlock, Point, Seed, Study
from tacbench_cad.util.convert import Checked, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, write_text

#: The date at which simulated runs begin. They need times for the age of a reference; the date is clearly not real.
BEGIN = datetime(2000, 1, 1, tzinfo=UTC)
#: The time from one simulated press to the next, in s.
SECONDS_PER_PRESS = 4.0


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

    @property
    def sensor(self) -> TacTip:
        """The sensor with these options."""
        return TacTip(colour=self.colour, look=look_named(self.look))


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
    sensor = options.sensor
    printer = printer_of(planned.printed, options.printers)
    return RunInfo.of(
        study,
        planned,
        stage={
            "identity": "none",
            "simulated": f"no stage: poses from the contact model; block from a virtual printer, {printer.name}",
            "settings": {
                "virtual_printer": to_plain(printer, without_none=True),
                "seed": options.seed,
                "seconds_a_press": SECONDS_PER_PRESS,
            },
        },
        gauge={
            "identity": "none",
            "simulated": "no gauge: forces from the contact model",
            "calibration": {},
            "settings": {},
        },
        sensor={
            "name": SIMULATED,
            "simulated": SIMULATED,
            "units": "counts",
            "shape": list(sensor.shape),
            "settings": {"requested": {"colour": options.colour, "look": options.look}, "actual": sensor.as_dict()},
        },
    )


class FrameSource:
    """Computes the frames of one run. The same press always gives the same bytes.

    Args:
        info: The run.
        options: The options of the simulation.

    Attributes:
        sensor: The sensor.
    """

    def __init__(self, info: RunInfo, options: SimulationOptions) -> None:
        self.info = info
        self._seed, self._printers = options.seed, options.printers
        self.sensor = options.sensor
        # If repeats of a press have the same pose, the pins are kept, about 6 kB for each press.
        self._kept: dict[tuple[int, int, int], tuple[Point, float, Pins]] = {}

    @cached_property
    def _contact(self) -> DomeContact:
        """Print the block when the first press needs it, so that a complete run takes no time."""
        printed, holder = self.info.plan.printed, self.info.plan.holder
        return contact_for(printed, holder, printer_of(printed, self._printers), seed=self._seed)

    def pressed(self, press: Press) -> tuple[Point, float, Pins]:
        """Return pose, contact force in N, and pins of a press at its target force or depth.

        The pose is that of the summit in the work frame, as a stage reports it. The pins are those after an individual
        approach, see :meth:`~tacbench_cad.lab.simulate.tactip.TacTip.approach`.

        Raises:
            InputError: The force cannot be reached there, or its depth is below the depth limit.
        """
        key = (press.force_level, press.position, press.repeat if self.sensor.look.misses else 0)
        if key not in self._kept:
            contact = self._contact
            pose = (press.x_mm, press.y_mm, self._depth_of(press, contact))
            rng = seeded("approach", self._seed, self.info.printed.name, press.number)
            self._kept[key] = (pose, contact.force_n(*pose), self.sensor.approach(contact, pose, rng))
        return self._kept[key]

    def moving(self, press: Press, pose: Point, when: datetime) -> list[MovingFrame]:
        """Return the frames of the motion after a press, at constant speed; none without a motion.

        Args:
            press: The press.
            pose: The pose of the press, where the motion begins.
            when: The time at which the motion begins.
        """
        motion, count, drag = motion_of(self.info.plan.protocol.motion), self.info.series_frames, Drag()
        frames: list[MovingFrame] = []
        for index in range(count if motion else 0):
            assert motion is not None
            fraction = index / (count - 1)
            (dx, dy), time_s = motion.shift_mm(fraction), fraction * motion.seconds
            at, contact = (pose[0] + dx, pose[1] + dy, pose[2]), self._contact
            force_n = contact.force_n(*at)
            # The error of the approach stays the same during the motion.
            rng = seeded("approach", self._seed, self.info.printed.name, press.number)
            pins = self.sensor.approach(contact, at, rng, drag.move(at, force_n))
            name = f"press {press.number} moving {index}"
            moving = MovingFrame(
                frame=self.frame(pins, name, when + timedelta(seconds=time_s)),
                time_s=time_s,
                pose_mm=at,
                pose_from="time",
                force_n=force_n,
            )
            frames.append(moving)
        return frames

    def _depth_of(self, press: Press, contact: DomeContact) -> float:
        if press.target_n is not None:
            z = contact.z_for_force(press.x_mm, press.y_mm, press.target_n)
        else:
            assert press.depth_mm is not None, "a press has a force or a depth"
            z = contact.first_touch(press.x_mm, press.y_mm) - press.depth_mm
        limit = self.info.plan.protocol.depth_limit_mm
        if z < -limit:
            raise InputError(
                "depth_limit_mm",
                limit,
                f"press {press.number} of {self.info.printed.name} would go {-z:.3f} mm below the block's top",
            )
        return z

    def frame(self, pins: Pins, name: str, when: datetime = BEGIN) -> Frame:
        """Return a frame of pins. Its name is the seed of the noise."""
        rng = seeded("image", self._seed, self.info.printed.name, name)
        return self.sensor.frame(pins, rng, (when - BEGIN).total_seconds())


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
    folder = out / info.printed.name
    _record_print(folder, info, options)
    with RunWriter.open(folder, info, durable=False) as run:
        source = FrameSource(info, options)
        missing = run.missing(info.presses)
        images, worst = len(missing) * (1 + info.series_frames), 0.0
        if run.reference_time is None:
            run.reference(source.frame(source.sensor.rest, "reference 0"), BEGIN)
            images += 1
        images += _stationary(run, source, "start")
        for press in missing:
            now = BEGIN + timedelta(seconds=SECONDS_PER_PRESS * press.number)
            since = run.reference_time
            if since is None or (now - since).total_seconds() > info.plan.protocol.reference_every_s:
                run.reference(source.frame(source.sensor.rest, f"reference before {press.number}", now), now)
                images += 1
            pose, force_n, pins = source.pressed(press)
            force = in_band = None
            if press.target_n is not None and press.band_n is not None:
                force = Force(mean_n=force_n, spread_n=0.0, samples=1)
                error = abs(force_n - press.target_n)
                in_band, worst = error <= press.band_n, max(worst, error)
            frame, moving = source.frame(pins, f"press {press.number}", now), source.moving(press, pose, now)
            run.press(press, pose, frame, force, force, in_band, now, moving)
        images += _stationary(run, source, "end")
    return SimulatedBlock(name=info.printed.name, presses=len(missing), images=images, worst_n=worst)


def other_images(info: RunInfo) -> int:
    """Return the number of reference, stationary and moving images of a run."""
    presses_each = math.floor(info.plan.protocol.reference_every_s / SECONDS_PER_PRESS) + 1
    moving = len(info.presses) * info.series_frames
    return 1 + len(info.presses) // presses_each + 4 * info.plan.protocol.stationary_frames + moving


def _stationary(run: RunWriter, source: FrameSource, when: schema.When) -> int:
    """Write the missing frames without motion, and return their number."""
    count = 0
    # The frames at the start are recorded after the light has settled, those at the end after the last press.
    at = BEGIN + timedelta(seconds=SECONDS_PER_PRESS * (1 if when == "start" else len(run.info.presses)))
    for in_contact, state in ((True, "pressed"), (False, "free")):
        for index in run.stationary_missing(when, in_contact, run.info.plan.protocol.stationary_frames):
            pins = source.pressed(run.info.middle_press)[2] if in_contact else source.sensor.rest
            frame = source.frame(pins, f"stationary {when} {index} {state}", at)
            run.stationary(when, in_contact, index, frame)
            count += 1
    return count


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
