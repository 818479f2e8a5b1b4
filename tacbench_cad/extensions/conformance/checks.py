"""Conformance checks of a driver: what the rest of the program relies on, tried on the device itself.

This module has the parts that all devices share, and the checks of gauges and sensors;
:mod:`tacbench_cad.extensions.conformance.stage` has those of stages. The device is used without the wrapper that turns
every exception of a user's driver into an error of the rig, since the wrapper would hide what the driver raises.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tacbench_cad.lab.rig import NEEDED, RESULTS, Channels, Clock, Closing, Force, Kind, RigError, channels_fault
from tacbench_cad.util.errors import one_line

Result = Literal["passed", "failed", "not tested"]
#: The averaging time of a force, in s of rig time.
WINDOW_S = 0.5
#: The longest time, in s of real time, that a device may need in addition to its own work.
SLACK_S = 2.0
#: The acceleration of free fall in m/s^2.
GRAVITY = 9.80665
#: The allowed relative error of a force under a known mass.
FORCE_ERROR = 0.05
#: The factors by which a value in newtons differs from one in another unit.
FORCE_UNITS = {"grams": 1000.0 / GRAVITY, "kilograms": 1.0 / GRAVITY, "pounds": 0.224809, "millinewtons": 1000.0}
#: The number of frames that are compared with each other.
FRAMES = 8


@dataclass(frozen=True, kw_only=True)
class DriverCheck:
    """The result of one check.

    Args:
        name: The name of the check, one or two words.
        result: Whether the driver passed it.
        detail: The measured values, or what is missing.
    """

    name: str
    result: Result
    detail: str


class Checks:
    """The results so far, in order. A failed check does not end the others."""

    def __init__(self) -> None:
        self.results: list[DriverCheck] = []

    def passed(self, name: str, detail: str = "") -> None:
        """Add a check that the driver passed."""
        self.results.append(DriverCheck(name=name, result="passed", detail=detail))

    def failed(self, name: str, detail: str) -> None:
        """Add a check that the driver did not pass."""
        self.results.append(DriverCheck(name=name, result="failed", detail=detail))

    def not_tested(self, name: str, why: str) -> None:
        """Add a check that was not possible."""
        self.results.append(DriverCheck(name=name, result="not tested", detail=why))

    def require(self, name: str, ok: bool, good: str, bad: str) -> bool:
        """Add a check with one of two texts, and return whether the driver passed it."""
        (self.passed if ok else self.failed)(name, good if ok else bad)
        return ok

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Let an exception of the driver in the body fail a check, and end the body."""
        try:
            yield
        except RigError as error:
            self.failed(name, one_line(error))
        except Exception as error:
            self.failed(name, _raised(error))

    def refused(self, name: str, call: Callable[[], Any], what: str) -> bool:
        """Check that the driver refuses a call with an error of the rig.

        Args:
            name: The name of the check.
            call: Calls the driver.
            what: The call, for the text.
        """
        try:
            result = call()
        except RigError as error:
            self.passed(name, f"{what}: {type(error).__name__}")
            return True
        except Exception as error:
            self.failed(name, f"{what}: {_raised(error)}")
            return False
        self.failed(name, f"{what}: returned {result!r:.60} without an error")
        return False


def check_interface(checks: Checks, kind: Kind, device: Any) -> bool:
    """Check the attributes of a device, and return whether it has all of them."""
    missing = [name for name in NEEDED[kind] if not hasattr(device, name)]
    if not checks.require("interface", not missing, "", f"lacks {', '.join(missing)}"):
        return False
    name = "name" if kind == "sensor" else "identity"
    identity, simulated = getattr(device, name), device.simulated
    good = isinstance(identity, str) and identity.strip() != "" and isinstance(simulated, str)
    shown = f"{identity}" + (f" (simulated: {simulated})" if simulated else "")
    checks.require("identity", good, shown, f"{name} and simulated must be texts, {name} not empty")
    managed = hasattr(device, "__enter__") and hasattr(device, "__exit__")
    checks.require("context", managed, "", "is not a context manager; derive the class from Closing")
    return True


def check_close(checks: Checks, kind: Kind, device: Any) -> None:
    """Close the device twice, and check that it refuses work afterwards, if it has something to close."""
    if type(device).close is Closing.close:
        checks.not_tested("close", "the driver has no close() of its own, which a device with a connection needs")
        return
    for _ in range(2):
        try:
            device.close()
        except Exception as error:
            checks.failed("close", f"close() {_raised(error)}")
            return
    calls = {"stage": "position", "gauge": "read", "sensor": "read"}
    arguments = (WINDOW_S,) if kind == "gauge" else ()
    name = calls[kind]
    checks.refused("close", lambda: getattr(device, name)(*arguments), f"{name}() after close()")


def check_gauge(
    gauge: Any, clock: Clock, *, load: Callable[[float], None] | None = None, mass_g: float = 100.0
) -> Sequence[DriverCheck]:
    """Check a gauge. Nothing may press on it at the start.

    Args:
        gauge: The open gauge; it is closed at the end.
        clock: The rig's time.
        load: Puts a mass in g on the gauge, and returns when it rests; None if nobody can.
        mass_g: The known mass.
    """
    checks = Checks()
    if check_interface(checks, "gauge", gauge):
        with checks.step("read"):
            _check_force(checks, gauge, clock)
        if load is None:
            for name in ("sign", "unit", "fresh samples"):
                checks.not_tested(name, "needs a known mass; name it with --mass-g")
        else:
            with checks.step("fresh samples"):
                _check_load(checks, gauge, load, mass_g)
        check_close(checks, "gauge", gauge)
    with suppress(Exception):
        gauge.close()
    return checks.results


def _check_force(checks: Checks, gauge: Any, clock: Clock) -> None:
    began_s = clock.now_s()
    force = gauge.read(WINDOW_S)
    took_s = clock.now_s() - began_s
    good = isinstance(force, Force) and all(map(math.isfinite, (force.mean_n, force.spread_n)))
    if not checks.require(
        "read",
        good and force.samples >= 1 and force.spread_n >= 0.0,
        f"{force}" if not good else f"{force.mean_n:.4f} N, standard deviation {force.spread_n:.4f} N",
        f"read() returned {force!r:.80} instead of a Force with finite numbers and at least one sample",
    ):
        return
    checks.require(
        "window",
        took_s >= 0.9 * WINDOW_S,
        f"{force.samples} samples in {took_s:.2f} s",
        f"read({WINDOW_S:g}) returned after {took_s:.3f} s, so it used samples from before the call",
    )
    late_s = (took_s - WINDOW_S) / clock.speed
    checks.require("timing", late_s <= SLACK_S, f"{1000 * late_s:.0f} ms late", f"took {took_s:.1f} s")
    with checks.step("tare"):
        gauge.tare()
        zero_n = gauge.read(WINDOW_S).mean_n
        near = abs(zero_n) <= max(0.02, 3.0 * force.spread_n)
        checks.require("tare", near, f"{zero_n:.4f} N afterwards", f"{zero_n:.4f} N after tare()")


def _check_load(checks: Checks, gauge: Any, load: Callable[[float], None], mass_g: float) -> None:
    expected_n = GRAVITY * mass_g / 1000.0
    empty = gauge.read(WINDOW_S)
    load(mass_g)
    loaded = gauge.read(WINDOW_S)
    load(0.0)
    free = gauge.read(WINDOW_S)
    shown = f"{empty.mean_n:.4f} N, {loaded.mean_n:.4f} N under {mass_g:g} g, {free.mean_n:.4f} N without it"
    change_n, left_n = loaded.mean_n - empty.mean_n, abs(free.mean_n - empty.mean_n)
    if max(abs(change_n), left_n) < 0.05 * expected_n:
        checks.failed("unit", f"the force did not change with the mass: {shown}")
        return
    if not checks.require("fresh samples", left_n < 0.2 * abs(change_n), shown, f"the force is late: {shown}"):
        return
    checks.require("sign", change_n > 0.0, "positive in compression", f"is negative in compression: {shown}")
    ratio = abs(change_n) / expected_n
    unit = next((name for name, factor in FORCE_UNITS.items() if abs(ratio / factor - 1.0) < FORCE_ERROR), "")
    wrong = f"{ratio:.4g} times the weight of {expected_n:.4f} N" + (f"; are these {unit}?" if unit else "")
    checks.require("unit", abs(ratio - 1.0) < FORCE_ERROR, f"{change_n:.4f} N for {expected_n:.4f} N", wrong)


def check_sensor(sensor: Any, clock: Clock, channels: Channels | None = None) -> Sequence[DriverCheck]:
    """Check a sensor.

    Args:
        sensor: The open sensor; it is closed at the end.
        clock: The rig's time.
        channels: The order of its colours, if the study file states it.
    """
    checks = Checks()
    if check_interface(checks, "sensor", sensor):
        _check_settings(checks, sensor)
        fault = channels_fault(sensor, channels)
        checks.require(
            "colours", not fault, str(channels or getattr(sensor, "channels", None) or ""), f"channels {fault}"
        )
        with checks.step("read"):
            _check_frames(checks, sensor, clock)
        check_close(checks, "sensor", sensor)
    with suppress(Exception):
        sensor.close()
    return checks.results


def _check_settings(checks: Checks, sensor: Any) -> None:
    checks.require(
        "units", isinstance(sensor.units, str) and sensor.units != "", f"{sensor.units}", "units must be a text"
    )
    try:
        json.dumps(sensor.settings, allow_nan=False)
        plain = isinstance(sensor.settings, dict) and {"requested", "actual"} <= set(sensor.settings)
    except (TypeError, ValueError):
        plain = False
    bad = 'settings must be {"requested": {...}, "actual": {...}} with plain values'
    checks.require("settings", plain, "", bad)


def _check_frames(checks: Checks, sensor: Any, clock: Clock) -> None:
    frames, copies, times = [], [], []
    for _ in range(FRAMES):
        began_s = clock.now_s()
        frame = RESULTS["sensor"]["read"](sensor.read())
        times.append((clock.now_s() - began_s) / clock.speed)
        frames.append(frame)
        copies.append(frame.copy())
    checks.passed("read", f"{FRAMES} frames")
    shapes = dict.fromkeys(f"{frame.shape} {frame.dtype}" for frame in copies)
    same = len(shapes) == 1 and copies[0].shape == tuple(sensor.shape)
    checks.require("shape", same, next(iter(shapes)), f"frames are {', '.join(shapes)}; shape says {sensor.shape}")
    kept = all(np.array_equal(frame, copy, equal_nan=True) for frame, copy in zip(frames, copies, strict=True))
    checks.require("memory", kept, "", "a later read() changed an earlier frame; return a copy")
    checks.require("values", all(np.isfinite(copy).all() for copy in copies), "", "some values are not finite")
    stuck = all(np.array_equal(copy, copies[0]) for copy in copies[1:])
    checks.require("fresh frames", not stuck, "", f"{FRAMES} frames in a row are identical")
    shown = f"{1000 * float(np.median(times)):.0f} ms for each frame, at most {1000 * max(times):.0f} ms"
    checks.require("timing", max(times) <= 10.0, shown, shown)
    checks.not_tested("exposure", "whether the exposure began after the call; press the sensor during a read to see")


def _raised(error: Exception) -> str:
    name = type(error).__name__
    return f"raised {name} instead of a RigError: {one_line(error, 120)}"
