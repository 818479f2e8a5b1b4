"""``tacbench test-driver``: check a driver on its device."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from tacbench_cad.cli import ask_line, options, print_json, print_lines, print_table
from tacbench_cad.util.errors import InputError, TacbenchError, one_line
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.extensions.conformance.checks import DriverCheck
    from tacbench_cad.lab.rig import Kind

KINDS = ("stage", "gauge", "sensor")


@options.command("test-driver", "Press")
@options.argument("driver", options.text("DRIVER"), "Name of a driver, or module:name.")
@options.option(
    "--set",
    options.text("KEY=VALUE"),
    "A key of the device's table in a study file, for example port=/dev/ttyUSB0 or options.speed=20. Can be repeated.",
    options.INPUT,
    dest="keys",
    multiple=True,
)
@options.option("--kind", options.choice(*KINDS), "Kind of device, if the driver does not show it.", options.INPUT)
@options.option(
    "--beyond",
    options.coordinates("X,Y,Z"),
    "Position in mm beyond the stage's own limits, which its firmware must refuse.",
    options.METHOD,
)
@options.option(
    "--mass-g",
    options.NUMBER,
    "A known mass in g, which you put on the gauge when the command asks for it.",
    options.METHOD,
)
@options.json
def command(
    driver: str,
    keys: tuple[str, ...],
    kind: Kind | None,
    beyond: tuple[float, float, float] | None,
    mass_g: float | None,
    json: bool,
) -> None:
    """Check a driver on its device, and list what is missing.

    The command uses the device as a run does. It checks the identity, the units, that a move waits until the stage has
    arrived, a stop in the middle of a move, errors, recovery and times. If the driver fails a check, the exit code is
    1. Some checks need --beyond or --mass-g.

    A stage is homed and moves by 5 mm along each axis. Remove the block and the sensor first.

    Examples:
      tacbench test-driver virtual-grbl --beyond 0,0,500
      tacbench test-driver serial --set port=/dev/ttyUSB1 --mass-g 100
      tacbench test-driver my_skin:Skin --set device=bus-3
    """
    if mass_g is not None and not 1.0 <= mass_g <= 10_000.0:
        raise InputError("mass g", mass_g, "must be from 1 to 10000 g")
    chosen = kind or _kind_of(driver)
    checks = _checked(chosen, driver, _values(keys), beyond, mass_g)
    failed = [check.name for check in checks if check.result == "failed"]
    if json:
        from tacbench_cad.util.convert import to_plain

        print_json({"driver": driver, "kind": chosen, "passed": not failed, "checks": to_plain(checks)})
    else:
        rows = [(check.name, check.result, check.detail) for check in checks]
        print_table(f"{chosen} {driver}", ("check", "result", "detail"), rows)
        tested = [check for check in checks if check.result != "not tested"]
        missing = f"; failed: {', '.join(dict.fromkeys(failed))}" if failed else ""
        print_lines(f"{len(tested) - len(failed)} of {counted(len(tested), 'check')} passed{missing}")
    if failed:
        raise Exit(1)


def _checked(
    kind: Kind,
    driver: str,
    values: Mapping[str, Any],
    beyond: tuple[float, float, float] | None,
    mass_g: float | None,
) -> Sequence[DriverCheck]:
    """Open the device and check it. An exception of the driver while it is opened is a failed check."""
    from tacbench_cad.extensions.conformance.checks import DriverCheck, check_gauge, check_sensor
    from tacbench_cad.extensions.conformance.stage import check_stage
    from tacbench_cad.lab.rig import Clock, Context, find_driver, open_device
    from tacbench_cad.lab.study import GaugeSettings, SensorSettings, StageSettings
    from tacbench_cad.util.convert import from_plain

    clock, table, found = Clock(), dict(values), find_driver(kind, driver)
    settings: StageSettings | GaugeSettings | SensorSettings
    if kind == "stage":
        settings = from_plain(StageSettings, {"driver": driver, **found.defaults, **table}, "[stage] ")
    elif kind == "gauge":
        settings = from_plain(GaugeSettings, {"driver": driver, **table}, "[gauge] ")
    else:
        device = {key: table.pop(key) for key in ("device", "channels") if key in table}
        settings = from_plain(SensorSettings, {"driver": driver, **device, "options": table}, "[sensor] ")
    try:
        opened = open_device(kind, settings, Context(clock=clock), guarded=False)
    except TacbenchError:
        raise
    except Exception as error:
        detail = f"raised {type(error).__name__} instead of a RigError: {one_line(error, 120)}"
        return (DriverCheck(name="open", result="failed", detail=detail),)
    if isinstance(settings, StageSettings):
        if found.simulated:
            clock = opened.clock
        else:
            try:
                ask_line("The stage will be homed and moved. Remove block and sensor, then press Enter: ", err=True)
            except BaseException:
                with suppress(Exception):
                    opened.close()
                raise
        return check_stage(opened, settings.limits_mm, clock, beyond_mm=beyond)
    if kind == "gauge":
        load = None if mass_g is None else _ask_for_mass
        return check_gauge(opened, clock, load=load, mass_g=mass_g or 100.0)
    return check_sensor(opened, clock, getattr(settings, "channels", None))


def _ask_for_mass(mass_g: float) -> None:
    task = f"Put {mass_g:g} g on the gauge" if mass_g else "Remove the mass"
    ask_line(f"{task}, wait until nothing moves, then press Enter: ", err=True)


def _kind_of(driver: str) -> Kind:
    """Return the kind of device of a driver: by its name, or by the methods of the class."""
    from tacbench_cad.lab.rig import plugin, registry

    fitting: list[Kind] = [kind for kind in registry.GROUPS if driver in registry.drivers(kind)]
    if plugin.is_plugin(driver):
        loaded = plugin.load(driver)
        methods: dict[Kind, str] = {"stage": "move", "gauge": "tare", "sensor": "read"}
        fitting = [kind for kind, method in methods.items() if hasattr(loaded, method)][:1]
    elif not fitting:
        known = ", ".join(name for kind in registry.GROUPS for name in registry.drivers(kind))
        raise InputError("driver", driver, f"is not a driver; allowed: {known}, module:name")
    if len(fitting) != 1:
        raise InputError("kind", None, f"is required for {driver}: stage, gauge or sensor")
    return fitting[0]


def _values(keys: tuple[str, ...]) -> dict[str, Any]:
    """Read ``KEY=VALUE`` as a line of a TOML file. A value that is not TOML is a text."""
    values: dict[str, Any] = {}
    for text in keys:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            raise InputError("set", text, "must be KEY=VALUE")
        try:
            item = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            item = value
        *tables, last = key.strip().split(".")
        place = values
        for table in tables:
            place = place.setdefault(table, {})
            if not isinstance(place, dict):
                raise InputError("set", text, f"{table} is not a table")
        place[last] = item
    return values
