"""A load cell behind an amplifier that sends a line a sample, and the force that it feels under the carriage."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

from tacbench_cad.lab.study.spec import HolderRim, Point, WorkFrame
from tacbench_cad.util.convert import Bounds, check_fields, from_plain
from tacbench_cad.util.errors import InputError, located
from tacbench_cad.virtual_rig.faults import BYTE_KINDS, Fault, Spoiler

if TYPE_CHECKING:
    from tacbench_cad.lab.simulate.contact import DomeContact

#: The amplifier's converter: 24 bits, signed.
FULL_SCALE = 2**23 - 1
#: A stream that nobody took for long starts again here, so that the catching up is bounded.
_BACKLOG_S = 1.0


@dataclass(frozen=True, kw_only=True)
class CellSettings:
    """What the load cell is like.

    Args:
        rate_hz: Samples a second of rig time.
        counts_per_n: Scale; positive in compression.
        offset_counts: What it reads without load.
        noise_n: Standard deviation of a sample, in newtons.
        drift_n_per_min: Creep of the zero, in newtons a minute of rig time.
        newtons: Send newtons with four decimals instead of counts.
    """

    rate_hz: Annotated[float, Bounds(0.001, 10_000.0)] = 80.0
    counts_per_n: float = 42_000.0
    offset_counts: float = 84_213.0
    noise_n: Annotated[float, Bounds(0.0)] = 0.0008
    drift_n_per_min: float = 0.0001
    newtons: bool | Annotated[int, Bounds(0, 1)] = False

    def __post_init__(self) -> None:
        with located("gauge "):
            check_fields(self)
        if self.counts_per_n == 0.0:
            raise InputError("gauge counts_per_n", self.counts_per_n, "must not be 0")


class LoadCell:
    """Samples in time; no bytes go in.

    Args:
        settings: What it is like.
        seed: Of noise and faults.
        start_s: Rig time of the first sample.

    Attributes:
        next_s: When the next sample is due.
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
        """Nobody listens: the samples until now are not made."""
        self.next_s = max(self.next_s, now_s)

    def inject(self, fault: Fault, now_s: float) -> None:
        """Begin a fault."""
        if fault.kind in BYTE_KINDS:
            self._spoiler.add(fault, now_s)
            return
        until = math.inf if fault.seconds is None else now_s + fault.seconds
        self._faults.append((until, fault))

    def read(self, now_s: float, force: Callable[[], float]) -> bytes:
        """The samples that are due.

        Args:
            now_s: Rig time.
            force: Gives the force on the cell now, in N; called only if a sample is due. Between two calls the force
                is taken to change evenly.

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
    """An endless flat spring.

    Args:
        flat_z_mm: Height of its top in the stage's frame.
        n_per_mm: Stiffness.
    """

    flat_z_mm: float
    n_per_mm: float

    def force_n(self, point_mm: Point) -> float:
        """Contact force with the carriage truly at a point of the stage's frame."""
        return max(0.0, self.flat_z_mm - point_mm[2]) * self.n_per_mm


@dataclass(frozen=True, kw_only=True)
class BlockUnderDome:
    """A printed block in its holder under the simulated sensor.

    Args:
        printed: The block, as ``run.json`` has it.
        holder: What surrounds it.
        frame: Where it lies.
    """

    printed: Mapping[str, Any]
    holder: HolderRim
    frame: WorkFrame

    @cached_property
    def _contact(self) -> DomeContact:
        from tacbench_cad.lab.runs.info import printed_block_from
        from tacbench_cad.lab.simulate.contact import contact_for

        return contact_for(printed_block_from(self.printed), self.holder)

    def force_n(self, point_mm: Point) -> float:
        """See :class:`FlatSpring`. Above all that stands there, nothing is worked out."""
        x, y, z = self.frame.to_work(point_mm)
        return self._contact.force_n(x, y, z) if z < self._contact.ground.top_mm else 0.0


#: What the carriage presses.
Stimulus = FlatSpring | BlockUnderDome


def stimulus_from(values: Mapping[str, Any]) -> Stimulus:
    """The stimulus that plain values describe.

    Args:
        values: ``{"flat_z_mm", "n_per_mm"}`` or ``{"printed", "holder", "frame"}``.

    Raises:
        InputError: They describe neither.
    """
    kinds: tuple[type[FlatSpring] | type[BlockUnderDome], ...] = (FlatSpring, BlockUnderDome)
    for kind in kinds:
        if fields(kind)[0].name in values:
            return from_plain(kind, values, "stimulus ")
    raise InputError("stimulus", sorted(values), "give flat_z_mm and n_per_mm, or printed, holder and frame")


class ForceAtCarriage:
    """The force under the carriage, worked out again only where the carriage has moved.

    Args:
        position: Gives the carriage's true position in mm.
        stimulus: What it presses; None for air.
    """

    def __init__(self, position: Callable[[], Point], stimulus: Stimulus | None) -> None:
        self._position = position
        self._known: tuple[Point, float] | None = None
        self._stimulus = stimulus

    def put(self, stimulus: Stimulus | None) -> None:
        """Change what lies under the carriage."""
        self._stimulus, self._known = stimulus, None

    def __call__(self) -> float:
        """The force in N now."""
        here = self._position()
        if self._stimulus is None:
            return 0.0
        if self._known is None or self._known[0] != here:
            self._known = (here, self._stimulus.force_n(here))
        return self._known[1]
