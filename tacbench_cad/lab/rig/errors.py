"""The errors of a rig. Each of them stops a run, which can be resumed later."""

from __future__ import annotations

from tacbench_cad.util.errors import TacbenchError


class RigError(TacbenchError):
    """A device failed, or a force or height was not the expected one. The run stopped safely (exit code 3)."""

    exit_code = 3


class DeviceLostError(RigError):
    """The device is gone: it was unplugged or switched off, or its port was closed."""


class NoAnswerError(RigError):
    """The device did not answer in time."""


class AlarmError(RigError):
    """The stage's firmware raised an alarm (an end stop, a soft limit, a failed homing) or was halted."""


class PositionLostError(RigError):
    """The position is unknown or was wrong: a reset of the firmware, or a motor that has slipped. Home the stage."""


class OutOfRangeError(RigError):
    """The target is beyond the stage's limits or below the depth limit. No command was sent."""


class ForceLimitError(RigError):
    """The contact force exceeded the hard limit. The sensor was lifted."""


class ContactError(RigError):
    """A force where the sensor should be free: it touches something, a motor has slipped, or the gauge is faulty."""
