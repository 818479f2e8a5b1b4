"""FILE.toml: the one reader of what is pressed, how, and on which rig, for ``acquire`` and ``simulate`` alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.plate import block_of_word, read_layout
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    PlannedBlock,
    PrintedBlock,
    Protocol,
    RigSettings,
    SensorSettings,
    StageSettings,
    Study,
)
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.settings import Table, read_toml

T = TypeVar("T")

#: Stage drivers that have a name of their own.
STAGES = ("grbl", "marlin", "arduino", "virtual-grbl", "virtual-marlin")
#: Gauge drivers that have a name of their own.
GAUGES = ("serial", "simulated", "none")
#: Sensor drivers that have a name of their own.
SENSORS = ("opencv", "taxels", "simulated")
#: Where the virtual stages' blocks lie, and how far those stages go, in mm.
VIRTUAL_ORIGINS_MM = {"virtual-grbl": (80.0, 80.0, -60.0), "virtual-marlin": (80.0, 80.0, 40.0)}
#: How far the virtual stages go along x, y and z, in mm.
VIRTUAL_LIMITS_MM = {
    "virtual-grbl": ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0)),
    "virtual-marlin": ((0.0, 200.0), (0.0, 200.0), (0.0, 100.0)),
}


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """What a file says.

    Args:
        study: Blocks and protocol.
        rig: The devices, or None where the file has none (a study that is only simulated).
        out: Where the run folders go, or None where the file does not say.
    """

    study: Study
    rig: RigSettings | None = None
    out: Path | None = None

    @property
    def required_rig(self) -> RigSettings:
        """The devices.

        Raises:
            InputError: The file has none.
        """
        if self.rig is None:
            raise InputError("[stage]", None, "such a table is needed")
        return self.rig


def read_study(path: Path) -> StudyFile:
    """Read a study. ``tacbench acquire --init FILE.toml`` writes one with every key explained.

    Args:
        path: The file; texture files and calibrations in it, and ``out``, are found from its folder.

    Raises:
        InputError: The file cannot be read, or something in it is not allowed; the message names key and value.
    """
    return read_toml(path, "study", lambda document: _study_file(document, path.parent))


def virtual_study(
    *,
    texture: str = "1",
    preset: str = "paper",
    scale: float = 1.0,
    driver: str = "virtual-grbl",
    speed: float = 50.0,
    out: Path | None = None,
    printer: str = "bambu-p1p",
    filament: str = "pla-minus",
) -> StudyFile:
    """One block on a rig of which every part is simulated; the drivers are the real ones.

    Args:
        texture: Number, name or file of the texture.
        preset: ``paper`` or ``released``.
        scale: The block's scale.
        driver: ``virtual-grbl`` or ``virtual-marlin``.
        speed: How many times faster than real time the rig runs.
        out: Where the run folder goes.
        printer: The virtual printer that made the block.
        filament: Its filament.

    Raises:
        InputError: A value is not allowed.
    """
    document: dict[str, Any] = {
        "block": {"texture": texture, "preset": preset, "scale": scale, "printer": printer, "filament": filament},
        "stage": {"driver": driver, "options": {"speed": speed}},
        "gauge": {"driver": "serial", "port": "virtual"},
        "sensor": {"driver": "simulated"},
    }
    if driver not in VIRTUAL_ORIGINS_MM:
        raise InputError("driver", driver, "allowed: " + ", ".join(VIRTUAL_ORIGINS_MM))
    made = _study_file(Table(document), Path())
    return StudyFile(study=made.study, rig=made.rig, out=out)


def _study_file(document: Table, folder: Path) -> StudyFile:
    document.only("out", "block", "study", "holder", "protocol", "stage", "gauge", "sensor")
    out = document.text("out", None)
    if ("block" in document) == ("study" in document):
        raise InputError("[block], [study]", None, "exactly one of these tables is needed")
    one = document.table("block" if "block" in document else "study")
    layouts = one.only("layouts").texts("layouts") if "layouts" in one and "study" in document else ()
    plates = tuple(printed for word in layouts for printed in read_layout(folder / word))
    preset = one.text("preset", "paper", PRESETS)
    scale = _common_scale(plates) if plates else one.number("scale", 1.0, 0.01, 100.0)
    table = document.table("protocol", required=False)
    grid, spacing = _grid(table, scale)
    protocol = _protocol(table, grid)
    levels = tuple(range(1, protocol.levels + 1))
    if plates:
        blocks = tuple(PlannedBlock(printed=printed, levels=levels) for printed in plates)
    elif "block" in document:
        blocks = (PlannedBlock(printed=_one_block(one, preset, scale, folder), levels=levels),)
    else:
        blocks = _many_blocks(one, preset, scale, folder, levels)
    holder = document.table("holder", required=False).only("rim_mm", "gap_mm")
    rim = _made("[holder] ", HolderRim, {key: holder.number(key) for key in holder.values})
    study = Study(blocks=blocks, protocol=protocol, holder=rim, grid_spacing=spacing)
    rig = None
    if "stage" in document or "sensor" in document or "gauge" in document:
        stage = _stage(document.table("stage"))
        gauge = _gauge(document.table("gauge", required=False), stage, folder)
        rig = RigSettings(stage=stage, gauge=gauge, sensor=_sensor(document.table("sensor")), holder=rim)
        if protocol.contact == "force" and gauge.driver == "none":
            raise InputError(
                "[gauge] driver", "none", 'contact = "force" needs a gauge; without one use contact = "depth"'
            )
        if protocol.contact == "depth" and protocol.touch == "gauge" and gauge.driver == "none":
            raise InputError("[protocol] touch", "gauge", 'needs a gauge; without one use "sensor" or "taught"')
    return StudyFile(study=study, rig=rig, out=folder / out if out is not None else None)


def _common_scale(plates: tuple[PrintedBlock, ...]) -> float:
    """The one scale of all blocks: the press grid has it, too."""
    scales = sorted({printed.block.scale for printed in plates})
    if len(scales) > 1:
        raise InputError("[study] layouts", scales, "hold blocks of several scales; a study has one")
    return scales[0]


def _one_block(table: Table, preset: str, scale: float, folder: Path) -> PrintedBlock:
    table.only("texture", "preset", "scale", "key_mm", "printer", "filament", "copy")
    texture = table.values.get("texture")
    word = str(texture) if type(texture) is int else table.text("texture")
    return PrintedBlock(
        block=block_of_word(word, preset, scale, table.number("key_mm", None), folder),
        printer=names.own_name("printer", table.text("printer")),
        filament=names.own_name("filament", table.text("filament")),
        copy=table.whole("copy", 1, 1, 999),
    )


def _many_blocks(
    table: Table, preset: str, scale: float, folder: Path, levels: tuple[int, ...]
) -> tuple[PlannedBlock, ...]:
    table.only("textures", "prints", "preset", "scale", "key_mm")
    words = table.texts("textures", tuple("123456"))
    key = table.number("key_mm", None)
    blocks = [block_of_word(word, preset, scale, key, folder) for word in words]
    planned = []
    for one in table.tables("prints"):
        one.only("printer", "filament", "copies", "force_levels")
        printer = names.own_name("printer", one.text("printer"))
        filament = names.own_name("filament", one.text("filament"))
        chosen = _whole_numbers(one, "force_levels", levels)
        for copy in _copies(one):
            for block in blocks:
                printed = PrintedBlock(block=block, printer=printer, filament=filament, copy=copy)
                planned.append(PlannedBlock(printed=printed, levels=chosen))
    return tuple(planned)


def _copies(table: Table) -> tuple[int, ...]:
    """``copies = 3`` means 1, 2 and 3; a list names them."""
    if isinstance(table.values.get("copies"), list):
        return _whole_numbers(table, "copies", ())
    return tuple(range(1, table.whole("copies", 1, 1, 999) + 1))


def _whole_numbers(table: Table, key: str, default: tuple[int, ...]) -> tuple[int, ...]:
    numbers = table.numbers(key, None, None)
    if numbers is None:
        return default
    if any(one != int(one) or one < 1 for one in numbers) or list(numbers) != sorted(set(numbers)):
        raise InputError(f"{table.where}{key}", list(numbers), "must be whole numbers from 1, rising")
    return tuple(int(one) for one in numbers)


def _grid(table: Table, scale: float) -> tuple[PressGrid, str]:
    """The press grid, scaled with the block, and which one it is."""
    found = table.values.get("grid", "even")
    if not isinstance(found, Mapping):
        spacing = table.text("grid", "even", ("even", "1mm"))
        return PressGrid.paper(scale, spacing), spacing
    own = Table(found, "[protocol] grid ").only("x_mm", "y_mm")
    lines = []
    for key in ("x_mm", "y_mm"):
        values = own.numbers(key, None)
        if list(values) != sorted(set(values)) or values[0] < 0.0:
            raise InputError(f"[protocol] grid {key}", list(values), "must rise, from 0 or more")
        lines.append(tuple(scale * one for one in values))
    return PressGrid(x_mm=lines[0], y_mm=lines[1]), "own"


def _protocol(table: Table, grid: PressGrid) -> Protocol:
    known = [one.name for one in fields(Protocol)]
    table.only(*known)
    readers: dict[str, Callable[[str], Any]] = {
        "contact": lambda key: table.text(key, allowed=("force", "depth")),
        "touch": lambda key: table.text(key, allowed=("gauge", "sensor", "taught")),
        "order": lambda key: table.text(key, allowed=("paper", "random")),
        "block_order": lambda key: table.text(key, allowed=("paper", "random")),
        **{key: lambda key: table.numbers(key, None) for key in ("forces_n", "bands_n", "depths_mm")},
        **{
            key: lambda key: table.whole(key)
            for key in ("repeats", "seed", "stationary_frames", "search_steps", "misses_allowed")
        },
    }
    values = {key: readers.get(key, table.number)(key) for key in table.values if key != "grid"}
    if "forces_n" in values and "bands_n" not in values:
        raise InputError("[protocol] bands_n", None, "is missing; forces of your own need bands of their own")
    return _made("[protocol] ", Protocol, {**values, "grid": grid})


def _stage(table: Table) -> StageSettings:
    table.only(
        *("driver", "port", "baud", "origin_mm", "quarter_turns", "limits_mm", "travel_mm_s", "approach_mm_s"),
        *("slots_mm", "home", "timeout_s", "options"),
    )
    driver = _driver(table, STAGES)
    origin, limits = VIRTUAL_ORIGINS_MM.get(driver), VIRTUAL_LIMITS_MM.get(driver)
    values: dict[str, Any] = {
        "driver": driver,
        "port": table.text("port", None),
        "baud": table.whole("baud", None, 300, 10_000_000),
        "origin_mm": table.numbers("origin_mm", 3) if origin is None else table.numbers("origin_mm", 3, origin),
        "quarter_turns": table.whole("quarter_turns", 0, 0, 3),
        "limits_mm": table.rows("limits_mm", 3, 2) if limits is None else table.rows("limits_mm", 3, 2, limits),
        "home": table.flag("home", True),
        "options": _options(table),
    }
    for key in ("travel_mm_s", "approach_mm_s", "timeout_s"):
        if key in table:
            values[key] = table.number(key)
    if "slots_mm" in table:
        values["slots_mm"] = table.rows("slots_mm", None, 3)
    return _made("[stage] ", StageSettings, values)


def _gauge(table: Table, stage: StageSettings, folder: Path) -> GaugeSettings:
    table.only("driver", "port", "baud", "calibration", "timeout_s", "options")
    driver = _driver(table, GAUGES) if table.values else "none"
    port, calibration = table.text("port", None), table.text("calibration", None)
    if port == "virtual" and not stage.is_virtual:
        raise InputError("[gauge] port", port, "the virtual load cell belongs to a virtual stage; name a port")
    return GaugeSettings(
        driver=driver,
        port=port,
        baud=table.whole("baud", None, 300, 10_000_000),
        calibration=None if calibration is None else str(folder / calibration),
        timeout_s=table.number("timeout_s", 2.0, 0.1, 600.0),
        options=_options(table),
    )


def _sensor(table: Table) -> SensorSettings:
    """Keys beside driver and device are settings of the driver, which knows them by name."""
    driver = _driver(table, SENSORS)
    options = {key: value for key, value in table.values.items() if key not in ("driver", "device")}
    return SensorSettings(driver=driver, device=table.text("device", None), options=options)


def _driver(table: Table, known: tuple[str, ...]) -> str:
    """A driver with a name of its own, or ``module:name``."""
    driver = table.text("driver")
    if ":" in driver:
        return str(driver)
    return str(table.text("driver", allowed=(*known, "module:name")))


def _options(table: Table) -> dict[str, Any]:
    found = table.values.get("options", {})
    if not isinstance(found, Mapping):
        raise InputError(f"{table.where}options", found, "must be a table")
    return dict(found)


def _made(where: str, kind: Callable[..., T], values: Mapping[str, Any]) -> T:
    """A value whose own errors come out with the table's name in front."""
    try:
        return kind(**values)
    except InputError as error:
        raise InputError(f"{where}{error.field}", error.value, error.allowed) from None
