"""The contents of ``run.json``: everything that must stay the same from the first press of a run to the last."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

from tacbench_cad.lab.study.presses import Press, plan_presses
from tacbench_cad.lab.study.spec import (
    HolderRim,
    PlannedBlock,
    Pressed,
    PrintedBlock,
    Protocol,
    Specimen,
    Study,
    WorkFrame,
)
from tacbench_cad.spec.storage import block_from
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError

#: The name of the schema in ``run.json``.
SCHEMA = "tacbench-run"
#: The version of the layout that this program reads and writes.
SCHEMA_VERSION = 3
#: The description of the work frame in ``run.json``.
FRAME_TEXT = (
    "x and y are the block's own, z is 0 at the block's highest point and grows upwards; a pose is where the sensor's "
    "summit is, in mm and degrees"
)
#: The keys that may change between two sessions of a run: the port of a device and the device's description of itself.
CHANGING = ("identity", "port", "firmware", "version")
#: The largest number of force levels of a run without a protocol.
MAX_LEVELS = 1000
#: The number of differences that an error message lists; it only counts the others.
MAX_SHOWN = 6

Plain = Mapping[str, Any]


class RunPlan(NamedTuple):
    """The printed block, the protocol, the holder and the work frame of a run."""

    printed: PrintedBlock
    protocol: Protocol
    holder: HolderRim
    frame: WorkFrame


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """The description of a run: the printed block, the protocol and the rig.

    An imported run has no protocol. Its rows take the place of the plan, and unknown values are None.

    Args:
        printed: The printed block, or the specimen of an imported run.
        levels: The force levels, in increasing order; empty if they are unknown.
        protocol: The protocol.
        grid_spacing: The interpretation of the paper's grid that was used, or ``own``.
        holder: The holder around the block.
        frame: The work frame in the stage's frame.
        slot: The slot of the tray, from 0.
        stage: The stage as plain values: ``identity``, ``simulated``, ``settings`` and others.
        gauge: The force gauge as plain values: the same keys, and ``calibration``.
        sensor: The sensor as plain values: ``name``, ``simulated``, ``units``, ``shape``, ``settings`` (requested and
            actual).
        source: The files of an imported run, with their SHA-256.

    Raises:
        InputError: A mapping has a value that JSON cannot store, or a level is not in the protocol.
    """

    printed: Pressed = field(metadata={"alias": "block"})
    levels: tuple[int, ...]
    protocol: Protocol | None
    grid_spacing: str | None
    holder: HolderRim | None
    frame: WorkFrame | None
    slot: int | None
    stage: Plain
    gauge: Plain
    sensor: Plain
    source: Plain = field(default_factory=dict)

    def __post_init__(self) -> None:
        if list(self.levels) != sorted(set(self.levels)) or (self.protocol and not self.levels):
            raise InputError("levels", list(self.levels), "must be force levels in increasing order")
        highest = self.protocol.levels if self.protocol else MAX_LEVELS
        if self.levels and not 1 <= self.levels[0] <= self.levels[-1] <= highest:
            raise InputError("levels", list(self.levels), f"must be from 1 to {highest}")
        for name in ("stage", "gauge", "sensor", "source"):
            # A RunInfo that is read back must equal the one that was written, so tuples become lists here already.
            object.__setattr__(self, name, _plain(name, getattr(self, name)))
            settings = getattr(self, name).get("settings", {})
            inner = (settings.get(key, {}) for key in ("requested", "actual") if isinstance(settings, dict))
            if not all(isinstance(table, dict) for table in (settings, *inner)):
                raise InputError(f"{name} settings", None, "must be a table; requested and actual must be tables, too")
        shape = self.sensor.get("shape") or []
        if not isinstance(shape, list) or not all(type(side) is int and side > 0 for side in shape):
            raise InputError("sensor shape", shape, "must be a list of whole numbers from 1")

    @classmethod
    def of(
        cls, study: Study, planned: PlannedBlock, frame: WorkFrame | None = None, slot: int = 0, **devices: Plain
    ) -> RunInfo:
        """Return the description of the run of a study's block.

        Args:
            study: The study.
            planned: A block of the study.
            frame: The work frame; a frame at the stage's origin if None.
            slot: The slot of the tray, from 0.
            **devices: ``stage``, ``gauge`` and ``sensor``.
        """
        return cls(
            printed=planned.printed,
            levels=planned.levels,
            protocol=study.protocol,
            grid_spacing=study.grid_spacing,
            holder=study.holder,
            frame=frame or WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
            slot=slot,
            **devices,
        )

    @property
    def simulated(self) -> tuple[str, ...]:
        """The simulated devices: ``("sensor: simulated TacTip", ...)``; empty for a real run."""
        devices = (("stage", self.stage), ("gauge", self.gauge), ("sensor", self.sensor))
        return tuple(f"{name}: {device['simulated']}" for name, device in devices if device.get("simulated"))

    @property
    def frame_shape(self) -> tuple[int, ...] | None:
        """The shape of every frame; None if the sensor does not report it."""
        shape = self.sensor.get("shape")
        return tuple(shape) if shape else None

    @property
    def plan(self) -> RunPlan:
        """The printed block, the protocol, the holder and the work frame.

        Raises:
            InputError: The run was imported, so some of them are unknown.
        """
        printed, protocol, holder, frame = self.printed, self.protocol, self.holder, self.frame
        if not isinstance(printed, PrintedBlock) or protocol is None or holder is None or frame is None:
            raise InputError("run", printed.name, "was imported, so it has no protocol")
        return RunPlan(printed=printed, protocol=protocol, holder=holder, frame=frame)

    @property
    def presses(self) -> tuple[Press, ...]:
        """All presses of the run in the order of the protocol; empty without a protocol."""
        return () if self.protocol is None else plan_presses(self.protocol, self.levels, self.printed.name)

    @property
    def series_frames(self) -> int:
        """The number of moving frames after each press; 0 if the run has no series."""
        return 0 if self.protocol is None else self.protocol.series_frames

    @property
    def press_by_number(self) -> dict[int, Press]:
        """The same presses by their numbers."""
        return {press.number: press for press in self.presses}

    @property
    def middle_press(self) -> Press:
        """The press for the frames without motion: the middle position at the middle force level."""
        level = self.levels[len(self.levels) // 2]
        presses = (press for press in self.presses if press.force_level == level and press.repeat == 1)
        in_order = sorted(presses, key=lambda press: press.position)
        return in_order[len(in_order) // 2]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``run.json``."""
        values: dict[str, Any] = to_plain(self)
        values["block"] = self.printed.as_dict()
        if self.frame:
            values["frame"]["meaning"] = FRAME_TEXT
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], where: str = "run.json: ") -> RunInfo:
        """Make a description from the plain values of :meth:`as_dict`.

        Args:
            values: The plain values. Other keys of ``run.json`` are ignored.
            where: The beginning of every error message.

        Raises:
            InputError: A key is missing, or has a type or value that this program does not write.
        """
        keys = [attribute.metadata.get("alias", attribute.name) for attribute in fields(cls)]
        known = {key: values[key] for key in keys if key in values}
        if "block" in known:
            known["block"] = printed_from(known["block"], where)
        if isinstance(known.get("frame"), Mapping):
            known["frame"] = {key: value for key, value in known["frame"].items() if key != "meaning"}
        for key, kind in (("holder", HolderRim), ("frame", WorkFrame)):  # a default must not pass for a measured value
            for attribute in fields(kind):
                if isinstance(known.get(key), Mapping) and attribute.name not in known[key]:
                    raise InputError(f"{where}[{key}] {attribute.name}", None, "is missing")
        return from_plain(cls, known, where)

    def differences(self, other: RunInfo) -> list[str]:
        """List the differences between this run and another: ``sensor.settings.requested.exposure was 5, is now 7``.

        Ports, identities and versions (:data:`CHANGING`) may change from session to session and are left out.

        Args:
            other: The description of the run now; ``self`` is its description when it was started.
        """
        then, now = dict(_leaves(self.as_dict())), dict(_leaves(other.as_dict()))
        return [
            f"{key} was {_shown(then, key)}, is now {_shown(now, key)}"
            for key in dict.fromkeys([*then, *now])
            if key not in then or key not in now or then[key] != now[key]
        ]

    def require_same(self, other: RunInfo, what: str, advice: str) -> None:
        """Check that this run can be resumed with the present settings.

        Args:
            other: The description of the run now.
            what: The name or the folder of the run, for the message.
            advice: The user's next step, for the message.

        Raises:
            InputError: The descriptions differ. The message names the first differences.
        """
        differences = self.differences(other)
        if differences:
            more = f"; and {len(differences) - MAX_SHOWN} more" if len(differences) > MAX_SHOWN else ""
            shown = "; ".join(differences[:MAX_SHOWN]) + more
            raise InputError("run", what, f"was started with other settings: {shown}; {advice}")


def _plain(name: str, value: Any) -> dict[str, Any]:
    try:
        plain: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InputError(name, None, f"has a value that JSON cannot store: {error}") from None
    return plain


def _leaves(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every value with its path. A list is treated as a single value."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key not in CHANGING:
                yield from _leaves(inner, f"{where}.{key}" if where else str(key))
    else:
        yield where, value


def _shown(values: Mapping[str, Any], key: str) -> str:
    if key not in values:
        return "missing"
    text = json.dumps(values[key])
    return text if len(text) <= 80 else f"{text[:77]}..."


def printed_from(values: Any, where: str = "") -> Pressed:
    """Make a printed block or a specimen from the plain values of its ``as_dict()``.

    Raises:
        InputError: A key is missing, or a value is not allowed.
    """
    if not isinstance(values, Mapping) or "geometry" not in values:
        return printed_block_from(values, where)
    known = dict(values)
    geometry = known.pop("geometry")
    if geometry is not None:
        known["block"] = block_from(geometry, where)
    return from_plain(Specimen, known, f"{where}[block] ")


def printed_block_from(values: Any, where: str = "") -> PrintedBlock:
    """Make a printed block from ``PrintedBlock.as_dict()``.

    Raises:
        InputError: A key is missing, or a value is not allowed.
    """
    if not isinstance(values, Mapping):
        raise InputError(f"{where}[block]", None, "is not a block that this program wrote")
    known = dict(values)
    printed = {key: known.pop(key) for key in ("printer", "filament", "copy") if key in known}
    if (file := known.pop("file", None)) is not None:
        printed["file"] = block_from(file, where)
    return from_plain(PrintedBlock, {**printed, "block": block_from(known, where)}, f"{where}[block] ")
