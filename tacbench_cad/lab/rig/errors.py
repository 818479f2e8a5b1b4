"""What can go wrong with a rig, by name. Each of these stops a run so that it can be resumed later."""

from __future__ import annotations

from tacbench_cad.util.errors import TacbenchError


class RigError(TacbenchError):
    """A device failed. The run stopped safely and can be resumed (exit code 3)."""

    exit_code = 3


class DeviceLostError(RigError):
    """The device is gone: unplugged, switched off, its port closed."""


class NoAnswerError(RigError):
    """The device is there and stays silent beyond its bound."""


class ProtocolError(RigError):
    """The device answered something that its protocol does not allow here, or is another device."""


class DriverError(RigError):
    """A user's own driver raised what is no error of a rig, or gave what is no position, force or frame."""


class AlarmError(RigError):
    """The stage's firmware raised an alarm (an end stop, a soft limit, a failed homing) or was halted."""


class PositionLostError(RigError):
    """The firmware was reset or reports an impossible position: where the sensor is, is unknown; home first."""


class NotThereError(RigError):
    """The stage reports that it ended up elsewhere than it was sent."""


class OutOfRangeError(RigError):
    """A target beyond the stage's limits. Nothing was sent."""


class ForceLimitError(RigError):
    """The contact force passed the hard limit; the sensor was lifted."""


class DepthLimitError(RigError):
    """The target would lie below the depth limit."""


class GaugeError(RigError):
    """The force gauge sends what cannot be a force: stuck, saturated, garbled."""


class SensorError(RigError):
    """The sensor sends what cannot be a frame: dark, blurred, frozen, of another shape."""


class NotReachedError(RigError):
    """The target force was missed too many times in a row."""
