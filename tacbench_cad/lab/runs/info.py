"""What ``run.json`` says of a run: everything that has to stay the same from its first press to its last."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from tacbench_cad.lab.study.presses import Press, plan_presses
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import Wave, WaveSum
from tacbench_cad.util.errors import InputError

#: What ``run.json`` calls this kind of folder, and the version of its layout that this program writes and reads.
SCHEMA = "tacbench-run"
#: The version of a run folder's layout.
SCHEMA_VERSION = 1
#: The work frame in words, as it stands in ``run.json``.
FRAME_TEXT = (
    "x and y are the block's own, z is 0 at the block's highest point and grows upwards; a pose is where the sensor's "
    "summit is, in mm and degrees"
)
#: Keys that may change between two sittings of one run: where a device is plugged in and what it calls itself.
CHANGING = ("identity", "port", "firmware", "version")

Plain = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """A run: its block, its protocol and its rig.

    Args:
        printed: The printed block.
        levels: The force levels that are pressed, rising.
        protocol: How.
        grid_spacing: Which of the paper's two readings of the grid was taken, or ``own``.
        holder: What surrounds the block.
        frame: The work frame in the stage's frame.
        slot: Slot of the tray, from 0.
        stage: Plain values: ``identity``, ``simulated``, ``settings`` and what else is worth keeping.
        gauge: Likewise, with ``calibration``.
        sensor: Likewise: ``name``, ``simulated``, ``units``, ``shape``, ``settings`` (requested and actual).
        source: Where the readings come from if they were imported: the files with their SHA-256.

    Raises:
        InputError: A mapping holds what JSON cannot, or a level is not in the protocol.
    """

    printed: PrintedBlock
    levels: tuple[int, ...]
    protocol: Protocol
    grid_spacing: str
    holder: HolderRim
    frame: WorkFrame
    slot: int
    stage: Plain
    gauge: Plain
    sensor: Plain
    source: Plain = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.levels or list(self.levels) != sorted(set(self.levels)):
            raise InputError("levels", list(self.levels), "must be force levels, rising")
        if not 1 <= self.levels[0] <= self.levels[-1] <= self.protocol.levels:
            raise InputError("levels", list(self.levels), f"must be from 1 to {self.protocol.levels}")
        for name in ("stage", "gauge", "sensor", "source"):
            # What comes back from a file must be equal to what went in: tuples are lists from the start.
            object.__setattr__(self, name, _plain(name, getattr(self, name)))

    @property
    def simulated(self) -> tuple[str, ...]:
        """What of the rig was simulated: ``("sensor: simulated TacTip", ...)``; empty for a real run."""
        devices = (("stage", self.stage), ("gauge", self.gauge), ("sensor", self.sensor))
        return tuple(f"{name}: {device['simulated']}" for name, device in devices if device.get("simulated"))

    @property
    def reading_shape(self) -> tuple[int, ...] | None:
        """Shape of every reading, or None where the sensor does not say."""
        shape = self.sensor.get("shape")
        return tuple(shape) if shape else None

    @property
    def presses(self) -> tuple[Press, ...]:
        """Every press of the run in the order of the protocol."""
        return plan_presses(self.protocol, self.levels, self.printed.name)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for ``run.json``."""
        return {
            "block": self.printed.as_dict(),
            "levels": list(self.levels),
            "protocol": self.protocol.as_dict(),
            "grid_spacing": self.grid_spacing,
            "holder": {"rim_mm": self.holder.rim_mm, "gap_mm": self.holder.gap_mm},
            "frame": {
                "origin_mm": list(self.frame.origin_mm),
                "quarter_turns": self.frame.quarter_turns,
                "meaning": FRAME_TEXT,
            },
            "slot": self.slot,
            "stage": dict(self.stage),
            "gauge": dict(self.gauge),
            "sensor": dict(self.sensor),
            "source": dict(self.source),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunInfo:
        """The run that :meth:`as_dict` described.

        Raises:
            InputError: A key is missing or has another type or value than this program writes.
        """
        try:
            frame, holder = values["frame"], values["holder"]
            return cls(
                printed=printed_from(values["block"]),
                levels=tuple(values["levels"]),
                protocol=_protocol(values["protocol"]),
                grid_spacing=str(values["grid_spacing"]),
                holder=HolderRim(rim_mm=holder["rim_mm"], gap_mm=holder["gap_mm"]),
                frame=WorkFrame(origin_mm=_three(frame["origin_mm"]), quarter_turns=frame["quarter_turns"]),
                slot=values["slot"],
                stage=values["stage"],
                gauge=values["gauge"],
                sensor=values["sensor"],
                source=values["source"],
            )
        except InputError:
            raise
        except KeyError as error:
            raise InputError("run.json", None, f"has no key {error.args[0]!r}") from None
        except (TypeError, ValueError, AttributeError) as error:
            raise InputError("run.json", None, f"holds a value of the wrong kind: {error}") from None

    def differences(self, other: RunInfo) -> list[str]:
        """What differs between this run and another: ``sensor.settings.requested.exposure: 5 then, 7 now``.

        Ports, identities and versions (:data:`CHANGING`) may change from one sitting to the next and are left out.

        Args:
            other: The run as it is now; ``self`` is the one that was begun.
        """
        then, now = dict(_leaves(self.as_dict())), dict(_leaves(other.as_dict()))
        return [
            f"{key}: {_shown(then, key)} then, {_shown(now, key)} now"
            for key in dict.fromkeys([*then, *now])
            if key not in then or key not in now or then[key] != now[key]
        ]


def _plain(name: str, value: Any) -> dict[str, Any]:
    try:
        made: dict[str, Any] = json.loads(json.dumps(dict(value), allow_nan=False))
    except (TypeError, ValueError) as error:
        raise InputError(name, None, f"holds what JSON cannot: {error}") from None
    return made


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


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return (float(x), float(y), float(z))


def printed_from(values: Mapping[str, Any]) -> PrintedBlock:
    """The printed block, its texture made anew from the waves (so it may be a user's own)."""
    waves = tuple(Wave(amplitude=a, f=f, g=g, phase=phase) for a, f, g, phase in values["waves"])
    texture = Texture(
        name=values["texture"], equation=values["equation"], waves=WaveSum(waves), number=values["number"]
    )
    x, y = values["nominal_size_mm"]
    u, v = values["origin_uv"]
    sampling = values["sampling"]
    block = Block(
        texture=texture,
        preset=values["preset"],
        nominal_size_mm=(x, y),
        nominal_height_mm=values["nominal_height_mm"],
        nominal_mm_per_unit=_three(values["nominal_mm_per_unit"]),
        sampling=(
            Tolerance(mm=sampling["tolerance_mm"])
            if "tolerance_mm" in sampling
            else SampleGrid(nx=sampling["grid"][0], ny=sampling["grid"][1])
        ),
        origin_uv=(u, v),
        scale=values["scale"],
        key_mm=values["key_mm"],
        label=values["label"],
        copy=values["engraved_copy"],
    )
    return PrintedBlock(block=block, printer=values["printer"], filament=values["filament"], copy=values["copy"])


def _protocol(values: Mapping[str, Any]) -> Protocol:
    known = {one.name for one in fields(Protocol)}
    unknown = [key for key in values if key not in known]
    if unknown:
        raise InputError("run.json protocol", unknown[0], "is not a key of this version's protocol")
    grid = PressGrid(x_mm=tuple(values["grid"]["x_mm"]), y_mm=tuple(values["grid"]["y_mm"]))
    plain: dict[str, Any] = {key: value for key, value in values.items() if key != "grid"}
    for key, value in plain.items():
        plain[key] = tuple(value) if isinstance(value, list) else value
    return Protocol(grid=grid, **plain)
