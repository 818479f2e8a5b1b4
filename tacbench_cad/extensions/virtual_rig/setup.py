"""The settings of a virtual rig, and the board that they describe."""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Annotated, Any, Literal, get_args

from annotated_types import Ge, Interval

from tacbench_cad.extensions.virtual_rig.arduino import Arduino
from tacbench_cad.extensions.virtual_rig.base import Firmware
from tacbench_cad.extensions.virtual_rig.board import Board
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.grbl import Grbl
from tacbench_cad.extensions.virtual_rig.grbl_memory import GRBL, GRBLHAL
from tacbench_cad.extensions.virtual_rig.loadcell import CellSettings, FlatSpring
from tacbench_cad.extensions.virtual_rig.machine import MotorAxis, VirtualCarriage
from tacbench_cad.extensions.virtual_rig.marlin import Marlin
from tacbench_cad.lab.study import Point
from tacbench_cad.util.convert import Checked, from_plain
from tacbench_cad.util.errors import InputError, nearest

Kind = Literal["grbl", "grblhal", "marlin", "arduino"]
#: The kinds of firmware.
KINDS: tuple[str, ...] = get_args(Kind)


@dataclass(frozen=True, kw_only=True)
class Setup(Checked):
    """A virtual rig.

    After homing, all frames have z upwards with the end stop of z at the top. The ranges are:

    * ``grbl`` and ``grblhal``: x and y 0 to 200 mm, z -100 to 0 mm, homed at (0, 0, 0);
    * ``marlin``: x and y 0 to 200 mm, z 0 to 100 mm, homed at (0, 0, 100);
    * ``arduino``: as ``grbl``, in steps (400 per mm on each axis).

    The simulated end stops close between two steps, so the reported position may differ from the true one by a step.

    Args:
        kind: The firmware: ``grbl``, ``grblhal``, ``marlin`` or ``arduino``.
        speed: The speed as a multiple of real time.
        seed: The seed for all random effects.
        faults: Faults that occur at their time.
        tcp: Whether to use TCP ports instead of pseudo-terminals.
        resets_on_open: Whether opening the port resets the board, as on most Arduino boards.
        late_s: The range of the time by which each reply of the stage comes late, in s of rig time.
        origin: Where a ``grbl`` or ``grblhal`` counts from after homing: ``pulloff`` (built with
            HOMING_FORCE_SET_ORIGIN), or ``switch`` (the default of GRBL: all coordinates are negative, z from -100 to 0
            with the switch at 0, and homing ends at -1).
        start_mm: The true position of the carriage at the start, in the frame after homing; None for the default.
        stimulus: The spring under the carriage; None for nothing.
        gauge: The properties of the load cell.
        firmware: Keyword arguments of the firmware: ``settings`` of ``grbl``, ``emergency_parser`` of ``marlin``.
    """

    kind: Kind
    speed: Annotated[float, Interval(ge=0.01, le=1000.0)] = 1.0
    seed: int = 0
    faults: tuple[Fault, ...] = ()
    tcp: bool = False
    resets_on_open: bool = True
    late_s: tuple[Annotated[float, Ge(0.0)], Annotated[float, Ge(0.0)]] = (0.0, 0.0)
    origin: Literal["pulloff", "switch"] = "pulloff"
    start_mm: Point | None = None
    stimulus: FlatSpring | None = None
    gauge: CellSettings = field(default_factory=CellSettings)
    firmware: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls, kind: str, *, faults: Iterable[Fault | Mapping[str, Any] | str] = (), gauge: Any = None, **options: Any
    ) -> Setup:
        """Create a setup from one list of options. Options that are not fields of a setup belong to the firmware.

        Args:
            kind: The firmware.
            faults: The faults, also as plain values or texts, as in a configuration file.
            gauge: See :class:`Setup`; None for the defaults.
            **options: The other fields, and keyword arguments of the firmware.

        Raises:
            InputError: An option is unknown, or its value is not allowed.
        """
        own = {each.name for each in fields(cls)}
        values = {key: value for key, value in options.items() if key in own}
        firmware = {key: value for key, value in options.items() if key not in own}
        all_faults = [Fault.of(fault) for fault in faults]
        return from_plain(
            cls, {"kind": kind, "faults": all_faults, "gauge": gauge or {}, "firmware": firmware, **values}
        )

    def board(self) -> Board:
        """Create the board with its firmware, carriage and faults, but without the load cell's faults."""
        if (self.kind, self.origin) not in _BUILDS:
            raise InputError("origin", self.origin, f"is not an option of {self.kind}")
        factory, axes = _BUILDS[self.kind, self.origin]
        allowed = list(inspect.signature(factory).parameters)[1:]
        for key, value in self.firmware.items():
            if key not in allowed:
                raise InputError(f"option of {self.kind}", key, nearest(key, allowed))
            if isinstance(value, str):
                raise InputError(f"option {key} of {self.kind}", value, "must be a number")
        start = self.start_mm or (axes[0].low_mm + 60.0, axes[1].low_mm + 45.0, axes[2].low_mm + 80.0)
        firmware = factory(VirtualCarriage(axes, start, random.Random(self.seed)), **self.firmware)
        faults = [fault for fault in self.faults if not fault.of_gauge]
        return Board(firmware, seed=self.seed + 1, faults=faults, late_s=self.late_s)


def _axes(
    xy_low_mm: float, z_low_mm: float, switch_mm: float, xy_steps: float, z_steps: float
) -> tuple[MotorAxis, ...]:
    """Return axes x and y of 200 mm with end stops at the low end, and z of 100 mm with its end stop at the top."""
    flat = MotorAxis(low_mm=xy_low_mm, high_mm=xy_low_mm + 200.0, home=-1, switch_mm=switch_mm, steps_per_mm=xy_steps)
    up = MotorAxis(low_mm=z_low_mm, high_mm=z_low_mm + 100.0, home=1, switch_mm=switch_mm, steps_per_mm=z_steps)
    return flat, flat, up


#: The builds by firmware and origin. GRBL's machine frame has z = 0 at the top; Marlin's has z = 100 there. In the
#: default builds of GRBL and grblHAL, with the origin at the switch, all coordinates are negative. The letter Z in
#: ``[OPT:`` stands for HOMING_FORCE_SET_ORIGIN.
_BUILDS: Mapping[tuple[str, str], tuple[Callable[..., Firmware], tuple[MotorAxis, ...]]] = {
    ("grbl", "pulloff"): (Grbl, _axes(0.0, -100.0, 1.0, 400.0, 1600.0)),
    ("grblhal", "pulloff"): (partial(Grbl, dialect=GRBLHAL), _axes(0.0, -100.0, 1.0, 400.0, 1600.0)),
    ("marlin", "pulloff"): (Marlin, _axes(0.0, 0.0, 0.0, 80.0, 400.0)),
    ("arduino", "pulloff"): (Arduino, _axes(0.0, -100.0, 0.0, 400.0, 400.0)),
    ("grbl", "switch"): (
        partial(Grbl, dialect=replace(GRBL, options="[OPT:V,15,128]")),
        _axes(-200.0, -100.0, 0.0, 400.0, 1600.0),
    ),
    ("grblhal", "switch"): (
        partial(Grbl, dialect=replace(GRBLHAL, options="[OPT:VNMSL,35,1024,3,0]")),
        _axes(-200.0, -100.0, 0.0, 400.0, 1600.0),
    ),
}
