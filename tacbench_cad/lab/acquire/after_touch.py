"""What happens after the frame of a press, while the sensor is still in contact: nothing, or a motion of an extension.

An extension provides a motion by an entry point in the group ``tacbench.motions``. Its name is the value of ``motion``
in the table ``[protocol]``. It names a class or a function that is called with the protocol, the carriage, the gauge's
contact force (None without a gauge), the sensor, a function that reads and checks a frame, and the clock of the rig.
The object that it returns has a method ``after_touch(press)``. This method moves the sensor in contact and returns the
recorded frames, a list of :class:`~tacbench_cad.lab.runs.series.MovingFrame`. The press loop lifts the sensor
afterwards.
"""

from __future__ import annotations

from typing import Any

from tacbench_cad.lab.study.spec import Protocol
from tacbench_cad.util.entries import entries, load
from tacbench_cad.util.errors import MissingToolError


def motion_of(protocol: Protocol) -> Any:
    """Return what makes the motion of a protocol; None without a motion.

    Raises:
        MissingToolError: No installed package has this motion.
    """
    if protocol.motion == "none":
        return None
    motions = entries("tacbench.motions")
    if protocol.motion not in motions:
        raise MissingToolError(f'[protocol] motion = "{protocol.motion}" needs an extension that is not installed')
    return load(motions[protocol.motion])
