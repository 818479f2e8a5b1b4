"""Slipping motors: the heights of contact that are expected, and checks of the position between the presses.

A stage counts the steps that it sends to its motors, so it does not notice a motor that slips. Two things show it:

* The height of contact changes. Each press is compared with the height that the texture's formula gives, relative to
  the earlier presses with the same force, and its first contact with the first contact of the earlier press at the same
  position. This shows a slip of z at the next press. It does not show a slip of x or y: the dome is so large that the
  height changes by only about 0.01 mm if the sensor moves by 0.2 mm.
* The end stops are no longer where the stage expects them. A stage that can measure this shows a slip of any axis, but
  only when it is homed again. A stage that cannot is homed, and a press is repeated at the same force.

A suspicious height is no proof. It is the reason for a check, and only a check decides.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property

import numpy as np

from tacbench_cad.lab.acquire.press import Presser
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import Carriage, RunInterruptedError
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.devices import OpenRig
from tacbench_cad.lab.rig.errors import ContactError, ForceLimitError, PositionLostError
from tacbench_cad.lab.rig.stage import Stage, home_again, measures_offset
from tacbench_cad.lab.rig.switches import offset_text
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.schema import ASIDE_FOLDER, Reason, Row
from tacbench_cad.lab.simulate.contact import DomeContact
from tacbench_cad.lab.simulate.heights import HeightMap, cell_of, centres, held
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import HolderRim, Point, Protocol
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError, TacbenchError
from tacbench_cad.util.text import counted

#: A height is suspicious if it differs from the expected one by more than this multiple of the standard deviation of
#: the earlier differences (and by more than the protocol's ``slip_mm``).
DEVIATIONS = 5.0
#: The side of a cell of the nominal height map, in cells of a simulated block. Larger cells cost less time.
CELLS = 3
#: The number of earlier differences from which their standard deviation is estimated.
MIN_HEIGHTS = 5


class HeightWatch:
    """Compares the height of each press with the height that the formula of the texture gives.

    The sensor, the print and the origin differ from their nominal values. Only the difference between a press and the
    earlier presses with the same force is therefore judged.

    Args:
        info: The description of the run.
    """

    def __init__(self, info: RunInfo) -> None:
        self._plan = info.plan
        self._presses = info.press_by_number
        self._expected_mm: dict[tuple[int, int], float] = {}
        self._differences_mm: dict[int, list[float]] = {}

    def add(self, rows: Iterable[Row]) -> None:
        """Learn from presses that are in order."""
        for row in rows:
            press = self._presses[row.number]
            if row.pose_z is not None and row.in_band:
                self._differences_mm.setdefault(press.force_level, []).append(row.pose_z - self._expected(press))

    def forget(self) -> None:
        """Forget all heights, since they no longer apply: the block may have been moved."""
        self._differences_mm.clear()

    def is_suspicious(self, press: Press, z_mm: float) -> bool:
        """Return whether a press ended at an unexpected height."""
        earlier = self._differences_mm.get(press.force_level)
        if not earlier or press.target_n is None:
            return False
        allowed = self._plan.protocol.checks.slip_mm
        if len(earlier) >= MIN_HEIGHTS:
            allowed = max(allowed, DEVIATIONS * float(np.std(earlier)))
        return abs(z_mm - self._expected(press) - statistics.median(earlier)) > allowed

    def first_touch_mm(self, x_mm: float, y_mm: float) -> float:
        """Return the height of first touch over the nominal block, in mm of the work frame."""
        return self._nominal.first_touch(x_mm, y_mm)

    @cached_property
    def _nominal(self) -> DomeContact:
        return _nominal_contact(self._plan.printed.block, self._plan.holder)

    def _expected(self, press: Press) -> float:
        key = (press.force_level, press.position)
        if key not in self._expected_mm:
            try:
                height = self._nominal.z_for_force(press.x_mm, press.y_mm, press.target_n or 0.0)
            except InputError:
                # The force is beyond the model of the dome. The presses are then compared with each other only.
                height = 0.0
            self._expected_mm[key] = height
        return self._expected_mm[key]


def _nominal_contact(block: Block, holder: HolderRim) -> DomeContact:
    """Return the nominal dome over the formula of a block."""
    x, y = (axis[::CELLS] for axis in centres(block))
    heights = block.height_at(x[None, :], y[:, None])
    cell = CELLS * cell_of(block)
    top = HeightMap(z_mm=heights - heights.max(), x0_mm=float(x[0]), y0_mm=float(y[0]), cell_mm=cell)
    return DomeContact(held(block, top, holder))


@dataclass(frozen=True, kw_only=True)
class PositionError:
    """The result of a check of the position.

    Args:
        offset_mm: The true minus the reported position, measured at the end stops; None if the stage cannot do this.
        height_change_mm: The height of a repeated press minus its first height; None if it could not be repeated.
        touched: Whether the sensor met the block too early when the press was repeated.
    """

    offset_mm: Point | None
    height_change_mm: float | None
    touched: bool = False

    @property
    def is_known(self) -> bool:
        """Whether the check says anything about the position."""
        return self.touched or self.offset_mm is not None or self.height_change_mm is not None

    def exceeds(self, allowed_mm: float) -> bool:
        """Return whether one of the errors is above a limit, in mm."""
        errors = [*(self.offset_mm or ()), self.height_change_mm or 0.0]
        return self.touched or any(abs(error) > allowed_mm for error in errors)

    def __str__(self) -> str:
        parts = []
        if self.offset_mm is not None:
            x, y, z = map(offset_text, self.offset_mm)
            parts.append(f"at the end stops, x, y and z are off by {x}, {y} and {z} mm")
        if self.touched:
            parts.append("the sensor touched something too early")
        elif self.height_change_mm is not None:
            parts.append(f"a repeated press ended {self.height_change_mm:+z.2f} mm from its first height")
        return "; ".join(parts)


def require_repeatable_homing(stage: Stage, allowed_mm: float) -> None:
    """Home a stage that was just homed once more, and compare the two homings, if the stage can do so.

    An end stop that closes too early, even for an instant, ends homing at a wrong place. The first moves of a run go
    there without any force being read.

    Args:
        stage: The stage.
        allowed_mm: The largest allowed difference on each axis.

    Raises:
        PositionLostError: The two homings differ.
        RigError: The stage failed.
    """
    offset = home_again(stage) if measures_offset(stage) else None
    if offset is not None and any(abs(error) > allowed_mm for error in offset):
        x, y, z = map(offset_text, offset)
        raise PositionLostError(
            f"two homings differ by {x}, {y} and {z} mm in x, y and z: an end stop has closed too early "
            "or a motor has slipped; check the end stops and their cables, then run the command again"
        )


def position_error(
    carriage: Carriage, presser: Presser, unchecked: Sequence[Row], plan: dict[int, Press]
) -> PositionError:
    """Home the stage if that is allowed. Unless that shows an error, repeat a press that no check has followed yet.

    After homing, the last of these presses is repeated: it was made with the error that homing has removed. Without
    homing, the first one is repeated: it was made before the error. In depth mode, the first touch of the first one is
    found again before homing: it was found before the error.

    Args:
        carriage: The lifted sensor.
        presser: Repeats the press.
        unchecked: The rows of the presses.
        plan: The presses of the run by their numbers.

    Raises:
        RigError: A device failed.
    """
    first = plan[unchecked[0].number]
    touch_change = presser.touch_change_mm(first) if first.depth_mm is not None else None
    if touch_change is not None:
        carriage.lift()
    offset = carriage.home_again() if carriage.may_home else None
    error = PositionError(offset_mm=offset, height_change_mm=touch_change)
    if error.exceeds(presser.protocol.checks.slip_mm):
        # Nothing else may fail before this is stored.
        return error
    row = next((row for row in (reversed(unchecked) if carriage.may_home else unchecked) if row.in_band), None)
    if row is None:
        return error
    try:
        return replace(error, height_change_mm=height_change(presser, plan[row.number], row))
    except ContactError:
        return replace(error, touched=True)


def height_change(presser: Presser, press: Press, row: Row) -> float | None:
    """Repeat a press, and return its height minus the height in its row, in mm; None if its force was not reached.

    In depth mode the height is given, so the change of the first touch is returned.

    Raises:
        ContactError: The sensor touches the block above the expected height.
        RigError: A device failed.
    """
    if press.depth_mm is not None:
        return presser.touch_change_mm(press)
    contact = presser.press(press)
    return contact.pose_mm[2] - row.pose_z if contact.in_band and row.pose_z is not None else None


@dataclass(eq=False)
class PositionChecks:
    """The checks of the position in one session at a block.

    Args:
        run: The open run.
        protocol: The protocol.
        carriage: Moves the sensor.
        presser: Repeats presses.
        watch: Compares the heights of the presses.
        rig: The devices.
        progress: Receives progress updates.
        lift: Lifts the sensor and checks that it is free.
    """

    run: RunWriter
    protocol: Protocol
    carriage: Carriage
    presser: Presser
    watch: HeightWatch
    rig: OpenRig
    progress: PressProgress
    lift: Callable[[], None]
    _checked: bool = False
    #: The number of presses in this session at the last check.
    _checked_at: int = 0

    def __post_init__(self) -> None:
        self._plan = self.run.info.press_by_number

    def if_due(self, press: Press, presses: int) -> None:
        """Check the position after a press, if that is due.

        Args:
            press: The press.
            presses: The number of presses of this session.

        Raises:
            PositionLostError: The position was wrong.
        """
        if not self.protocol.checks.home_every:
            return
        row = self.run.rows[-1]
        unexpected = row.pose_z is not None and row.in_band and self.watch.is_suspicious(press, row.pose_z)
        if unexpected or self.presser.has_moved:
            self.check("height", presses)
            # The position is right, so the block has moved or is not what the formula says.
            self.watch.forget()
        elif not self._checked:
            self.check("start", presses)
        elif min(len(self.run.unchecked), presses - self._checked_at) >= self.protocol.checks.home_every:
            self.check("interval", presses)
        self.watch.add([row])

    def check(self, reason: Reason, presses: int) -> None:
        """Check the position of the presses that no check has followed yet.

        Args:
            reason: Why.
            presses: The number of presses of this session.

        Raises:
            PositionLostError: The position was wrong. These presses were set aside.
        """
        unchecked = self.run.unchecked
        if not unchecked or not self.protocol.checks.home_every:
            return
        time_utc = self.rig.clock.utc()
        error = position_error(self.carriage, self.presser, unchecked, self._plan)
        self.lift()
        self._checked, self._checked_at = reason != "resumed", presses
        if not error.is_known:
            return
        wrong = error.exceeds(self.protocol.checks.slip_mm)
        aside = self._store_check(reason, error.offset_mm, error.height_change_mm, not wrong, time_utc)
        if wrong and reason == "resumed":
            self.progress.say(self._aside_text(error, aside))
        elif wrong:
            raise PositionLostError(
                f"a motor has slipped, or homing is not repeatable: {self._aside_text(error, aside)}; find the cause, "
                "then run the command again to make these presses again"
            )

    def set_unchecked_aside(self) -> None:
        """Set aside the presses that an earlier session left unchecked, if the stage measures errors of x and y.

        The stage was homed since, which has removed an error that these presses may have. A stage that measures only
        the height repeats one of them instead.
        """
        if not (self.run.unchecked and self.protocol.checks.home_every and self.carriage.may_home):
            return
        time_utc = self.rig.clock.utc()
        if self.carriage.home_again() is not None:
            aside = self._store_check("resumed", None, None, False, time_utc)
            self.progress.say(
                f"the last session ended without a check of its position: {self._aside_count(aside)}, and made again"
            )

    def stopped(self, signals: Signals) -> None:
        """Check the position at the end of a session that was stopped, so that its presses need not be made again.

        Nothing is checked if the stage has failed or was homed since the last press, or if it cannot measure the error
        at its end stops. A signal skips the check.
        """
        presses, carriage = len(self.run.unchecked), self.carriage
        if not (presses and self.protocol.checks.home_every and carriage.may_home and carriage.lifted):
            return
        if not (carriage.position_kept and measures_offset(self.rig.stage)):
            return
        self.progress.say(f"checking the position of {counted(presses, 'press')}; Ctrl-C skips this")
        time_utc = self.rig.clock.utc()
        try:
            with signals.sent_to(carriage, self.progress.say):
                error = PositionError(offset_mm=carriage.home_again(), height_change_mm=None)
            if error.is_known:
                wrong = error.exceeds(self.protocol.checks.slip_mm)
                aside = self._store_check("stopped", error.offset_mm, None, not wrong, time_utc)
                if wrong:
                    self.progress.say(f"a motor has slipped: {self._aside_text(error, aside)}")
        except RunInterruptedError:
            self.progress.say("the position was not checked")
        except TacbenchError as problem:
            self.progress.say(f"the position was not checked: {problem}")

    def after_contact(self, contact: ContactError | ForceLimitError) -> None:
        """Check the position at the end stops after the sensor met something unexpectedly.

        If the stage cannot measure it, the position counts as wrong after a force where the sensor should be free.
        After a force above the hard limit, which can have other causes, the presses stay unchecked.

        Raises:
            PositionLostError: The position was wrong.
        """
        if not (self.run.unchecked and self.protocol.checks.home_every and self.carriage.may_home):
            return
        self.carriage.lift()
        time_utc = self.rig.clock.utc()
        error = PositionError(offset_mm=self.carriage.home_again(), height_change_mm=None)
        if error.offset_mm is None and isinstance(contact, ForceLimitError):
            return
        wrong = error.offset_mm is None or error.exceeds(self.protocol.checks.slip_mm)
        aside = self._store_check("contact", error.offset_mm, None, not wrong, time_utc)
        if wrong:
            raise PositionLostError(f"{contact}; {self._aside_text(error, aside)}") from contact

    def _store_check(
        self, reason: Reason, offset_mm: Point | None, height_mm: float | None, ok: bool, time_utc: datetime
    ) -> int:
        """Store a check of all presses that no check has followed, and return the number of those set aside."""
        aside = self.run.position_check(reason, offset_mm, height_mm, ok, time_utc)
        self.carriage.position_kept = True
        return aside

    def _aside_text(self, error: PositionError, aside: int) -> str:
        return "; ".join([str(error)] * error.is_known + [self._aside_count(aside)])

    def _aside_count(self, aside: int) -> str:
        text = f"{counted(aside, 'press')} since the last good check {'were' if aside > 1 else 'was'} set aside"
        return f"{text} in {self.run.folder.name}/{ASIDE_FOLDER}"

    def repeat_first_press(self, presses: int) -> None:
        """Repeat the first press of the run at its end, since a sensor, a block or a gauge may change slowly."""
        rows = self.run.rows
        if not (self.protocol.checks.home_every and presses and rows[0].in_band is not False):
            return
        time_utc = self.rig.clock.utc()
        change = height_change(self.presser, self._plan[rows[0].number], rows[0])
        self.lift()
        if change is not None:
            self.run.position_check("first", None, change, abs(change) <= self.protocol.checks.slip_mm, time_utc)
