"""A load cell with an amplifier that sends one line per sample, and the force on it under the carriage."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Interval

from tacbench_cad.extensions.virtual_rig.faults import BYTE_KINDS, Fault, Spoiler
from tacbench_cad.lab.study import HolderRim, Point, PrintedBlock, WorkFrame
from tacbench_cad.util.convert import check_fields
from tacbench_cad.util.errors import InputError, located

if TYPE_CHECKING:
    from tacbench_cad.lab.simulate import DomeContact

#: The largest count of the amplifier's converter, which has 24 bits with sign.
FULL_SCALE = 2**23 - 1
#: The longest time, in s, for which samples are generated afterwards if nobody has read the stream.
_BACKLOG_S = 1.0


@dataclass(frozen=True, kw_only=True)
class CellSettings:
    """The properties of the load cell.

    Args:
        rate_hz: Samples per second of rig time.
        counts_per_n: The scale; positive in compression.
        offset_counts: The counts without load.
        noise_n: The standard deviation of a sample, in N.
        drift_n_per_min: The drift of the zero, in N per minute of rig time.
        newtons: Whether it sends newtons with four decimals instead of counts.
    """

    rate_hz: Annotated[float, Interval(ge=0.001, le=10_000.0)] = 80.0
    counts_per_n: float = 42_000.0
    offset_counts: float = 84_213.0
    noise_n: Annotated[float, Ge(0.0)] = 0.0008
    drift_n_per_min: float = 0.0001
    newtons: bool | Annotated[int, Interval(ge=0, le=1)] = False

    def __post_init__(self) -> None:
        with located("gauge "):
            check_fields(self)
        if self.counts_per_n == 0.0:
            raise InputError("gauge counts_per_n", self.counts_per_n, "must not be 0")


class EmulatedLoadCell:
    """The stream of samples. The load cell receives no bytes.

    Args:
        settings: The properties of the load cell.
        seed: The seed for noise and faults.
        start_s: The rig time of the first sample.

    Attributes:
        next_s: The time of the next sample.
    """

    def __init__(self, settings: CellSettings | None = None, *, seed: int = 0, start_s: float = 0.0) -> None:
        self.settings = settings or CellSettings()
        self._random = random.Random(seed)
        self._spoiler = Spoiler(self._random)
        self.next_s = start_s
        self._last_force_n = 0.0
        self._faults: list[tuple[float, Fault]] = []
        self._stuck_at: int | None = None
        self._counts = 0

    def skip_to(self, now_s: float) -> None:
        """Skip the samples until now, since nobody reads them."""
        self.next_s = max(self.next_s, now_s)

    def inject(self, fault: Fault, now_s: float) -> None:
        """Begin a fault."""
        if fault.kind in BYTE_KINDS:
            self._spoiler.add(fault, now_s)
            return
        until = math.inf if fault.seconds is None else now_s + fault.seconds
        self._faults.append((until, fault))

    def read(self, now_s: float, force: Callable[[], float]) -> bytes:
        """Return the samples that are due.

        Args:
            now_s: The rig time.
            force: Returns the present force on the cell in N. It is called only if a sample is due. Between two calls
                the force is assumed to change linearly.

        Returns:
            Lines that end in a line feed.
        """
        if now_s < self.next_s:
            return b""
        if now_s - self.next_s > _BACKLOG_S:
            self.next_s = now_s
        before_n, after_n = self._last_force_n, force()
        self._last_force_n = after_n
        period = 1.0 / self.settings.rate_hz
        due = int((now_s - self.next_s) / period) + 1
        lines = []
        for i in range(due):
            when = self.next_s + i * period
            part = (i + 1) / due
            lines.append(self._sample(before_n + (after_n - before_n) * part, when))
        self.next_s += due * period
        return self._spoiler.spoil("".join(lines).encode(), "out", now_s)

    def _sample(self, force_n: float, when_s: float) -> str:
        own = self.settings
        self._faults = [active for active in self._faults if when_s < active[0]]
        kinds = {fault.kind: fault for _, fault in self._faults}
        if "stuck" not in kinds:
            shown = force_n + self._random.gauss(0.0, own.noise_n) + own.drift_n_per_min * when_s / 60.0
            if "noise" in kinds:
                shown += self._random.gauss(0.0, kinds["noise"].n)
            counts = own.offset_counts + own.counts_per_n * shown
            if "saturated" in kinds:
                counts = math.copysign(FULL_SCALE, own.counts_per_n)
            self._counts = round(min(FULL_SCALE, max(-FULL_SCALE - 1, counts)))
        if own.newtons:
            return f"{(self._counts - own.offset_counts) / own.counts_per_n:.4f}\n"
        return f"{self._counts}\n"


@dataclass(frozen=True, kw_only=True)
class FlatSpring:
    """An infinite flat spring.

    Args:
        flat_z_mm: The height of its top in the stage's frame, in mm.
        n_per_mm: The stiffness in N/mm.
    """

    flat_z_mm: float
    n_per_mm: float

    def force_n(self, point_mm: Point) -> float:
        """Return the contact force with the carriage's true position at a point of the stage's frame, in N."""
        return max(0.0, self.flat_z_mm - point_mm[2]) * self.n_per_mm


@dataclass(frozen=True, kw_only=True)
class BlockUnderDome:
    """A printed block in its holder under the simulated sensor.

    Args:
        printed: The block.
        holder: The rim of the holder.
        frame: The work frame of the block.
    """

    printed: PrintedBlock
    holder: HolderRim
    frame: WorkFrame

    @cached_property
    def _contact(self) -> DomeContact:
        from tacbench_cad.lab.simulate import contact_for

        return contact_for(self.printed, self.holder)

    def force_n(self, point_mm: Point) -> float:
        """See :class:`FlatSpring`. Above the highest point, nothing is computed."""
        x, y, z = self.frame.to_work(point_mm)
        return self._contact.force_n(x, y, z) if z < self._contact.ground.top_mm else 0.0


#: The object under the carriage.
Stimulus = FlatSpring | BlockUnderDome
