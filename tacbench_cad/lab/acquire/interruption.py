"""The error of a run that a signal ended, and messages that must not disturb a rescue."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from tacbench_cad.util.text import counted


class RunInterruptedError(KeyboardInterrupt):
    """A signal ended a run, which can be resumed.

    Attributes:
        signal: ``SIGINT``, ``SIGTERM`` or ``SIGHUP``.
        lifted: Whether the sensor is lifted off the block; None if this is unknown, because no block was pressed yet.
        gave_up: The call of a device that did not return and was given up; empty if there is none.
        saved: The number of saved presses of the study.
        planned: The number of presses of the study.
    """

    def __init__(self, signal: str) -> None:
        super().__init__(signal)
        self.signal, self.gave_up = signal, ""
        self.lifted: bool | None = True
        self.saved = self.planned = 0

    def __str__(self) -> str:
        saved = f"{self.saved} of {counted(self.planned, 'press')} are saved"
        if self.gave_up:
            saved += f"; gave up {self.gave_up}, which did not return"
        if getattr(self, "__notes__", ()):
            # The note says what became of the stage, whose homing was interrupted.
            return saved
        if self.lifted is None:
            return f"{saved}; look whether the sensor is lifted" if self.gave_up else saved
        sensor = "the sensor is lifted" if self.lifted else "the sensor was NOT lifted: lift it by hand"
        return f"{sensor}; {saved}"


def undisturbed(say: Callable[[str], None]) -> Callable[[str], None]:
    """Return a function that passes a message on. An error of the receiver must not prevent the lift."""

    def tell(message: str) -> None:
        with contextlib.suppress(Exception):
            say(message)

    return tell
