"""What a data run is made of, as values: the printed block, the protocol, the holder and the devices of the rig.

Everything in the lab reads these; nothing here touches a file or a device. Millimetres, newtons, seconds.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.fits import FITS
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, REPEATS, PressGrid
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.convert import Bounds, Checked, Length, check_fields
from tacbench_cad.util.errors import InputError, one_of

ContactMode = Literal["force", "depth"]
TouchMethod = Literal["gauge", "sensor", "taught"]
Order = Literal["paper", "random"]
Point = tuple[float, float, float]
QuarterTurns = Annotated[int, Bounds(0, 3)]
Baud = Annotated[int, Bounds(300, 10_000_000)]
Copy = Annotated[int, Bounds(1, 999)]
#: Forces or depths.
Levels = Annotated[tuple[float, ...], Length(1, 1000)]


def plus(a: Point, b: Point) -> Point:
    """The sum of two points, axis by axis."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Point, b: Point) -> Point:
    """The difference of two points, axis by axis."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


#: The contact force that ends any run, in newtons.
HARD_LIMIT_N = 5.0
#: Most presses of a block: a year of work.
MAX_PRESSES = 1_000_000
#: Depths below first touch for a rig without a gauge: what the three forces sink the simulated dome into a flat
#: plate, rounded; a rig's own calibration is better.
DEPTHS_MM = (0.35, 1.7, 2.2)


#: What stands in tables for a printer, a filament or a label that nobody named.
UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True)
class Pressed(Checked):
    """What was pressed: one of our own :class:`PrintedBlock`, or a :class:`Specimen` of which less may be known."""

    block: Block | None
    printer: str | None
    filament: str | None
    copy: int | str | None

    @property
    def texture(self) -> str | None:
        """Name of its texture, the label that classifiers learn: ``texture-4``."""
        raise NotImplementedError

    @property
    def object_label(self) -> int | str | None:
        """The label for TacTip toolchains: 1 to 6, or the name of another texture."""
        raise NotImplementedError

    @property
    def name(self) -> str:
        """Name of its run folder."""
        raise NotImplementedError

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``run.json``; :mod:`tacbench_cad.lab.runs` makes the object again from them."""
        raise NotImplementedError

    @property
    def combination(self) -> str:
        """Printer and filament in one word: ``bambu-p1p_pla-minus``."""
        return f"{self.printer or UNKNOWN}_{self.filament or UNKNOWN}"


@dataclass(frozen=True, kw_only=True)
class PrintedBlock(Pressed):
    """One printed block: what it is and where it came from.

    Args:
        block: Its geometry.
        printer: Printer, in the spelling of :mod:`tacbench_cad.lab.study.names`.
        filament: Filament, likewise.
        copy: Number of this copy, from 1.
    """

    block: Block
    printer: str
    filament: str
    copy: Copy = 1

    @property
    def texture(self) -> str:
        """Name of its texture: ``texture-4``."""
        return self.block.texture.name

    @property
    def object_label(self) -> int | str:
        """The label that classifiers learn: 1 to 6, or the name of a user's own texture."""
        return self.block.texture.number or self.texture

    @property
    def name(self) -> str:
        """Name of its run folder: ``texture-4_paper_x1_bambu-p1p_pla-minus_copy01``."""
        stem = self.block.name.split("_copy")[0]
        return f"{stem}_{self.combination}_copy{self.copy:02d}"

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``run.json``; :mod:`tacbench_cad.lab.runs` makes the block again from them."""
        origin = {"printer": self.printer, "filament": self.filament, "copy": self.copy}
        return {**block_values(self.block), **origin}


@dataclass(frozen=True, kw_only=True)
class Specimen(Pressed):
    """What was pressed as far as anybody said it; None where nobody did.

    Args:
        label: What classifiers learn.
        printer: Printer.
        filament: Filament.
        copy: Number of the print, or what it is called.
        session: What the recording is called, where one print was recorded more than once.
        block: Its geometry.
    """

    label: str | None = None
    printer: str | None = None
    filament: str | None = None
    copy: int | str | None = None
    session: str | None = None
    block: Block | None = None

    @property
    def texture(self) -> str | None:
        """The label."""
        return self.label

    @property
    def object_label(self) -> int | str | None:
        """The label for TacTip toolchains; a number of up to three digits is a number."""
        number = self.block.texture.number if self.block else None
        return number or (int(self.label) if self.label and re.fullmatch(r"[1-9]\d{0,2}", self.label) else self.label)

    @property
    def name(self) -> str:
        """What is known, fit for a file name; a hash is added where that changes a word."""
        copy = f"copy{self.copy:02d}" if isinstance(self.copy, int) else self.copy
        words = [self.label, self.printer, self.filament, copy, self.session]
        known = [word for word in words if word is not None]
        plain = [re.sub(r"[^A-Za-z0-9.+-]+", "-", word).strip("-.")[:40] for word in known]
        name = "_".join(word for word in plain if word) or UNKNOWN
        if plain == known:
            return name
        return f"{name}_{hashlib.sha256(repr(words).encode()).hexdigest()[:6]}"

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``run.json``."""
        names = ("label", "printer", "filament", "copy", "session")
        return {
            **{name: getattr(self, name) for name in names},
            "geometry": None if self.block is None else block_values(self.block),
        }


def block_values(block: Block) -> dict[str, Any]:
    """A block as plain values for ``run.json``."""
    texture = block.texture
    return {
        "texture": texture.name,
        "number": texture.number,
        "equation": texture.equation,
        "waves": [[w.amplitude, w.f, w.g, w.phase] for w in texture.waves.waves],
        "preset": block.preset,
        "scale": block.scale,
        "nominal_size_mm": list(block.nominal_size_mm),
        "nominal_height_mm": block.nominal_height_mm,
        "nominal_mm_per_unit": list(block.nominal_mm_per_unit),
        "origin_uv": list(block.origin_uv),
        "key_mm": block.key_mm,
        "sampling": (
            {"tolerance_mm": block.sampling.mm}
            if isinstance(block.sampling, Tolerance)
            else {"grid": [block.sampling.nx, block.sampling.ny]}
        ),
        "label": block.label,
        "engraved_copy": block.copy,
    }


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How a block is pressed. The defaults are the paper's, and ours where the paper is silent.

    Args:
        contact: ``force``: press to a target force; ``depth``: to a depth below first touch, on a rig without gauge.
        forces_n: Target forces, rising; in depth mode their number is that of the depths and they are not used.
        bands_n: Half width of the band around each target that counts as reached.
        depths_mm: Depths below first touch, rising (``contact = "depth"`` only).
        touch: How first touch is found in depth mode: by the gauge, by a change of the sensor, or taught by hand.
        repeats: Frames at each position and force.
        grid: The positions in the block frame at scale 1 of the paper's grid, already scaled.
        order: Positions as in the paper or shuffled again for each force and repeat.
        block_order: The study's blocks as written or shuffled.
        seed: Seed of both shuffles.
        reference_every_s: A new frame without contact after so long, to see drift.
        stationary_frames: Frames in contact, and as many without, at the start and the end of a block.
        clearance_mm: Height of travel above the highest of block and rim.
        depth_limit_mm: The sensor's summit never goes further below the block's highest point.
        hard_limit_n: Force that stops the run.
        approach_step_mm: Step of the approach below the travel height's last stretch.
        fine_step_mm: Smallest step of the search.
        search_steps: Most steps of the search for one press.
        settle_s: Wait after a step before anything is read.
        force_window_s: Time over which a force is averaged.
        misses_allowed: So many presses in a row outside of the band end the run.
    """

    contact: ContactMode = "force"
    forces_n: Levels = FORCES_N
    bands_n: Levels = FORCE_SPREADS_N
    depths_mm: Levels = DEPTHS_MM
    touch: TouchMethod = "gauge"
    repeats: Annotated[int, Bounds(1, 1000)] = REPEATS
    grid: PressGrid = field(default_factory=PressGrid.paper)
    order: Order = "paper"
    block_order: Order = "paper"
    seed: Annotated[int, Bounds(0, 2**32 - 1)] = 0
    reference_every_s: Annotated[float, Bounds(0.001, 1e7)] = 600.0
    stationary_frames: Annotated[int, Bounds(0, 10_000)] = 30
    clearance_mm: Annotated[float, Bounds(0.5, 200.0)] = 5.0
    depth_limit_mm: Annotated[float, Bounds(0.01, 100.0)] = 7.0
    hard_limit_n: Annotated[float, Bounds(0.0, 50.0)] = HARD_LIMIT_N
    approach_step_mm: Annotated[float, Bounds(1e-4, 1.0)] = 0.1
    fine_step_mm: Annotated[float, Bounds(1e-5, 0.1)] = 0.001
    search_steps: Annotated[int, Bounds(1, 10_000)] = 40
    settle_s: Annotated[float, Bounds(0.0, 60.0)] = 0.2
    force_window_s: Annotated[float, Bounds(0.0, 60.0)] = 0.1
    misses_allowed: Annotated[int, Bounds(1, 10_000)] = 5

    def __post_init__(self) -> None:
        check_fields(self)
        self._rising("forces_n", self.forces_n, self.hard_limit_n, "N, the hard limit")
        self._rising("depths_mm", self.depths_mm, self.depth_limit_mm, "mm, the depth limit")
        if len(self.bands_n) != len(self.forces_n):
            raise InputError("bands_n", list(self.bands_n), f"must be {len(self.forces_n)} numbers, one for each force")
        for band, force in zip(self.bands_n, self.forces_n, strict=True):
            if not 0.0 < band < force:
                raise InputError("bands_n", band, f"must be above 0 and below its force, {force:g} N")
        presses = self.levels * self.repeats * len(self.grid.x_mm) * len(self.grid.y_mm)
        if presses > MAX_PRESSES:
            raise InputError("repeats", self.repeats, f"gives {presses:,} presses of a block, at most {MAX_PRESSES:,}")

    @staticmethod
    def _rising(name: str, values: tuple[float, ...], limit: float, what: str) -> None:
        if values[0] <= 0.0 or list(values) != sorted(set(values)):
            raise InputError(name, list(values), "must be positive numbers, rising")
        if values[-1] >= limit:
            raise InputError(name, values[-1], f"must be below {limit:g} {what}")

    @property
    def levels(self) -> int:
        """Number of force (or depth) levels; they are counted from 1."""
        return len(self.forces_n) if self.contact == "force" else len(self.depths_mm)

    @property
    def all_levels(self) -> tuple[int, ...]:
        """The levels: 1, 2, 3."""
        return tuple(range(1, self.levels + 1))


@dataclass(frozen=True, kw_only=True)
class HolderRim(Checked):
    """What of the holder the sensor can touch.

    Args:
        rim_mm: How far the holder's top lies below the block's highest point.
        gap_mm: Clearance between block and pocket on each side; that of a slip fit by default.
    """

    rim_mm: Annotated[float, Bounds(-100.0, 100.0)] = 1.18
    gap_mm: Annotated[float, Bounds(-10.0, 10.0)] = FITS["slip"]


@dataclass(frozen=True, kw_only=True)
class WorkFrame(Checked):
    """The work frame in the stage's frame.

    Work frame: x and y are the block's own; z is 0 at the block's highest point and grows upwards. A pose is where the
    sensor's summit is.

    Args:
        origin_mm: The stage's x, y, z with the summit at the block's lower corner, at the height of its highest point.
        quarter_turns: Quarter turns counter-clockwise by which the block lies on the stage.
    """

    origin_mm: Point
    quarter_turns: QuarterTurns = 0

    def to_stage(self, pose_mm: Point) -> Point:
        """A point of the work frame in the stage's frame."""
        cos, sin = self._turn
        (x, y, z), (ox, oy, oz) = pose_mm, self.origin_mm
        return (ox + cos * x - sin * y, oy + sin * x + cos * y, oz + z)

    def to_work(self, point_mm: Point) -> Point:
        """A point of the stage's frame in the work frame."""
        cos, sin = self._turn
        x, y, z = minus(point_mm, self.origin_mm)
        return (cos * x + sin * y, -sin * x + cos * y, z)

    def shifted(self, offset_mm: Point) -> WorkFrame:
        """The frame of another slot of a tray, ``offset_mm`` away in the stage's frame."""
        return WorkFrame(origin_mm=plus(self.origin_mm, offset_mm), quarter_turns=self.quarter_turns)

    @property
    def _turn(self) -> tuple[int, int]:
        return ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns]


class _Device(Checked):
    """A device, whose driver is one of ours or a ``module:name``."""

    DRIVERS: ClassVar[tuple[str, ...]]
    driver: str

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_driver("driver", self.driver)

    @classmethod
    def require_driver(cls, field: str, word: str) -> None:
        """Refuse a driver that is neither one of ours nor a ``module:name``."""
        if ":" not in word:
            one_of(field, word, (*cls.DRIVERS, "module:name"))


@dataclass(frozen=True, kw_only=True)
class StageSettings(_Device):
    """The stage, as ``[stage]`` describes it.

    Args:
        driver: ``grbl``, ``marlin``, ``arduino``, ``virtual-grbl``, ``virtual-marlin`` or ``module:name``.
        port: A port by its stable name, or a pyserial URL; None for a virtual stage or to take the only candidate.
        baud: Symbols per second; None for the driver's own.
        origin_mm: See :class:`WorkFrame`.
        quarter_turns: See :class:`WorkFrame`.
        limits_mm: Lowest and highest x, y, z that the stage may be sent to, in its own frame.
        travel_mm_s: Speed above the clearance height.
        approach_mm_s: Speed of every step towards and in contact.
        slots_mm: Offsets of a tray's slots from the origin, in the stage's frame; one slot by default.
        home: Whether the stage is homed when it is opened.
        timeout_s: Longest silence that is waited through.
        options: What only one driver knows: ``steps_per_mm`` of ``arduino``, ``speed`` of the virtual ones, or the
            keyword arguments of a ``module:name``.
    """

    DRIVERS = ("grbl", "marlin", "arduino", "virtual-grbl", "virtual-marlin")
    driver: str
    port: str | None = None
    baud: Baud | None = None
    origin_mm: Point = (0.0, 0.0, 0.0)
    quarter_turns: QuarterTurns = 0
    limits_mm: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    travel_mm_s: Annotated[float, Bounds(0.001, 1000.0)] = 20.0
    approach_mm_s: Annotated[float, Bounds(0.001, 1000.0)] = 2.0
    slots_mm: Annotated[tuple[Point, ...], Length(1, 1000)] = ((0.0, 0.0, 0.0),)
    home: bool = True
    timeout_s: Annotated[float, Bounds(0.1, 600.0)] = 10.0
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for axis, (low, high) in zip("xyz", self.limits_mm, strict=True):
            if not low < high:
                raise InputError(f"limits_mm {axis}", [low, high], "must be two numbers, the lower one first")

    @property
    def frame(self) -> WorkFrame:
        """The work frame of the tray's first slot."""
        return WorkFrame(origin_mm=self.origin_mm, quarter_turns=self.quarter_turns)

    @property
    def frames(self) -> tuple[WorkFrame, ...]:
        """The work frame of each of the tray's slots."""
        return tuple(self.frame.shifted(offset) for offset in self.slots_mm)

    @property
    def is_virtual(self) -> bool:
        """Whether the stage is a simulator of ours."""
        return self.driver.startswith("virtual-")


@dataclass(frozen=True, kw_only=True)
class GaugeSettings(_Device):
    """The force gauge, as ``[gauge]`` describes it.

    Args:
        driver: ``serial``, ``simulated`` or ``none``.
        port: As the stage's.
        baud: Symbols per second.
        calibration: File written by ``tacbench rig calibrate-force``; None where the gauge sends newtons.
        timeout_s: Longest silence that is waited through.
        options: What only one driver knows.
    """

    DRIVERS = ("serial", "simulated", "none")
    driver: str = "none"
    port: str | None = None
    baud: Baud | None = None
    calibration: str | None = None
    timeout_s: Annotated[float, Bounds(0.1, 600.0)] = 2.0
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SensorSettings(_Device):
    """The tactile sensor, as ``[sensor]`` describes it.

    Args:
        driver: ``opencv``, ``taxels``, ``simulated`` or ``module:name``.
        device: Camera or port by its stable name.
        options: Settings that the driver knows by name: exposure, focus, width, height of a camera; columns, baud of
            taxels; keyword arguments of a ``module:name``.
    """

    DRIVERS = ("opencv", "taxels", "simulated")
    driver: str
    device: str | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RigSettings:
    """The three devices and the holder under them.

    Args:
        stage: The stage.
        gauge: The force gauge.
        sensor: The tactile sensor.
        holder: What surrounds the block.
    """

    stage: StageSettings
    gauge: GaugeSettings
    sensor: SensorSettings
    holder: HolderRim = field(default_factory=HolderRim)

    def require_gauge_for(self, protocol: Protocol) -> None:
        """Refuse a protocol that needs a gauge on a rig without one.

        Raises:
            InputError: It does; the message says what to use without a gauge.
        """
        if self.gauge.driver != "none":
            return
        if protocol.contact == "force":
            allowed = 'contact = "force" needs a gauge; without one use contact = "depth"'
            raise InputError("[gauge] driver", "none", allowed)
        if protocol.touch == "gauge":
            raise InputError("[protocol] touch", "gauge", 'needs a gauge; without one use "sensor" or "taught"')


@dataclass(frozen=True, kw_only=True)
class PlannedBlock:
    """A block of a study and the force levels that it is pressed at.

    Args:
        printed: The block.
        levels: The levels, from 1; all of them as a rule.
    """

    printed: PrintedBlock
    levels: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Study:
    """A whole study: its blocks in the order they are pressed, one protocol, one rig.

    Args:
        blocks: What is pressed; the names of the run folders are all different.
        protocol: How.
        holder: What surrounds the blocks.
        grid_spacing: Which of the paper's two readings of the grid was taken, or ``own``.
    """

    blocks: tuple[PlannedBlock, ...]
    protocol: Protocol
    holder: HolderRim = field(default_factory=HolderRim)
    grid_spacing: str = "even"

    def __post_init__(self) -> None:
        names = [planned.printed.name for planned in self.blocks]
        if not names:
            raise InputError("study", None, "has no block")
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError("study", twice, "is in it twice; give the copies different numbers")
        for planned in self.blocks:
            self.protocol.grid.require_on(planned.printed.block)
            wrong = [level for level in planned.levels if not 1 <= level <= self.protocol.levels]
            if wrong:
                raise InputError("force_levels", wrong[0], f"must be from 1 to {self.protocol.levels}")

    @property
    def presses(self) -> int:
        """Presses in the whole study."""
        presses = self.protocol.repeats * len(self.protocol.grid.positions_mm)
        return sum(len(planned.levels) * presses for planned in self.blocks)
