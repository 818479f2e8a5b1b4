"""Pressing of one block: references, stationary frames and missing presses, each saved before the next."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from tacbench_cad.lab.acquire.force_search import ContactForce
from tacbench_cad.lab.acquire.press import Presser, SettledPress
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import Carriage, RunInterruptedError
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.acquire.slips import HeightWatch, PositionChecks
from tacbench_cad.lab.acquire.touch import Touch, by_gauge, by_sensor, taught
from tacbench_cad.lab.rig.devices import OpenRig
from tacbench_cad.lab.rig.errors import (
    ContactError,
    ForceLimitError,
    RigError,
)
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.series import MovingFrame
from tacbench_cad.lab.study.motion import motion_of
from tacbench_cad.lab.study.presses import Press

#: The differences between the height of the block and the taught height, in mm, above which the person is told, and
#: asked. Prints and taught origins differ by some tenths of a millimetre.
SAY_MM, ASK_MM = 0.5, 1.0
#: The number of times that a press is made if the sensor is too slow during the motion after it.
MOTION_ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class BlockResult:
    """The result of a session at one block.

    Args:
        folder: The complete run folder.
        presses: The number of presses in this session.
        missed: The number of presses in this session whose force is outside the band.
    """

    folder: Path
    presses: int
    missed: int


def press_block(
    rig: OpenRig,
    info: RunInfo,
    folder: Path,
    *,
    signals: Signals,
    progress: PressProgress,
    taught_mm: Sequence[float] = (),
    durable: bool = True,
    confirm: Callable[[str], bool] = lambda question: False,
) -> BlockResult:
    """Press a block, or resume its run.

    Args:
        rig: The open devices; the block is in its slot.
        info: The description of the run.
        folder: The run folder.
        signals: Receives the signals, which then go to this block's carriage.
        progress: Receives progress updates.
        taught_mm: The heights of first touch that a person taught (``touch = "taught"``), in mm.
        durable: See :meth:`tacbench_cad.lab.runs.run_writer.RunWriter.open`.
        confirm: Asks the person whether a block at an unexpected height is pressed. The sensor is lifted meanwhile.

    Raises:
        RigError: A device failed or a limit was exceeded. The sensor was lifted if the stage still answered, and the
            run can be resumed.
        InputError: The folder contains another run, is used by another process, or cannot be written.
        RunInterruptedError: A signal interrupted the run. The sensor was lifted if possible; the run can be resumed.
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

        def confirmed(question: str) -> bool:
            progress.say(f"{question}; answer in the terminal")
            with signals.raised():
                return confirm(question)

        session = _BlockSession(rig, run, carriage, progress, taught_mm, confirmed)
        progress.begin(folder.name, len(run.done), len(info.presses))
        try:
            with signals.sent_to(carriage, progress.say), carriage.safely(progress.say):
                session.all()
        except RunInterruptedError as error:
            # Somebody who has pressed Ctrl-C once can wait.
            if error.signal == "SIGINT" and not error.gave_up:
                session.checks.stopped(signals)
            raise
        except Exception as error:
            if carriage.lifted:
                error.add_note("the sensor is lifted")
            session.checks.stopped(signals)
            raise
        finally:
            progress.end()
        return BlockResult(folder=folder, presses=session.presses, missed=session.missed)


@dataclass(eq=False)
class _BlockSession:
    """The work at one block, from the first move to the last.

    Args:
        rig: The devices.
        run: The open run.
        carriage: Moves the sensor.
        progress: Receives progress updates.
        taught_mm: See :func:`press_block`.
        confirm: See :func:`press_block`.
    """

    rig: OpenRig
    run: RunWriter
    carriage: Carriage
    progress: PressProgress
    taught_mm: Sequence[float]
    confirm: Callable[[str], bool]
    presses: int = 0
    missed: int = 0
    _in_a_row: int = 0
    _previous: Frame | None = None
    #: The rig time of the last reference.
    _reference_s: float = -math.inf

    def __post_init__(self) -> None:
        self.protocol, gauge, known_mm = self.run.info.plan.protocol, self.rig.gauge, self.rig.known_mm
        if known_mm is not None:
            # An ideal stage does not slip, and nobody changes block or light between two sessions.
            self.protocol = self.protocol.changed(home_every=0)
            if self.run.reference_time is not None:
                age = self.rig.clock.utc() - self.run.reference_time
                self._reference_s = self.rig.clock.now_s() - age.total_seconds()
        self.force = None
        if gauge is not None:
            felt = self.progress.felt
            self.force = ContactForce(gauge, self.carriage, self.protocol, self.rig.clock, felt)
        self.watch = HeightWatch(self.run.info)
        self.presser = Presser(
            self.protocol,
            self.carriage,
            self.force,
            self._touch(),
            nominal_mm=self.watch.first_touch_mm,
            known_mm=known_mm,
            touched=self._check_height,
        )
        self.checks = PositionChecks(
            self.run, self.protocol, self.carriage, self.presser, self.watch, self.rig, self.progress, self._lift
        )
        motion = motion_of(self.protocol.motion)
        self.record_motion = motion and motion.recorder(
            self.protocol.series_frames,
            carriage=self.carriage,
            force=self.force,
            sensor=self.rig.sensor,
            read=self._read,
            clock=self.rig.clock,
        )

    def all(self) -> None:
        """Do everything that is missing. The sensor may end in contact; the caller lifts it."""
        self.checks.set_unchecked_aside()
        self.watch.add(self.run.rows if self.protocol.checks.home_every else ())
        middle = self.run.info.middle_press
        self.carriage.over(middle.x_mm, middle.y_mm)
        if self.force is not None:
            self.force.tare()
        if self._reference_is_due:
            self._reference()
        self._stationary("start", middle)
        # This checks only the height. Presses at a wrong one are then missing again.
        self.checks.check("resumed", self.presses)
        try:
            for press in self.run.missing(self.run.info.presses):
                self.progress.before(press, self.carriage.check)
                if self._reference_is_due:
                    self.carriage.over(press.x_mm, press.y_mm)
                    self._reference()
                self._press(press)
                self.checks.if_due(press, self.presses)
        except (ContactError, ForceLimitError) as error:
            self.checks.after_contact(error)
            raise
        self.checks.check("end", self.presses)
        self.checks.repeat_first_press(self.presses)
        self._stationary("end", middle)

    def _press(self, press: Press) -> None:
        attempt = 1
        while True:
            contact = self.presser.press(press)
            time_utc, age_s, frame = self.rig.clock.utc(), self._reference_age_s, self._read()
            after = None if self.force is None else self.force.again()
            moving: list[MovingFrame] | str = self.record_motion() if self.record_motion else []
            # Nothing is written while the sensor presses, since a slow disk would let the dome creep.
            self._lift()
            if not isinstance(moving, str):
                break
            if attempt == MOTION_ATTEMPTS:
                raise RigError(moving)
            self.progress.say(f"press {press.number} is made again: {moving}")
            attempt += 1
        path = self.run.press(
            press,
            contact.pose_mm,
            frame,
            contact.measured,
            after,
            contact.in_band,
            time_utc,
            moving,
            age_s,
            contact.touch_mm,
        )
        self.presses += 1
        self.progress.pressed(len(self.run.done), contact.measured, contact.in_band, self.run.folder / path)
        self._count_misses(press, contact)

    def _check_height(self, above_mm: float) -> None:
        """Say that the block has another height than taught, and ask the person if the difference is large.

        Raises:
            RigError: Nobody has confirmed that the block is pressed.
        """
        if abs(above_mm) <= SAY_MM:
            return
        text = f"the block is {abs(above_mm):.1f} mm {'higher' if above_mm > 0.0 else 'lower'} than taught"
        if abs(above_mm) <= ASK_MM:
            self.progress.say(text)
            return
        self._lift()
        if not self.confirm(text):
            raise RigError(
                f"{text}, so it was not pressed; check that the right block lies flat in its holder, or align the rig "
                "again; to press it as it is, answer yes when the command asks"
            )

    def _lift(self) -> None:
        """Lift the sensor and check that it is free, before it moves sideways."""
        self.carriage.lift()
        if self.force is not None:
            self.force.require_free()

    def _count_misses(self, press: Press, contact: SettledPress) -> None:
        self._in_a_row = self._in_a_row + 1 if contact.in_band is False else 0
        self.missed += contact.in_band is False
        if self._in_a_row >= self.protocol.checks.misses_allowed:
            assert contact.measured is not None
            raise RigError(
                f"{self._in_a_row} presses in a row were outside the force band, the last with "
                f"{contact.measured.mean_n:.4f} N for {press.target_n:g} +- {press.band_n:g} N; widen bands_n, "
                "increase search_steps, or check the gauge's noise and the stage's resolution"
            )

    def _reference(self) -> None:
        """Record a frame of the free sensor. Every session begins with one, since block and light may have changed."""
        self.rig.clock.sleep(self.protocol.steps.settle_s)
        time_utc = self.rig.clock.utc()
        self._reference_s = self.rig.clock.now_s()
        self.run.reference(self._read(), time_utc)

    @property
    def _reference_age_s(self) -> float:
        """The age of the last reference in s of rig time. The computer's clock may be set back meanwhile."""
        return self.rig.clock.now_s() - self._reference_s

    @property
    def _reference_is_due(self) -> bool:
        return self._reference_age_s >= self.protocol.checks.reference_every_s

    def _stationary(self, when: Literal["start", "end"], middle: Press) -> None:
        """Record the missing frames without motion, in contact at the middle force and free."""
        count = self.protocol.checks.stationary_frames
        pressed = self.run.stationary_missing(when, True, count)
        if pressed:
            self.presser.press(middle)
            for index in pressed:
                self.run.stationary(when, True, index, self._read())
                if self.force is not None:
                    self.force.glance()
            self._lift()
        free = self.run.stationary_missing(when, False, count)
        if free:
            self.carriage.over(middle.x_mm, middle.y_mm)
            self.rig.clock.sleep(self.protocol.steps.settle_s)
            for index in free:
                self.run.stationary(when, False, index, self._read())

    def _read(self) -> Frame:
        """Read a frame. An image identical to the previous one shows that the sensor is stuck."""
        self.carriage.check()
        frame = self.rig.sensor.read()
        # Another thread may have lifted the sensor meanwhile.
        self.carriage.check()
        previous, self._previous = self._previous, frame
        if previous is not None and is_image(frame) and np.array_equal(previous, frame):
            raise RigError(
                "the sensor sent the same image twice, so it is stuck; open it again or unplug it and plug it in again"
            )
        return frame

    def _touch(self) -> Touch | None:
        if self.protocol.targets.contact == "force" or self.rig.known_mm is not None:
            return None
        if self.protocol.targets.touch == "taught":
            return taught(self.taught_mm, len(self.protocol.positions.grid.positions_mm))
        if self.protocol.targets.touch == "sensor":
            return by_sensor(self.carriage, self.protocol, self.rig.sensor, self.rig.clock)
        assert self.force is not None, "touch by gauge without a gauge is refused before any device is opened"
        return by_gauge(self.carriage, self.protocol, self.force)
