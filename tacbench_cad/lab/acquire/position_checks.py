"""Checks of the position between the presses of a block: when they are due, and what becomes of wrong presses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from tacbench_cad.lab.acquire.press import Presser
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import Carriage, RunInterruptedError
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.acquire.slips import HeightWatch, PositionError, height_change, position_error
from tacbench_cad.lab.rig.errors import ContactError, ForceLimitError, PositionLostError
from tacbench_cad.lab.rig.stage import Stage, measures_offset
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.schema import ASIDE_FOLDER, Reason
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import TacbenchError
from tacbench_cad.util.text import counted


@dataclass(eq=False)
class PositionChecks:
    """The checks of the position in one session at a block.

    Args:
        run: The open run.
        carriage: Moves the sensor.
        presser: Repeats presses.
        watch: Compares the heights of the presses.
        stage: The stage.
        progress: Receives progress updates.
        lift: Lifts the sensor and checks that it is free.
    """

    run: RunWriter
    carriage: Carriage
    presser: Presser
    watch: HeightWatch
    stage: Stage
    progress: PressProgress
    lift: Callable[[], None]
    _checked: bool = False
    #: The number of presses in this session at the last check.
    _checked_at: int = 0

    def __post_init__(self) -> None:
        self.protocol, self._plan = self.run.info.plan.protocol, self.run.info.press_by_number

    def if_due(self, press: Press, presses: int) -> None:
        """Check the position after a press, if that is due.

        Args:
            press: The press.
            presses: The number of presses of this session.

        Raises:
            PositionLostError: The position was wrong.
        """
        if not self.protocol.home_every:
            return
        row = self.run.rows[-1]
        unexpected = row.pose_z is not None and row.in_band and self.watch.is_suspicious(press, row.pose_z)
        if unexpected or self.presser.has_moved:
            self.check("height", presses)
            # The position is right, so the block has moved or is not what the formula says.
            self.watch.forget()
        elif not self._checked:
            self.check("start", presses)
        elif min(len(self.run.unchecked), presses - self._checked_at) >= self.protocol.home_every:
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
        if not unchecked or not self.protocol.home_every:
            return
        time_utc = datetime.now(UTC)
        error = position_error(self.carriage, self.presser, unchecked, self._plan)
        self.lift()
        self._checked, self._checked_at = reason != "resumed", presses
        if not error.is_known:
            return
        wrong = error.exceeds(self.protocol.slip_mm)
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
        if not (self.run.unchecked and self.protocol.home_every and self.carriage.may_home):
            return
        time_utc = datetime.now(UTC)
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
        if not (presses and self.protocol.home_every and carriage.may_home and carriage.lifted):
            return
        if not (carriage.position_kept and measures_offset(self.stage)):
            return
        self.progress.say(f"checking the position of {counted(presses, 'press')}; Ctrl-C skips this")
        time_utc = datetime.now(UTC)
        try:
            with signals.sent_to(carriage, self.progress.say):
                error = PositionError(offset_mm=carriage.home_again(), height_change_mm=None)
            if error.is_known:
                wrong = error.exceeds(self.protocol.slip_mm)
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
        if not (self.run.unchecked and self.protocol.home_every and self.carriage.may_home):
            return
        self.carriage.lift()
        time_utc = datetime.now(UTC)
        error = PositionError(offset_mm=self.carriage.home_again(), height_change_mm=None)
        if error.offset_mm is None and isinstance(contact, ForceLimitError):
            return
        wrong = error.offset_mm is None or error.exceeds(self.protocol.slip_mm)
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
        if not (self.protocol.home_every and presses and rows[0].in_band is not False):
            return
        time_utc = datetime.now(UTC)
        change = height_change(self.presser, self._plan[rows[0].number], rows[0])
        self.lift()
        if change is not None:
            self.run.position_check("first", None, change, abs(change) <= self.protocol.slip_mm, time_utc)
