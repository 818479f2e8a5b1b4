"""The motion in contact after a press: its settings, and what an extension provides for it.

An extension provides a motion by an entry point in the group ``tacbench.motions``. Its name is the key ``name`` of the
table ``[protocol.motion]``. It names a dataclass whose fields are the other keys, with the members of :class:`Motion`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

from annotated_types import Interval

from tacbench_cad.util.convert import Checked, from_plain
from tacbench_cad.util.entries import entries, load
from tacbench_cad.util.errors import MissingToolError

#: The largest number of frames of a series, which are kept in memory until the sensor is lifted.
MAX_FRAMES = 500


@dataclass(frozen=True, kw_only=True)
class MotionSettings(Checked):
    """The table ``[protocol.motion]``.

    Args:
        name: The name of the motion: ``slide``.
        frames: The number of frames of a series, at equal distances from the start of the motion to its end.
        options: The keys of the motion itself.
    """

    name: str
    frames: Annotated[int, Interval(ge=2, le=MAX_FRAMES)] = 10
    options: Mapping[str, Any] = field(default_factory=dict)


class Motion(Protocol):
    """A sideways motion of the sensor at constant height.

    Attributes:
        seconds: The duration.
    """

    @property
    def seconds(self) -> float:
        """See the attributes."""

    def shift_mm(self, fraction: float) -> tuple[float, float]:
        """Return x and y of the sensor relative to the start, after a fraction of the motion, from 0 to 1."""

    def recorder(self, frames: int, **devices: Any) -> Callable[[], Any]:
        """Return what makes the motion on a rig.

        Args:
            frames: The number of frames of a series.
            **devices: The ``carriage``, the gauge's contact ``force`` (None without a gauge), the ``sensor``, a
                function ``read`` that reads and checks a frame, and the ``clock`` of the rig.

        Returns:
            A function that moves the sensor in contact. It returns a list of
            :class:`~tacbench_cad.lab.runs.series.MovingFrame`, or the reason, as a text, why the press must be made
            again: the sensor was too slow. The press loop lifts the sensor afterwards.
        """


def motion_of(settings: MotionSettings | None) -> Motion | None:
    """Return the motion of a protocol; None without a motion.

    Raises:
        InputError: A key is unknown, or its value is not allowed.
        MissingToolError: No installed package has this motion.
    """
    if settings is None:
        return None
    motions = entries("tacbench.motions")
    if settings.name not in motions:
        raise MissingToolError(f'[protocol.motion] name = "{settings.name}" needs an extension that is not installed')
    motion: Motion = from_plain(load(motions[settings.name]), dict(settings.options), "[protocol.motion] ")
    return motion
