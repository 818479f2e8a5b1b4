"""The errors of a rig. Each of them stops a run, which can be resumed later."""

from __future__ import annotations

from tacbench_cad.util.errors import TacbenchError


class RigError(TacbenchError):
    """A device failed. The run stopped safely and can be resumed (exit code 3)."""

    exit_code = 3


class DeviceLostError(RigError):
    """The device is gone: it was unplugged or switched off, or its port was closed."""


class NoAnswerError(RigError):
    """The device did not answer in time."""


class ProtocolError(RigError):
    """The device sent an answer that its protocol does not allow here, or it is another device."""


class DriverError(RigError):
    """A user's own driver raised another error than a rig error, or returned an invalid position, force or frame."""


class AlarmError(RigError):
    """The stage's firmware raised an alarm (an end stop, a soft limit, a failed homing) or was halted."""


class PositionLostError(RigError):
    """The firmware was reset or reports an impossible position. The position is unknown until the stage is homed."""


class NotThereError(RigError):
    """The stage reports another position than the target of the move."""


class OutOfRangeError(RigError):
    """The target is beyond the stage's limits. No command was sent."""


class ForceLimitError(RigError):
    """The contact force exceeded the hard limit. The sensor was lifted."""


class ContactError(RigError):
    """A force where the sensor should be free: it touches something, a motor has slipped, or the gauge is faulty."""


class SlipError(RigError):
    """The position was wrong: a motor has slipped, or homing is not repeatable."""


class DepthLimitError(RigError):
    """The target is below the depth limit."""


class HeightError(RigError):
    """The block has another height than taught, and nobody has confirmed it. Nothing was pressed."""


class GaugeError(RigError):
    """The force gauge sends invalid samples: stuck, saturated or garbled."""


class SensorError(RigError):
    """The sensor sends invalid frames: dark, blurred, frozen or of another shape."""


class NotReachedError(RigError):
    """The target force was missed too many times in a row."""
