"""Reading of a study's TOML file, which describes the blocks, the protocol and the rig."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Interval, Len

from tacbench_cad.lab.rig import registry
from tacbench_cad.lab.rig.registry import find_driver, simulated_stages
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.plate import block_in_file, block_of_word, read_layout
from tacbench_cad.lab.study.spec import (
    NO_GAUGE,
    Copy,
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
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.fits import clearance_mm
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util import untrusted
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError, located, one_of

Preset = Literal["paper", "released"]
Scale = Annotated[float, Interval(ge=0.01, le=100.0)]
Numbers = Annotated[tuple[Annotated[int, Ge(1)], ...], Len(1, 1000)]


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """The contents of a study's file.

    Args:
        study: The blocks and the protocol.
        rig: The devices; None if the file has none, because the study is only simulated.
        out: The folder for the run folders; None if the file does not name it.
    """

    study: Study
    rig: RigSettings | None = None
    out: Path | None = None

    @property
    def required_rig(self) -> RigSettings:
        """The devices.

        Raises:
            InputError: The file has no devices.
        """
        if self.rig is None:
            raise InputError("[stage]", None, "this table is missing")
        return self.rig

    def rehearsal(self, driver: str, speed: float) -> StudyFile:
        """Return the same study for simulated devices, with an output folder of its own.

        Args:
            driver: The driver of a simulated stage.
            speed: The speed of the rig relative to real time.

        Raises:
            InputError: The file has no devices, or the driver is not simulated.
        """
        one_of("driver", driver, simulated_stages())
        out = self.out and self.out.with_name(f"{self.out.name}-rehearsal")
        return replace(self, rig=self.required_rig.simulated(driver, speed=speed), out=out)


def read_study(path: Path, *, teaching: bool = False) -> StudyFile:
    """Read a study. ``tacbench acquire --init FILE.toml`` writes such a file with explanations.

    Args:
        path: The file. Texture files, calibrations and ``out`` are relative to its folder.
        teaching: Whether the origin may be empty, because it will be taught.

    Raises:
        InputError: The file cannot be read, or a value is empty or not allowed. The message names the key and the
            value.
    """
    document = untrusted.read_document(path, "study", "toml")
    with located(f"{path}: "):
        return _study_file(document, path.parent, teaching)


def read_alignment(path: Path, driver: Any) -> tuple[StageSettings, HolderRim]:
    """Read the place of the block, the limits and the speeds of a rig, for a stage that the file need not name.

    The port and the options in the file are only used for the driver that the file names.

    Args:
        path: A TOML file with the table ``[stage]``, and ``[holder]`` if it differs from the default: a study file, for
            example.
        driver: The stage.

    Raises:
        InputError: The file cannot be read, or a value is missing or not allowed.
    """
    plain = untrusted.read_document(path, "rig", "toml")
    with located(f"{path}: "):
        values = dict(_table(plain, "stage"))
        if driver != values.get("driver"):
            values = {key: value for key, value in values.items() if key not in ("port", "baud", "options")}
        stage = _stage({**values, "driver": driver}, teaching=False)
        return stage, from_plain(_HolderTable, _table(plain, "holder"), "[holder] ").rim


def virtual_study(
    *, texture: str = "1", driver: str = "simulated", speed: float = 50.0, out: Path | None = None
) -> StudyFile:
    """Describe a study of a single block of a virtual printer on a simulated rig.

    Args:
        texture: The number, name or file of the texture.
        driver: The driver of a simulated stage.
        speed: The speed of the rig relative to real time; 50 is 50 times faster.
        out: The folder for the run folder; None if it is unknown.

    Raises:
        InputError: A value is not allowed.
    """
    one_of("driver", driver, simulated_stages())
    document: dict[str, Any] = {
        "block": {"texture": texture, "printer": "bambu-p1p", "filament": "pla-minus"},
        "stage": {"driver": driver, "options": {"speed": speed}},
        "gauge": {"driver": "simulated"},
        "sensor": {"driver": "simulated"},
    }
    return replace(_study_file(document, Path()), out=out)


@dataclass(frozen=True, kw_only=True)
class _Prints:
    """A line of ``[study] prints``.

    ``copies`` is the number of copies (3 means copies 1, 2 and 3) or a list. ``files`` is a folder with a texture file
    for each texture, named after it, if the printed files differ from the blocks.
    """

    printer: str
    filament: str
    copies: Copy | Numbers = 1
    force_levels: Numbers | None = None
    files: str | None = None

    def __post_init__(self) -> None:
        for name, value in (("copies", self.copies), ("force_levels", self.force_levels)):
            if isinstance(value, tuple) and list(value) != sorted(set(value)):
                raise InputError(name, list(value), "must be whole numbers from 1, in increasing order")


@dataclass(frozen=True, kw_only=True)
class _Blocks:
    """The keys that ``[block]`` and ``[study]`` share."""

    where = "[study] "
    preset: Preset = "paper"
    scale: Scale = 1.0
    key_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class _StudyTable(_Blocks):
    textures: Annotated[tuple[str | int, ...], Len(1, 1000)] = tuple("123456")
    prints: Annotated[tuple[_Prints, ...], Len(1, 1000)]


@dataclass(frozen=True, kw_only=True)
class _BlockTable(_Blocks):
    where = "[block] "
    texture: str | int
    printer: str
    filament: str
    copy: Copy = 1
    files: str | None = None

    @property
    def textures(self) -> tuple[str | int, ...]:
        return (self.texture,)

    @property
    def prints(self) -> tuple[_Prints, ...]:
        copies = (self.copy,)
        return (_Prints(printer=self.printer, filament=self.filament, copies=copies, files=self.files),)


@dataclass(frozen=True, kw_only=True)
class _Layouts:
    """The table ``[study]`` with layouts of plates, which list the blocks."""

    layouts: Annotated[tuple[str, ...], Len(1, 1000)]


@dataclass(frozen=True, kw_only=True)
class _HolderTable:
    rim_mm: float = HolderRim.rim_mm
    fit: str | float = "slip"
    gap_mm: float | None = None

    @property
    def rim(self) -> HolderRim:
        gap_mm = clearance_mm(self.fit) if self.gap_mm is None else self.gap_mm
        return HolderRim(rim_mm=self.rim_mm, gap_mm=gap_mm)


@dataclass(frozen=True, kw_only=True)
class _Grid:
    x_mm: Annotated[tuple[float, ...], Len(1, 1000)]
    y_mm: Annotated[tuple[float, ...], Len(1, 1000)]

    def __post_init__(self) -> None:
        for name, values in (("x_mm", self.x_mm), ("y_mm", self.y_mm)):
            if list(values) != sorted(set(values)) or values[0] < 0.0:
                raise InputError(name, list(values), "must be numbers from 0, in increasing order")

    def scaled(self, scale: float) -> PressGrid:
        """Return the grid of a scaled block."""
        return PressGrid(x_mm=tuple(scale * x for x in self.x_mm), y_mm=tuple(scale * y for y in self.y_mm))


@dataclass(frozen=True, kw_only=True)
class _Document:
    """The whole file. Tables that depend on other tables are read afterwards."""

    holder: _HolderTable = field(default_factory=_HolderTable)
    stage: Mapping[str, Any] | None = None
    gauge: Mapping[str, Any] | None = None
    sensor: Mapping[str, Any] | None = None
    out: str | None = None
    block: _BlockTable | None = None
    study: Mapping[str, Any] = field(default_factory=dict)
    protocol: Mapping[str, Any] = field(default_factory=dict)


def _study_file(plain: Mapping[str, Any], folder: Path, teaching: bool = False) -> StudyFile:
    _require_filled(plain, "[stage] origin_mm" if teaching else "")
    if ("block" in plain) == ("study" in plain):
        raise InputError("[block], [study]", None, "exactly one of these tables is needed")
    document = from_plain(_Document, plain)
    kind: type[_Layouts | _StudyTable] = _Layouts if "layouts" in document.study else _StudyTable
    table = document.block or from_plain(kind, document.study, "[study] ")
    plates: tuple[PrintedBlock, ...] = ()
    if isinstance(table, _Layouts):
        plates = tuple(printed for word in table.layouts for printed in read_layout(folder / word))
        scale = _common_scale(plates)
    else:
        scale = table.scale
    protocol, spacing = _protocol(document.protocol, scale)
    if isinstance(table, _Layouts):
        blocks = tuple(PlannedBlock(printed=printed, levels=protocol.all_levels) for printed in plates)
    else:
        blocks = tuple(_planned(table, protocol.all_levels, folder))
    with located("[holder] "):
        rim = document.holder.rim
    study = Study(blocks=blocks, protocol=protocol, holder=rim, grid_spacing=spacing)
    rig = None
    if not (document.stage is document.gauge is document.sensor is None):
        rig = _rig(document, rim, protocol, folder, teaching)
    out = folder / document.out if document.out is not None else None
    return StudyFile(study=study, rig=rig, out=out)


def _require_filled(plain: Mapping[str, Any], may_be_empty: str) -> None:
    """Check that the user has filled in all keys.

    Raises:
        InputError: Some keys are empty. The message names all of them.
    """
    own_sensor = ":" in str(_table(plain, "sensor").get("driver"))
    empty = [
        name
        for table in ("block", "stage", "gauge", *(() if own_sensor else ("sensor",)))
        for key, value in _table(plain, table).items()
        if value in ("", []) and (name := f"[{table}] {key}") != may_be_empty
    ]
    if empty:
        raise InputError(
            ", ".join(empty), None, "must be filled in, because only you know these values of your block and rig"
        )


def _table(plain: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    values = plain.get(name)
    return values if isinstance(values, Mapping) else {}


def _common_scale(plates: tuple[PrintedBlock, ...]) -> float:
    """Return the scale of all blocks, which is also the scale of the press grid."""
    scales = sorted({printed.block.scale for printed in plates})
    if len(scales) > 1:
        raise InputError("[study] layouts", scales, "have blocks of several scales; a study must have only one")
    return scales[0]


def _planned(table: _BlockTable | _StudyTable, levels: tuple[int, ...], folder: Path) -> Iterable[PlannedBlock]:
    with located(table.where):
        blocks = [block_of_word(word, table.preset, table.scale, table.key_mm, folder) for word in table.textures]
        for each in table.prints:
            printer, filament = names.own_name("printer", each.printer), names.own_name("filament", each.filament)
            files: list[Block | None] = [None] * len(blocks)
            if each.files is not None:
                paths = [folder / each.files / f"{block.texture.name}.toml" for block in blocks]
                files = [block_in_file(block, path) for block, path in zip(blocks, paths, strict=True)]
            for copy in range(1, each.copies + 1) if isinstance(each.copies, int) else each.copies:
                for block, file in zip(blocks, files, strict=True):
                    printed = PrintedBlock(block=block, printer=printer, filament=filament, copy=copy, file=file)
                    yield PlannedBlock(printed=printed, levels=each.force_levels or levels)


def _protocol(plain: Mapping[str, Any], scale: float) -> tuple[Protocol, str]:
    """Return the protocol and the name of its press grid, which is scaled with the block."""
    values = dict(plain)
    positions = dict(_table(plain, "positions"))
    grid = positions.get("grid", "even")
    if isinstance(grid, str):
        spacing = one_of("[protocol.positions] grid", grid, ("even", "1mm"))
        positions["grid"] = PressGrid.paper(scale, spacing)  # type: ignore[arg-type]
    else:
        spacing = "own"
        positions["grid"] = from_plain(_Grid, grid, "[protocol.positions] grid ").scaled(scale)
    if isinstance(values.get("positions", {}), Mapping):
        values["positions"] = positions
    if isinstance(motion := values.get("motion"), Mapping):
        # All other keys are settings of the motion.
        own = {key: value for key, value in motion.items() if key in ("name", "frames")}
        values["motion"] = {**own, "options": {key: value for key, value in motion.items() if key not in own}}
    targets = _table(plain, "targets")
    if "forces_n" in targets and "bands_n" not in targets:
        raise InputError(
            "[protocol.targets] bands_n", None, "is missing; with forces_n, also give a band for each force"
        )
    return from_plain(dict[str, Protocol], {"protocol": values})["protocol"], spacing


def _rig(document: _Document, rim: HolderRim, protocol: Protocol, folder: Path, teaching: bool) -> RigSettings:
    tables: tuple[tuple[registry.Kind, Mapping[str, Any] | None, tuple[str, ...]], ...] = (
        ("stage", document.stage, ()),
        ("gauge", document.gauge or {}, (NO_GAUGE,)),
        ("sensor", document.sensor, ()),
    )
    for kind, table, words in tables:
        if table is None:
            raise InputError(f"[{kind}]", None, "this table is missing")
        driver = table.get("driver", NO_GAUGE)
        if not isinstance(driver, str):
            raise InputError(f"[{kind}] driver", driver, "must be a text")
        # An unknown driver is reported before keys that are missing because of it.
        if "driver" in table and ":" not in driver and driver not in words:
            one_of(f"[{kind}] driver", driver, (*registry.drivers(kind), *words, "module:name"))
    stage = _stage(document.stage or {}, teaching)
    gauge = from_plain(GaugeSettings, document.gauge or {}, "[gauge] ")
    if gauge.calibration is not None:
        gauge = replace(gauge, calibration=str(folder / gauge.calibration))
    # All other keys are settings of the driver.
    values = dict(document.sensor or {})
    own = {key: values.pop(key) for key in ("driver", "device", "channels") if key in values}
    sensor = from_plain(SensorSettings, {**own, "options": values}, "[sensor] ")
    rig = RigSettings(stage=stage, gauge=gauge, sensor=sensor, holder=rim)
    rig.require_gauge_for(protocol)
    return rig


def _stage(plain: Mapping[str, Any], teaching: bool) -> StageSettings:
    driver = plain.get("driver")
    values = dict(plain)
    if isinstance(driver, str) and ":" not in driver and not {"origin_mm", "limits_mm"} <= values.keys():
        values = {**find_driver("stage", driver).defaults, **plain}
    if teaching and not values.get("origin_mm"):
        values["origin_mm"] = (0.0, 0.0, 0.0)
    stage = from_plain(StageSettings, values, "[stage] ")
    if "origin_mm" not in values:
        raise InputError("[stage] origin_mm", None, "is missing; `tacbench rig align` finds these 3 numbers")
    return stage
