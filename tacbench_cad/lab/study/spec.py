"""The values that describe a data run: the printed block, the protocol, the holder and the devices of the rig.

Nothing here uses a file or a device. Units are millimetres, newtons and seconds.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval, Len

from tacbench_cad.lab.study.motion import MotionSettings, motion_of
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.fits import FITS
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, REPEATS, PressGrid, beyond_top_mm
from tacbench_cad.spec.storage import block_values
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import file_name
from tacbench_cad.util.types import Floats

ContactMode = Literal["force", "depth"]
TouchMethod = Literal["gauge", "sensor", "taught"]
Order = Literal["paper", "random"]
#: A point in a frame: x, y and z in mm.
Point = tuple[float, float, float]
QuarterTurns = Annotated[int, Interval(ge=0, le=3)]
Baud = Annotated[int, Interval(ge=300, le=10_000_000)]
Copy = Annotated[int, Interval(ge=1, le=999)]
Seed = Annotated[int, Interval(ge=0, le=2**32 - 1)]
#: Target forces or depths.
Levels = Annotated[tuple[float, ...], Len(1, 1000)]


def plus(a: Point, b: Point) -> Point:
    """Return the sum of two points."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Point, b: Point) -> Point:
    """Return the difference of two points."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


#: The default contact force that stops a run, in N.
HARD_LIMIT_N = 5.0
#: The largest number of presses of a block, which would take about a year.
MAX_PRESSES = 1_000_000
#: The number of parts of a motion whose ends are checked to lie on the block.
MOTION_PARTS = 200
#: The default depths below the first contact, in mm, for a rig without a gauge. They are the rounded depths to which
#: the three forces press the simulated dome against a flat plate. A calibration of the rig gives better values.
DEPTHS_MM = (0.35, 1.7, 2.2)


#: The word for a rig without a force gauge, in place of a driver.
NO_GAUGE = "none"
#: The word in tables for an unknown printer, filament or label.
UNKNOWN = "unknown"


class _Combined(Checked):
    """A pressed object that has a printer and a filament, which may be unknown."""

    printer: str | None
    filament: str | None

    @property
    def combination(self) -> str:
        """The printer and the filament in one word: ``bambu-p1p_pla-minus``."""
        return f"{self.printer or UNKNOWN}_{self.filament or UNKNOWN}"


@dataclass(frozen=True, kw_only=True)
class PrintedBlock(_Combined):
    """A printed block.

    Args:
        block: The geometry that the print is expected to have.
        printer: The name of the printer, as in :mod:`tacbench_cad.lab.study.names`.
        filament: The name of the filament, as in the same module.
        copy: The number of the copy, from 1.
        file: The block as it is in the printed file, if it differs from ``block``, for example because it makes up for
            errors of the printer; None if it does not.
    """

    block: Block
    printer: str
    filament: str
    copy: Copy = 1
    file: Block | None = None

    @property
    def texture(self) -> str:
        """The name of the texture: ``texture-4``."""
        return self.block.texture.name

    @property
    def object_label(self) -> int | str:
        """The label for TacTip toolchains: 1 to 6, or the name of another texture."""
        return self.block.texture.number or self.texture

    @property
    def name(self) -> str:
        """The name of the run folder: ``texture-4_paper_x1_bambu-p1p_pla-minus_copy01``."""
        stem = self.block.name.split("_copy")[0]
        file = "" if self.file is None else f"_from-{self.file.texture.name}"
        return f"{stem}{file}_{self.combination}_copy{self.copy:02d}"

    @property
    def in_file(self) -> Block:
        """The block as it is in the printed file."""
        return self.file or self.block

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``run.json``, from which :mod:`tacbench_cad.lab.runs` can make the block again."""
        origin = {"printer": self.printer, "filament": self.filament, "copy": self.copy}
        file = {} if self.file is None else {"file": block_values(self.file)}
        return {**block_values(self.block), **origin, **file}


@dataclass(frozen=True, kw_only=True)
class Specimen(_Combined):
    """A pressed object of an imported run. Unknown values are None.

    Args:
        label: The label that classifiers learn.
        printer: The printer.
        filament: The filament.
        copy: The number or the name of the print.
        session: The name of the recording, if the print was recorded more than once.
        block: The geometry.
        distinct: Whether a hash must tell the name from another one that has the same letters.
    """

    label: str | None = None
    printer: str | None = None
    filament: str | None = None
    copy: int | str | None = None
    session: str | None = None
    block: Block | None = None
    distinct: bool = False

    @property
    def texture(self) -> str | None:
        """The label."""
        return self.label

    @property
    def object_label(self) -> int | str | None:
        """The label for TacTip toolchains. A label of one to three digits becomes a number."""
        number = self.block.texture.number if self.block else None
        return number or (int(self.label) if self.label and re.fullmatch(r"[1-9]\d{0,2}", self.label) else self.label)

    @property
    def name(self) -> str:
        """The name of the run folder, made of the known values, as far as file names allow them."""
        copy = f"copy{self.copy:02d}" if isinstance(self.copy, int) else self.copy
        words = [self.label, self.printer, self.filament, copy, self.session]
        name = "_".join(plain for word in words if word is not None and (plain := file_name(word, 40))) or UNKNOWN
        return f"{name}_{hashlib.sha256(repr(words).encode()).hexdigest()[:6]}" if self.distinct else name

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``run.json``."""
        names = ("label", "printer", "filament", "copy", "session")
        return {
            **{name: getattr(self, name) for name in names},
            **({"distinct": True} if self.distinct else {}),
            "geometry": None if self.block is None else block_values(self.block),
        }


#: A pressed object, some values of which may be unknown.
Pressed = PrintedBlock | Specimen


@dataclass(frozen=True, kw_only=True)
class PressPositions(Checked):
    """Where the presses are and in which order, in the table ``[protocol.positions]``.

    Args:
        grid: The positions in the block frame, already scaled with the block.
        order: The order of the positions: as in the paper, or random for each force and repeat.
        block_order: The order of the study's blocks: as in the file, or random.
        seed: The seed of both random orders.
    """

    grid: PressGrid = field(default_factory=PressGrid.paper)
    order: Order = "paper"
    block_order: Order = "paper"
    seed: Seed = 0


@dataclass(frozen=True, kw_only=True)
class PressTargets(Checked):
    """How hard or how deep the presses are, in the table ``[protocol.targets]``.

    Args:
        contact: ``force`` to press to a target force, or ``depth`` to press to a depth below the first contact (on a
            rig without a gauge).
        forces_n: The target forces, in increasing order; not used in depth mode.
        bands_n: The half width of the band around each target force. A force in the band has reached its target.
        depths_mm: The depths below the first contact, in increasing order; only used in depth mode.
        touch: How the first contact is found in depth mode: with the gauge, by a change of the sensor's frames, or
            taught by hand.
    """

    contact: ContactMode = "force"
    forces_n: Levels = FORCES_N
    bands_n: Levels = FORCE_SPREADS_N
    depths_mm: Levels = DEPTHS_MM
    touch: TouchMethod = "gauge"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, values in (("forces_n", self.forces_n), ("depths_mm", self.depths_mm)):
            if values[0] <= 0.0 or list(values) != sorted(set(values)):
                raise InputError(name, list(values), "must be positive numbers in increasing order")
        if len(self.bands_n) != len(self.forces_n):
            raise InputError("bands_n", list(self.bands_n), f"must be {len(self.forces_n)} numbers, one for each force")
        for band, force in zip(self.bands_n, self.forces_n, strict=True):
            if not 0.0 < band < force:
                raise InputError("bands_n", band, f"must be above 0 and below its force, {force:g} N")


@dataclass(frozen=True, kw_only=True)
class PressChecks(Checked):
    """How the quality of a run is checked, in the table ``[protocol.checks]``.

    Args:
        reference_every_s: The time after which a new frame without contact is taken, to show drift.
        stationary_frames: The number of frames in contact, and also of frames without contact, that are taken at the
            start and at the end of a block.
        misses_allowed: The number of consecutive presses outside the band that ends the run.
        home_every: The number of presses after which the position is checked: the stage is homed and a press is
            repeated; 0 for no checks.
        slip_mm: The largest error of the position that such a check accepts.
    """

    reference_every_s: Annotated[float, Interval(ge=0.001, le=1e7)] = 600.0
    stationary_frames: Annotated[int, Interval(ge=0, le=10_000)] = 30
    misses_allowed: Annotated[int, Interval(ge=1, le=10_000)] = 5
    home_every: Annotated[int, Interval(ge=0, le=MAX_PRESSES)] = 50
    slip_mm: Annotated[float, Interval(ge=0.001, le=10.0)] = 0.1


@dataclass(frozen=True, kw_only=True)
class PressLimits(Checked):
    """What keeps the sensor and the block safe, in the table ``[protocol.limits]``.

    Args:
        clearance_mm: The travel height above the block and the rim.
        depth_limit_mm: The largest depth of the sensor's summit below the block's highest point.
        hard_limit_n: The force that stops the run.
    """

    clearance_mm: Annotated[float, Interval(ge=0.5, le=200.0)] = 5.0
    depth_limit_mm: Annotated[float, Interval(ge=0.01, le=100.0)] = 7.0
    hard_limit_n: Annotated[float, Interval(ge=0.0, le=50.0)] = HARD_LIMIT_N


@dataclass(frozen=True, kw_only=True)
class PressSteps(Checked):
    """How a target is approached, in the table ``[protocol.steps]``.

    Args:
        approach_step_mm: The step of the approach.
        fine_step_mm: The smallest step of the search.
        search_steps: The largest number of search steps for a press.
        settle_s: The waiting time after a step, before a force or a frame is read.
        force_window_s: The time over which a force is averaged.
    """

    approach_step_mm: Annotated[float, Interval(ge=1e-4, le=1.0)] = 0.1
    fine_step_mm: Annotated[float, Interval(ge=1e-5, le=0.1)] = 0.001
    search_steps: Annotated[int, Interval(ge=1, le=10_000)] = 40
    settle_s: Annotated[float, Interval(ge=0.0, le=60.0)] = 0.2
    force_window_s: Annotated[float, Interval(ge=0.0, le=60.0)] = 0.1


@dataclass(frozen=True, kw_only=True)
class Protocol(Checked):
    """The protocol of the presses. The defaults are the paper's values, or ours if the paper gives none.

    Args:
        repeats: The number of frames at each position and force.
        positions: Where the presses are and in which order.
        targets: How hard or how deep they are.
        checks: How the quality of the run is checked.
        limits: What keeps the sensor and the block safe.
        steps: How a target is approached.
        motion: The motion in contact after the frame of each press, during which a series of frames is recorded; None
            for a press that is lifted at once.
    """

    repeats: Annotated[int, Interval(ge=1, le=1000)] = REPEATS
    positions: PressPositions = field(default_factory=PressPositions)
    targets: PressTargets = field(default_factory=PressTargets)
    checks: PressChecks = field(default_factory=PressChecks)
    limits: PressLimits = field(default_factory=PressLimits)
    steps: PressSteps = field(default_factory=PressSteps)
    motion: MotionSettings | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, values, limit, what in (
            ("forces_n", self.targets.forces_n, self.limits.hard_limit_n, "N, the hard limit"),
            ("depths_mm", self.targets.depths_mm, self.limits.depth_limit_mm, "mm, the depth limit"),
        ):
            if values[-1] >= limit:
                raise InputError(f"targets.{name}", values[-1], f"must be below {limit:g} {what}")
        presses = self.levels * self.repeats * len(self.positions.grid.positions_mm)
        if presses > MAX_PRESSES:
            allowed = f"gives {presses:,} presses of a block; at most {MAX_PRESSES:,} are allowed"
            raise InputError("repeats", self.repeats, allowed)

    def changed(self, **values: Any) -> Protocol:
        """Return this protocol with other values: ``Protocol().changed(repeats=1, settle_s=0.5)``.

        Args:
            **values: The values by their names, also those of the tables.

        Raises:
            InputError: A name is unknown, or a value is not allowed.
        """
        own: dict[str, Any] = {name: values.pop(name) for name in ("repeats", "motion") if name in values}
        for name in ("positions", "targets", "checks", "limits", "steps"):
            table = getattr(self, name)
            inside = {each.name: values.pop(each.name) for each in fields(table) if each.name in values}
            own[name] = replace(table, **inside)
        if values:
            raise InputError("protocol", next(iter(values)), "is not the name of a setting")
        return replace(self, **own)

    def path_mm(self, parts: int = 1) -> Floats:
        """Return the points of contact in all presses and motions, shape (parts + 1, positions, 2), in order of time.

        Args:
            parts: The number of equal parts into which each motion is divided.
        """
        motion = motion_of(self.motion)
        fractions = np.linspace(0.0, 1.0, parts + 1).tolist() if motion else []
        shifts = np.array([motion.shift_mm(fraction) for fraction in fractions] if motion else [(0.0, 0.0)])
        return np.asarray(self.positions.grid.positions_mm + shifts[:, None])

    def require_motions_on(self, block: Block) -> None:
        """Check that the contact stays on the top of a block in every motion.

        Raises:
            InputError: It leaves the top.
        """
        if self.motion is None:
            return
        path = self.path_mm(MOTION_PARTS)
        beyond = beyond_top_mm(block, path.reshape(-1, 2)).reshape(path.shape[:2]).max(axis=0)
        worst = int(beyond.argmax())
        if beyond[worst] > 1e-9:
            (x, y), size = path[0, worst], block.size_mm
            raise InputError(
                "[protocol.motion]",
                None,
                f"the {self.motion.name} from x {x:g}, y {y:g} mm leaves the top of the block ({size[0]:g} x "
                f"{size[1]:g} mm) by {beyond[worst]:.3g} mm; use a shorter one, another direction or another grid",
            )

    @property
    def series_frames(self) -> int:
        """The number of frames of each press's series; 0 without a motion."""
        return 0 if self.motion is None else self.motion.frames

    @property
    def levels(self) -> int:
        """The number of force levels (or depth levels)."""
        return len(self.targets.forces_n if self.targets.contact == "force" else self.targets.depths_mm)

    @property
    def all_levels(self) -> tuple[int, ...]:
        """The numbers of the levels, from 1."""
        return tuple(range(1, self.levels + 1))


@dataclass(frozen=True, kw_only=True)
class HolderRim(Checked):
    """The part of the holder that the sensor can touch.

    Args:
        rim_mm: The distance of the holder's top below the block's highest point.
        gap_mm: The clearance between the block and the pocket on each side; by default the clearance of a slip fit.
    """

    rim_mm: Annotated[float, Interval(ge=-100.0, le=100.0)] = 1.18
    gap_mm: Annotated[float, Interval(ge=-10.0, le=10.0)] = FITS["slip"]


@dataclass(frozen=True, kw_only=True)
class WorkFrame(Checked):
    """The work frame in the stage's frame.

    In the work frame, x and y are the block's x and y, and z is 0 at the block's highest point and points up. A pose is
    the position of the sensor's summit.

    Args:
        origin_mm: The stage's x, y and z when the summit is above the block's lower corner, at the height of the
            block's highest point.
        quarter_turns: The number of counter-clockwise quarter turns by which the block is turned on the stage.
    """

    origin_mm: Point
    quarter_turns: QuarterTurns = 0

    def to_stage(self, pose_mm: Point) -> Point:
        """Convert a point from the work frame to the stage's frame."""
        cos, sin = self._turn
        (x, y, z), (ox, oy, oz) = pose_mm, self.origin_mm
        return (ox + cos * x - sin * y, oy + sin * x + cos * y, oz + z)

    def to_work(self, point_mm: Point) -> Point:
        """Convert a point from the stage's frame to the work frame."""
        cos, sin = self._turn
        x, y, z = minus(point_mm, self.origin_mm)
        return (cos * x + sin * y, -sin * x + cos * y, z)

    def shifted(self, offset_mm: Point) -> WorkFrame:
        """Return the work frame of another slot of a tray, at a distance of ``offset_mm`` in the stage's frame."""
        return WorkFrame(origin_mm=plus(self.origin_mm, offset_mm), quarter_turns=self.quarter_turns)

    @property
    def _turn(self) -> tuple[int, int]:
        return ((1, 0), (0, 1), (-1, 0), (0, -1))[self.quarter_turns]


@dataclass(frozen=True, kw_only=True)
class StageSettings(Checked):
    """The settings of the stage, in the table ``[stage]``.

    Args:
        driver: A name that ``tacbench rig drivers`` lists, ``module:name``, or an object.
        port: The stable name of a port, or a pyserial URL; None to use the only possible port.
        baud: The baud rate, in symbols per second; None for the driver's default.
        origin_mm: Same as for :class:`WorkFrame`.
        quarter_turns: Same as for :class:`WorkFrame`.
        limits_mm: The lowest and the highest allowed x, y and z, in the stage's frame.
        travel_mm_s: The speed at the travel height, and down through free air to 1 mm above a known height.
        approach_mm_s: The speed of every step near the block and in contact.
        slots_mm: The offsets of a tray's slots from the origin, in the stage's frame; a single slot by default.
        home: Whether the stage is homed when it is opened.
        timeout_s: The longest time to wait for an answer.
        options: The driver's own settings: ``steps_per_mm`` of ``arduino``, ``speed`` of simulated stages, or the
            keyword arguments of a ``module:name``.
    """

    driver: Any
    port: str | None = None
    baud: Baud | None = None
    origin_mm: Point = (0.0, 0.0, 0.0)
    quarter_turns: QuarterTurns = 0
    limits_mm: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    travel_mm_s: Annotated[float, Interval(ge=0.001, le=1000.0)] = 20.0
    approach_mm_s: Annotated[float, Interval(ge=0.001, le=1000.0)] = 2.0
    slots_mm: Annotated[tuple[Point, ...], Len(1, 1000)] = ((0.0, 0.0, 0.0),)
    home: bool = True
    timeout_s: Annotated[float, Interval(ge=0.1, le=600.0)] = 10.0
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


@dataclass(frozen=True, kw_only=True)
class GaugeSettings(Checked):
    """The settings of the force gauge, in the table ``[gauge]``.

    Args:
        driver: A name that ``tacbench rig drivers`` lists, ``none``, ``module:name``, or an object.
        port: Same as for :class:`StageSettings`.
        baud: The baud rate, in symbols per second; None for the driver's default.
        calibration: The file written by ``tacbench rig calibrate-force``; None if the gauge sends newtons.
        timeout_s: The longest time to wait for an answer.
        options: The driver's own settings.
    """

    driver: Any = NO_GAUGE
    port: str | None = None
    baud: Baud | None = None
    calibration: str | None = None
    timeout_s: Annotated[float, Interval(ge=0.1, le=600.0)] = 2.0
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class SensorSettings(Checked):
    """The settings of the tactile sensor, in the table ``[sensor]``.

    Args:
        driver: A name that ``tacbench rig drivers`` lists, ``module:name``, or an object.
        device: The stable name of the camera or the port, or the serial number of the sensor.
        channels: The order of the colours in which the driver delivers images, ``rgb`` or ``bgr``; None for the order
            that the driver itself states.
        options: The driver's own settings: exposure, focus, width and height of a camera; columns and baud rate of
            taxels; keyword arguments of a ``module:name``.
    """

    driver: Any
    device: str | None = None
    channels: Literal["rgb", "bgr"] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class RigSettings:
    """The settings of the three devices, and the holder.

    Args:
        stage: The stage.
        gauge: The force gauge.
        sensor: The tactile sensor.
        holder: The holder around the block.
    """

    stage: StageSettings
    gauge: GaugeSettings
    sensor: SensorSettings
    holder: HolderRim = field(default_factory=HolderRim)

    def simulated(self, driver: str = "simulated", **options: Any) -> RigSettings:
        """Return the same rig with simulated devices in the place of its own.

        Args:
            driver: The driver of a simulated stage.
            **options: Its options: the ``speed`` of the rig relative to real time, or ``waits=False``.
        """
        gauge = NO_GAUGE if self.gauge.driver == NO_GAUGE else "simulated"
        return replace(
            self,
            stage=replace(self.stage, driver=driver, port=None, baud=None, options=options),
            gauge=GaugeSettings(driver=gauge),
            sensor=SensorSettings(driver="simulated"),
        )

    def require_gauge_for(self, protocol: Protocol) -> None:
        """Check that the rig has a gauge if the protocol needs one.

        Raises:
            InputError: The gauge is missing. The message says how to press without a gauge.
        """
        if self.gauge.driver != NO_GAUGE:
            return
        if protocol.targets.contact == "force":
            allowed = 'contact = "force" needs a gauge; without one use contact = "depth"'
            raise InputError("[gauge] driver", NO_GAUGE, allowed)
        if protocol.targets.touch == "gauge":
            raise InputError("[protocol.targets] touch", "gauge", 'needs a gauge; without one use "sensor" or "taught"')


@dataclass(frozen=True, kw_only=True)
class PlannedBlock:
    """A block of a study with its force levels.

    Args:
        printed: The block.
        levels: The force levels, from 1; usually all levels of the protocol.
    """

    printed: PrintedBlock
    levels: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Study:
    """A study: blocks that are pressed with the same protocol on the same rig.

    Args:
        blocks: The blocks, in the order of the presses. Their run folders must have different names.
        protocol: The protocol.
        holder: The holder around the blocks.
        grid_spacing: The interpretation of the paper's grid, or ``own``.
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
            raise InputError("study", twice, "occurs twice; give the copies different numbers")
        for planned in self.blocks:
            self.protocol.positions.grid.require_on(planned.printed.block)
            self.protocol.require_motions_on(planned.printed.block)
            wrong = [level for level in planned.levels if not 1 <= level <= self.protocol.levels]
            if wrong:
                raise InputError("force_levels", wrong[0], f"must be from 1 to {self.protocol.levels}")

    @property
    def presses(self) -> int:
        """The number of presses in the whole study."""
        presses = self.protocol.repeats * len(self.protocol.positions.grid.positions_mm)
        return sum(len(planned.levels) * presses for planned in self.blocks)
