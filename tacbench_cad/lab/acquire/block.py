"""One block: references, stationary frames and every missing press, each on the disk before the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

import numpy as np

from tacbench_cad.lab.acquire.forces import ContactForce
from tacbench_cad.lab.acquire.press import Presser, SettledPress
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import Carriage, Signals
from tacbench_cad.lab.acquire.touch import Touch, by_gauge, by_sensor, taught
from tacbench_cad.lab.rig.devices import Rig
from tacbench_cad.lab.rig.errors import NotReachedError, SensorError
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.writing import RunWriter
from tacbench_cad.lab.study.presses import Press


@dataclass(frozen=True, kw_only=True)
class BlockResult:
    """What a session at one block gave.

    Args:
        folder: The run folder, complete.
        presses: Presses made in this session.
        missed: Those of them whose force lies outside of its band.
        seconds: Time in ``encode`` and ``sync``, as :class:`~tacbench_cad.lab.runs.writing.RunWriter` counts it.
    """

    folder: Path
    presses: int
    missed: int
    seconds: dict[str, float]


def press_block(
    rig: Rig,
    info: RunInfo,
    folder: Path,
    *,
    signals: Signals,
    progress: PressProgress,
    taught_mm: Sequence[float] = (),
    durable: bool = True,
) -> BlockResult:
    """Press a block, or resume its run where it was left.

    Args:
        rig: The devices, open; the block lies in its slot.
        info: The run.
        folder: Its folder.
        signals: Go to this block's carriage meanwhile.
        progress: Receives progress updates.
        taught_mm: Heights of first touch that a person found (``touch = "taught"``).
        durable: See :meth:`tacbench_cad.lab.runs.writing.RunWriter.open`.

    Raises:
        RigError: A device failed or a limit was met. The sensor was lifted if the stage still answered, and the run
            can be resumed.
        InputError: The folder holds another run, is held by another process, or cannot be written.
        RunInterruptedError: A signal came; likewise.
    """
    with RunWriter.open(folder, info, durable=durable) as run:
        for note in run.notes:
            progress.say(f"{folder.name}: {note}")
        settings = rig.settings.stage
        carriage = Carriage(
            rig.stage,
            info.plan.frame,
            info.plan.protocol,
            info.plan.holder,
            travel_mm_s=settings.travel_mm_s,
            approach_mm_s=settings.approach_mm_s,
            may_home=settings.home,
        )
        session = _BlockSession(rig, run, carriage, progress, taught_mm)
        progress.begin(folder.name, len(run.done), len(info.presses))
        try:
            with signals.sent_to(carriage), carriage.safely(progress.say):
                session.all()
        finally:
            progress.end()
        return BlockResult(folder=folder, presses=session.presses, missed=session.missed, seconds=dict(run.seconds))


@dataclass(eq=False)
class _BlockSession:
    """The work at one block from the first move to the last.

    Args:
        rig: The devices.
        run: The run, open.
        carriage: Moves the sensor.
        progress: Receives progress updates.
        taught_mm: See :func:`press_block`.
    """

    rig: Rig
    run: RunWriter
    carriage: Carriage
    progress: PressProgress
    taught_mm: Sequence[float]
    presses: int = 0
    missed: int = 0
    _in_a_row: int = 0
    _previous: Frame | None = None

    def __post_init__(self) -> None:
        self.protocol, gauge = self.run.info.plan.protocol, self.rig.gauge
        self.force = None if gauge is None else ContactForce(gauge, self.carriage, self.protocol, self.rig.clock)
        self.presser = Presser(self.protocol, self.carriage, self.force, self._touch())

    def all(self) -> None:
        """Everything that is missing; the sensor ends in contact or above, and the caller lifts it."""
        plan = self.run.info.presses
        missing = self.run.missing(plan)
        middle = self.run.info.middle_press
        self.carriage.over(middle.x_mm, middle.y_mm)
        if self.force is not None:
            self.force.tare()
        self._reference()
        self._stationary("start", middle)
        for press in missing:
            self._reference_if_due(press)
            self._press(press)
        self._stationary("end", middle)

    def _press(self, press: Press) -> None:
        contact = self.presser.press(press)
        time_utc = datetime.now(UTC)
        frame = self._read()
        after = None if self.force is None else self.force.again()
        # Nothing is written while the sensor presses: a disk that waits must not make the dome creep.
        self.carriage.lift()
        path = self.run.press(press, contact.pose_mm, frame, contact.measured, after, contact.in_band, time_utc)
        self.presses += 1
        self.progress.pressed(len(self.run.done), contact.measured, contact.in_band, self.run.folder / path)
        self._count_misses(press, contact)

    def _count_misses(self, press: Press, contact: SettledPress) -> None:
        self._in_a_row = self._in_a_row + 1 if contact.in_band is False else 0
        self.missed += contact.in_band is False
        if self._in_a_row >= self.protocol.misses_allowed:
            assert contact.measured is not None
            raise NotReachedError(
                f"{self._in_a_row} presses in a row missed their band, the last with {contact.measured.mean_n:.4f} N "
                f"for {press.target_n:g} +- {press.band_n:g} N; widen bands_n, allow more search_steps, or look at the "
                "gauge's noise and the stage's resolution"
            )

    def _reference_if_due(self, press: Press) -> None:
        since = self.run.reference_time
        age_s = (datetime.now(UTC) - since).total_seconds() * self.rig.clock.speed if since is not None else 0.0
        if age_s >= self.protocol.reference_every_s:
            self.carriage.over(press.x_mm, press.y_mm)
            self._reference()

    def _reference(self) -> None:
        """A frame of the free sensor. Every session begins with one: block and lamp are not what they were."""
        self.rig.clock.sleep(self.protocol.settle_s)
        time_utc = datetime.now(UTC)
        self.run.reference(self._read(), time_utc)

    def _stationary(self, when: Literal["start", "end"], middle: Press) -> None:
        """The frames without motion that are missing, in contact at the middle force and free."""
        count = self.protocol.stationary_frames
        pressed = self.run.stationary_missing(when, True, count)
        if pressed:
            self.presser.press(middle)
            for index in pressed:
                self.run.stationary(when, True, index, self._read())
                if self.force is not None:
                    self.force.glance()
        free = self.run.stationary_missing(when, False, count)
        if free:
            self.carriage.over(middle.x_mm, middle.y_mm)
            self.rig.clock.sleep(self.protocol.settle_s)
            for index in free:
                self.run.stationary(when, False, index, self._read())

    def _read(self) -> Frame:
        """A frame of the sensor; an image that repeats the one before shows a sensor that hangs."""
        self.carriage.check()
        frame = self.rig.sensor.read()
        previous, self._previous = self._previous, frame
        if previous is not None and is_image(frame) and np.array_equal(previous, frame):
            raise SensorError(
                "the sensor gave the same image twice, to the last count; it is stuck: open or plug it in again"
            )
        return frame

    def _touch(self) -> Touch | None:
        if self.protocol.contact == "force":
            return None
        if self.protocol.touch == "taught":
            return taught(self.taught_mm, len(self.protocol.grid.positions_mm))
        if self.protocol.touch == "sensor":
            return by_sensor(self.carriage, self.protocol, self.rig.sensor, self.rig.clock)
        assert self.force is not None, "touch by the gauge without one is refused before any device is opened"
        return by_gauge(self.carriage, self.protocol, self.force)
