"""What ``run.json`` says of a run: everything that has to stay the same from its first press to its last."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

from tacbench_cad.lab.study.presses import Press, plan_presses
from tacbench_cad.lab.study.spec import (
    UNKNOWN,
    HolderRim,
    PlannedBlock,
    Pressed,
    PrintedBlock,
    Protocol,
    Specimen,
    Study,
    WorkFrame,
)
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError, one_of

#: What ``run.json`` calls this kind of folder, and the version of its layout that this program writes and reads.
SCHEMA = "tacbench-run"
#: The version of a run folder's layout; that of a run without a plan, which programs that know 1 alone must not read.
SCHEMA_VERSION, IMPORTED_VERSION = 1, 2
#: The work frame in words, as it stands in ``run.json``.
FRAME_TEXT = (
    "x and y are the block's own, z is 0 at the block's highest point and grows upwards; a pose is where the sensor's "
    "summit is, in mm and degrees"
)
#: Keys that may change between two sessions of one run: where a device is plugged in and what it calls itself.
CHANGING = ("identity", "port", "firmware", "version")
#: The most force levels of a run without a protocol.
MAX_LEVELS = 1000
#: Differences between two runs that are named; the others are counted.
MAX_SHOWN = 6

Plain = Mapping[str, Any]


class Plan(NamedTuple):
    """What is pressed, and how and where."""

    printed: PrintedBlock
    protocol: Protocol
    holder: HolderRim
    frame: WorkFrame


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """A run: what was pressed, its protocol and its rig.

    An imported run has no protocol: its rows are its plan, and whatever nobody said of it is None.

    Args:
        printed: The printed block, or what is known of it.
        levels: The force levels that are pressed, rising; empty where they are unknown.
        protocol: How they are pressed.
        grid_spacing: Which interpretation of the paper's grid was used, or ``own``.
        holder: What surrounds the block.
        frame: The work frame in the stage's frame.
        slot: Slot of the tray, from 0.
        stage: Plain values: ``identity``, ``simulated``, ``settings`` and further ones.
        gauge: Likewise, with ``calibration``.
        sensor: Likewise: ``name``, ``simulated``, ``units``, ``shape``, ``settings`` (requested and actual).
        source: The files with their SHA-256, where the frames were imported.

    Raises:
        InputError: A mapping holds what JSON cannot, or a level is not in the protocol.
    """

    printed: Pressed = field(metadata={"key": "block"})
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
            raise InputError("levels", list(self.levels), "must be force levels, rising")
        highest = self.protocol.levels if self.protocol else MAX_LEVELS
        if self.levels and not 1 <= self.levels[0] <= self.levels[-1] <= highest:
            raise InputError("levels", list(self.levels), f"must be from 1 to {highest}")
        for name in ("stage", "gauge", "sensor", "source"):
            # What comes back from a file must be equal to what went in: tuples are lists from the start.
            object.__setattr__(self, name, _plain(name, getattr(self, name)))
            settings = getattr(self, name).get("settings", {})
            inner = (settings.get(key, {}) for key in ("requested", "actual") if isinstance(settings, dict))
            if not all(isinstance(table, dict) for table in (settings, *inner)):
                raise InputError(f"{name} settings", None, "must be a table, and so must its requested and actual ones")
        shape = self.sensor.get("shape") or []
        if not isinstance(shape, list) or not all(type(side) is int and side > 0 for side in shape):
            raise InputError("sensor shape", shape, "must be whole numbers from 1")

    @classmethod
    def of(
        cls, study: Study, planned: PlannedBlock, frame: WorkFrame | None = None, slot: int = 0, **devices: Plain
    ) -> RunInfo:
        """The run of a block of a study.

        Args:
            study: The study.
            planned: One of its blocks.
            frame: Where it lies; the origin if None.
            slot: Its slot.
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
        """What of the rig was simulated: ``("sensor: simulated TacTip", ...)``; empty for a real run."""
        devices = (("stage", self.stage), ("gauge", self.gauge), ("sensor", self.sensor))
        return tuple(f"{name}: {device['simulated']}" for name, device in devices if device.get("simulated"))

    @property
    def frame_shape(self) -> tuple[int, ...] | None:
        """Shape of every frame, or None where the sensor does not say."""
        shape = self.sensor.get("shape")
        return tuple(shape) if shape else None

    @property
    def plan(self) -> Plan:
        """What is pressed, and how and where.

        Raises:
            InputError: The run was imported, so that not all of it is known.
        """
        printed, protocol, holder, frame = self.printed, self.protocol, self.holder, self.frame
        if not isinstance(printed, PrintedBlock) or protocol is None or holder is None or frame is None:
            raise InputError("run", printed.name, "was imported and has no protocol to press it by")
        return Plan(printed=printed, protocol=protocol, holder=holder, frame=frame)

    @property
    def presses(self) -> tuple[Press, ...]:
        """Every press of the run in the order of the protocol; none where there is no protocol."""
        return () if self.protocol is None else plan_presses(self.protocol, self.levels, self.printed.name)

    @property
    def version(self) -> int:
        """The version of the layout that it is written in."""
        return SCHEMA_VERSION if self.protocol else IMPORTED_VERSION

    @property
    def middle_press(self) -> Press:
        """The press of the frames without motion: middle force level, middle position."""
        level = self.levels[len(self.levels) // 2]
        presses = (press for press in self.presses if press.force_level == level and press.repeat == 1)
        in_order = sorted(presses, key=lambda press: press.position)
        return in_order[len(in_order) // 2]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``run.json``."""
        values: dict[str, Any] = to_plain(self)
        values["block"] = self.printed.as_dict()
        if self.protocol:
            values["protocol"]["grid"] = values["protocol"].pop("grid")
        if self.frame:
            values["frame"]["meaning"] = FRAME_TEXT
        return values

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], where: str = "run.json: ") -> RunInfo:
        """The run that :meth:`as_dict` described.

        Args:
            values: Its plain values; keys of other things that ``run.json`` says are ignored.
            where: Prefix of the field in messages.

        Raises:
            InputError: A key is missing or has another type or value than this program writes.
        """
        keys = [attribute.metadata.get("key", attribute.name) for attribute in fields(cls)]
        known = {key: values[key] for key in keys if key in values}
        if "block" in known:
            known["block"] = printed_from(known["block"], where)
        if isinstance(known.get("frame"), Mapping):
            known["frame"] = {key: value for key, value in known["frame"].items() if key != "meaning"}
        for key, kind in (("holder", HolderRim), ("frame", WorkFrame)):  # a default is no measured value
            for attribute in fields(kind):
                if isinstance(known.get(key), Mapping) and attribute.name not in known[key]:
                    raise InputError(f"{where}[{key}] {attribute.name}", None, "is missing")
        return from_plain(cls, known, where)

    def differences(self, other: RunInfo) -> list[str]:
        """What differs between this run and another: ``sensor.settings.requested.exposure: 5 then, 7 now``.

        Ports, identities and versions (:data:`CHANGING`) may change from one session to the next and are left out.

        Args:
            other: The run as it is now; ``self`` is the one that was begun.
        """
        then, now = dict(_leaves(self.as_dict())), dict(_leaves(other.as_dict()))
        return [
            f"{key}: {_shown(then, key)} then, {_shown(now, key)} now"
            for key in dict.fromkeys([*then, *now])
            if key not in then or key not in now or then[key] != now[key]
        ]

    def require_same(self, other: RunInfo, what: str, advice: str) -> None:
        """Refuse to resume this run as another one.

        Args:
            other: The run as it is now.
            what: The run's name or folder, for the message.
            advice: What the user can do.

        Raises:
            InputError: The two differ; the message names the first differences.
        """
        differences = self.differences(other)
        if differences:
            more = f"; and {len(differences) - MAX_SHOWN} more" if len(differences) > MAX_SHOWN else ""
            shown = "; ".join(differences[:MAX_SHOWN]) + more
            raise InputError("run", what, f"was begun with other settings: {shown}; {advice}")


def _plain(name: str, value: Any) -> dict[str, Any]:
    try:
        plain: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InputError(name, None, f"holds what JSON cannot: {error}") from None
    return plain


def _leaves(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Every value with its path; lists count as one value."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if key not in CHANGING:
                yield from _leaves(inner, f"{where}.{key}" if where else str(key))
    else:
        yield where, value


def _shown(values: Mapping[str, Any], key: str) -> str:
    if key not in values:
        return "nothing"
    text = json.dumps(values[key])
    return text if len(text) <= 80 else f"{text[:77]}..."


def printed_from(values: Any, where: str = "") -> Pressed:
    """What ``as_dict()`` of a printed block or a specimen described.

    Raises:
        InputError: A key is missing, or a value is not allowed.
    """
    if not isinstance(values, Mapping) or "geometry" not in values:
        return printed_block_from(values, where)
    known = dict(values)
    geometry = known.pop("geometry")
    if geometry is not None:
        if not isinstance(geometry, Mapping):
            raise InputError(f"{where}[block] geometry", None, "must be a table or null")
        made = printed_block_from({**geometry, "printer": UNKNOWN, "filament": UNKNOWN, "copy": 1}, where)
        known["block"] = made.block
    return from_plain(Specimen, known, f"{where}[block] ")


def printed_block_from(values: Any, where: str = "") -> PrintedBlock:
    """The printed block of ``PrintedBlock.as_dict()``, its texture made from the waves: it may be a user's own.

    Raises:
        InputError: A key is missing, or a value is not allowed.
    """
    try:
        block = dict(values)
        waves = [dict(zip(("amplitude", "f", "g", "phase"), wave, strict=True)) for wave in block.pop("waves")]
        sampling = block.pop("sampling")
        texture = {"name": block.pop("texture"), "waves": {"waves": waves}}
        texture |= {key: block.pop(key) for key in ("number", "equation")}
        printed = {key: block.pop(key) for key in ("printer", "filament", "copy")}
        block |= {
            "texture": texture,
            "copy": block.pop("engraved_copy"),
            "sampling": (
                {"mm": sampling["tolerance_mm"]}
                if "tolerance_mm" in sampling
                else dict(zip(("nx", "ny"), sampling["grid"], strict=True))
            ),
        }
    except KeyError as error:
        raise InputError(f"{where}[block]", None, f"has no key {error.args[0]!r}") from None
    except (TypeError, ValueError):
        raise InputError(f"{where}[block]", None, "is not a block as this program writes it") from None
    one_of(f"{where}[block] preset", str(block.get("preset")), PRESETS)
    return from_plain(PrintedBlock, {"block": block, **printed}, where)
