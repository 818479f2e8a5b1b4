"""A stage controlled by Klipper, through the HTTP interface of Moonraker.

Frame: the stage's coordinates are those of Klipper's tool head, which homing derives from the end stops. A bed mesh, a
G-code offset or a ``G92`` would shift the moves. The driver compares the position of the tool head with the target
after each move, so that such a shift is an error and never a wrong press.

Proof of a move: ``M400`` returns when the queue of moves is empty, and ``motion_report`` then gives the position from
the motors' steps. Klipper counts motor steps and cannot detect lost steps. After a restart of Klipper no axis is homed,
and every move is refused until :meth:`KlipperStage.home` has succeeded.

Lost steps show when the stage is homed again: Klipper's controller counts all steps since its reset, also those of
homing (``GET_POSITION``), and it reaches the end stops at another count than before. This needs a kinematics with one
motor for each axis (``cartesian``).

``stop()`` in the middle of a move is Klipper's emergency stop, because Klipper cannot interrupt a move in another way.
It switches the motors off. :meth:`KlipperStage.home` restarts the firmware and homes again.

Homing is ``G28``. If z is homed towards the bed, the section ``[homing_override]`` or ``[safe_z_home]`` of printer.cfg
must lift the tool first. An axis that is homed already is lifted by the driver.

Moonraker's documentation describes the interface in its part on the external API.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import math
import re
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.lab.rig import (
    AlarmError,
    Clock,
    Closing,
    Context,
    DeviceLostError,
    Driver,
    NoAnswerError,
    OutOfRangeError,
    PositionLostError,
    RigError,
    no_report,
)
from tacbench_cad.lab.study import Point, StageSettings
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError, one_line

#: The longest wait for the answer to an emergency stop, in s.
STOP_S = 2.0
#: The longest restart of the firmware, and the pause between two questions, in s.
RESTART_S, POLL_S = 30.0, 0.05
#: The time after which Klipper switches idle motors off, in s.
IDLE_S = 604_800
#: A move may take this many times its distance divided by its speed.
SLOWNESS = 3.0
#: The smallest way, in mm, from which the length of a motor step is computed.
MIN_WAY_MM = 1.0
#: The number of recent messages among which the answer to ``GET_POSITION`` is looked for.
MESSAGES = 50
#: The time, in s of rig time, in which the last step after ``M400`` is executed.
LAST_STEP_S = 1.0


@dataclass(frozen=True, kw_only=True)
class KlipperOptions:
    """The options of Klipper in ``[stage.options]``.

    Args:
        home_timeout_s: The longest homing, in s of real time.
        home_lift_mm: The height by which a homed z axis is lifted before homing.
        tolerance_mm: The allowed distance of a coordinate from its target, in mm.
        api_key: Moonraker's key; empty if this computer is one of its trusted clients.
    """

    home_timeout_s: Annotated[float, Interval(ge=1.0, le=3600.0)] = 120.0
    home_lift_mm: Annotated[float, Interval(ge=0.0, le=500.0)] = 5.0
    tolerance_mm: Annotated[float, Interval(ge=1e-4, le=1.0)] = 0.005
    api_key: str = ""


@dataclass(frozen=True, kw_only=True)
class Count:
    """The counted steps of the motor of an axis, and its position in mm."""

    steps: int
    mm: float


class KlipperStage(Closing):
    """A three-axis stage with Klipper. See :class:`tacbench_cad.lab.rig.stage.Stage` and the module's description.

    Args:
        url: The address of Moonraker: ``http://printer.local:7125``.
        options: See :class:`KlipperOptions`.
        clock: The rig's time.
        timeout_s: The longest wait for an answer, in s of real time, in addition to the duration of a move.

    Raises:
        InputError: The address is not one.
        RigError: Moonraker does not answer, or Klipper is not ready.
    """

    simulated = ""

    def __init__(
        self,
        url: str,
        options: KlipperOptions | None = None,
        *,
        clock: Clock | None = None,
        timeout_s: float = StageSettings.timeout_s,
    ) -> None:
        parts = urllib.parse.urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise InputError("[stage] port", url, "must be the address of Moonraker, such as http://printer.local:7125")
        self._url, self._name = url.rstrip("/"), f"stage at {url}"
        self._options, self._clock, self._timeout_s = options or KlipperOptions(), clock or Clock(), timeout_s
        # A proxy for web pages does not lead to the printer.
        self._opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        self._moving = self._stopped = self._closed = False
        self._report: Callable[[Point], None] = no_report
        self._lost = ""
        self._home_counts: dict[str, Count] | None = None
        info = self._info()
        self.identity = f"klipper: {info.get('software_version', 'unknown version')} at {url}"
        if info.get("state") not in ("ready", "shutdown", "error"):
            raise AlarmError(f"{self._name}: Klipper is not ready: {_message(info)}")

    def home(self) -> None:
        """Restart the firmware if it is halted, lift z if it is homed, and home all axes.

        Raises:
            AlarmError: Klipper does not become ready, or homing failed.
            RigError: Moonraker is gone or silent.
        """
        self._home_counts = None
        if self._info().get("state") != "ready":
            self._restart()
        self._stopped, self._lost = False, "homing was not completed"
        head = self._status()["toolhead"]
        if set(head["homed_axes"]) == set("xyz"):
            top = min(head["position"][2] + self._options.home_lift_mm, head["axis_maximum"][2])
            self._run(f"G90\nG1 Z{top:.4f} F600\nM400", self._options.home_timeout_s)
        # Motors that Klipper switches off after ten minutes would lose the position.
        self._run(f"G28\nM400\nSET_IDLE_TIMEOUT TIMEOUT={IDLE_S}", self._options.home_timeout_s)
        homed = self._status()["toolhead"]["homed_axes"]
        if set(homed) != set("xyz"):
            raise AlarmError(f"{self._name}: G28 homed only the axes {homed or 'none'}; look at printer.cfg")
        self._lost = ""
        self._home_counts = self._counts()

    def home_offset_mm(self) -> Point | None:
        """Home, and return the error that the position had before. See :func:`tacbench_cad.lab.rig.stage.home_again`.

        Raises:
            RigError: Moonraker is gone or silent, or homing failed.
        """
        first = self._home_counts
        is_known = not self._lost and set(self._status()["toolhead"]["homed_axes"]) == set("xyz")
        here = self._counts() if first and is_known else None
        self.home()
        second = self._home_counts
        if not first or not here or not second:
            return None
        offset = []
        for axis in "xyz":
            way = here[axis].steps - first[axis].steps
            if abs(here[axis].mm - first[axis].mm) < MIN_WAY_MM or not way:
                return None
            step_mm = (here[axis].mm - first[axis].mm) / way
            homed_mm = second[axis].mm - first[axis].mm
            offset.append(homed_mm - step_mm * (second[axis].steps - first[axis].steps))
        return (offset[0], offset[1], offset[2])

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move to a position in a straight line; finished when Klipper reports the target.

        Raises:
            OutOfRangeError: The target is beyond Klipper's limits.
            RigError: The move was stopped, or ended at another position.
            PositionLostError: Not every axis is homed.
            AlarmError: Klipper is halted.
            RigError: Moonraker is gone or silent.
        """
        start = self.position()
        x, y, z = target_mm
        seconds = SLOWNESS * math.dist(start, target_mm) / speed_mm_s / self._clock.speed
        self._run(f"G90\nG1 X{x:.4f} Y{y:.4f} Z{z:.4f} F{60.0 * speed_mm_s:.3f}\nM400", self._timeout_s + seconds)
        # The motion has just ended. Where the tool head was on its way is unknown.
        self._report(target_mm)
        until_s = self._clock.now_s() + LAST_STEP_S
        at = self.position()
        while not self._near(at, target_mm) and self._clock.now_s() < until_s:
            self._clock.sleep(POLL_S)
            at = self.position()
        if not self._near(at, target_mm):
            stands = "stands at x {:.3f}, y {:.3f}, z {:.3f} mm instead of x {:.3f}, y {:.3f}, z {:.3f} mm"
            raise RigError(
                f"{self._name}: {stands.format(*at, *target_mm)}; clear the bed mesh (BED_MESH_CLEAR), the G-code "
                "offset (SET_GCODE_OFFSET Z=0) and G92"
            )
        return at

    def position(self) -> Point:
        """Return the reported position of the tool head in mm.

        Raises:
            PositionLostError: Not every axis is homed, or the stage was stopped.
            RigError: Moonraker is gone or silent.
        """
        if self._lost:
            raise PositionLostError(f"{self._name}: the position is unknown: {self._lost}; home the stage first")
        status = self._status()
        homed = status["toolhead"]["homed_axes"]
        if set(homed) != set("xyz"):
            self._lost = "Klipper was restarted or has switched its motors off, or was never homed"
            raise PositionLostError(f"{self._name}: the position is unknown: {self._lost}; home the stage first")
        x, y, z = status["motion_report"]["live_position"][:3]
        return (float(x), float(y), float(z))

    def report_to(self, receive: Callable[[Point], None]) -> None:
        """See :class:`tacbench_cad.lab.rig.stage.Stage`."""
        self._report = receive

    def stop(self) -> None:
        """Halt Klipper if a move is in progress. Never raises."""
        if not self._moving:
            return
        self._stopped, self._lost = True, "the motion was stopped by an emergency stop"
        with contextlib.suppress(Exception):
            self._ask("printer/emergency_stop", {}, timeout_s=STOP_S)

    def close(self) -> None:
        """Refuse further work. Moonraker needs no farewell."""
        self._closed = True

    def _counts(self) -> dict[str, Count] | None:
        """Return the counted steps and the position of each axis; None if an axis does not have a motor of its own."""
        path = f"server/gcode_store?count={MESSAGES}"
        try:
            before_s = max((message["time"] for message in self._ask(path)["gcode_store"]), default=0.0)
            self._ask("printer/gcode/script", {"script": "GET_POSITION"})
            until_s = time.monotonic() + self._timeout_s
            while time.monotonic() < until_s:
                for message in self._ask(path)["gcode_store"]:
                    if message["time"] > before_s and "mcu:" in message["message"]:
                        return _parsed_counts(message["message"])
                time.sleep(POLL_S)
        except (AlarmError, KeyError, TypeError):
            # Another version of Klipper or Moonraker. The position can then only be checked by heights.
            return None
        return None

    def _near(self, at: Point, target: Point) -> bool:
        return all(abs(a - b) <= self._options.tolerance_mm for a, b in zip(at, target, strict=True))

    def _run(self, script: str, timeout_s: float) -> None:
        """Run G-code that moves, and wait until it has been executed."""
        self._moving = True
        try:
            self._ask("printer/gcode/script", {"script": script}, timeout_s=timeout_s)
        except BaseException as error:
            if self._stopped and isinstance(error, RigError):
                raise RigError(f"{self._name}: {self._lost}; home the stage first") from None
            if isinstance(error, NoAnswerError) or not isinstance(error, RigError):
                # Silence or Ctrl-C: no carriage may move unattended.
                self.stop()
            raise
        finally:
            self._moving = False
        if self._stopped:
            raise RigError(f"{self._name}: {self._lost}; home the stage first")

    def _restart(self) -> None:
        self._ask("printer/firmware_restart", {})
        until_s = time.monotonic() + RESTART_S
        while (info := self._info()).get("state") != "ready":
            if time.monotonic() > until_s:
                raise AlarmError(f"{self._name}: Klipper is not ready after a restart: {_message(info)}")
            time.sleep(POLL_S)

    def _info(self) -> dict[str, Any]:
        """Return Klipper's state. While it restarts, Moonraker answers with an error."""
        try:
            info: dict[str, Any] = self._ask("printer/info")
        except AlarmError as error:
            return {"state": "startup", "state_message": str(error)}
        return info

    def _status(self) -> Any:
        status = self._ask("printer/objects/query?toolhead&motion_report")["status"]
        if {"toolhead", "motion_report"} - status.keys():
            raise RigError(f"{self._name}: reports no toolhead or no motion_report; update Klipper")
        return status

    def _ask(self, path: str, body: dict[str, Any] | None = None, *, timeout_s: float | None = None) -> Any:
        """Send a request; with a body it is a POST.

        Raises:
            OutOfRangeError: Klipper refuses a move beyond its limits.
            PositionLostError: Klipper refuses a move of an axis that is not homed.
            AlarmError: Klipper is halted, restarting, or refuses the command.
            RigError: Moonraker is gone or silent, or its answer is not JSON.
        """
        if self._closed:
            raise DeviceLostError(f"{self._name}: is closed")
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"{self._url}/{path}", data=data)
        request.add_header("Content-Type", "application/json")
        if self._options.api_key:
            request.add_header("X-Api-Key", self._options.api_key)
        try:
            with self._opener.open(request, timeout=timeout_s or self._timeout_s) as answer:
                return json.load(answer)["result"]
        except urllib.error.HTTPError as error:
            raise self._refusal(error) from None
        except TimeoutError:
            raise NoAnswerError(f"{self._name}: does not answer; look at the printer and its network") from None
        except (OSError, http.client.HTTPException) as error:
            if isinstance(getattr(error, "reason", None), TimeoutError):
                raise NoAnswerError(f"{self._name}: does not answer; look at the printer and its network") from None
            raise DeviceLostError(f"{self._name}: cannot be reached: {one_line(error, 120)}") from None
        except (ValueError, KeyError, TypeError):
            raise RigError(f"{self._name}: the answer to {path} is not Moonraker's") from None

    def _refusal(self, error: urllib.error.HTTPError) -> Exception:
        """Return the error for Moonraker's refusal."""
        if error.code in (401, 403):
            return RigError(f"{self._name}: Moonraker refuses this computer; set options.api_key")
        try:
            text = one_line(json.loads(error.read())["error"]["message"], 300)
        except (OSError, ValueError, KeyError, TypeError):
            return RigError(f"{self._name}: HTTP error {error.code}; is this the address of Moonraker?")
        if "out of range" in text.lower():
            return OutOfRangeError(f"{self._name}: {text}; nothing moved")
        if "must home" in text.lower():
            self._lost = "Klipper was restarted or was never homed"
            return PositionLostError(f"{self._name}: {text}; home the stage first")
        return AlarmError(f"{self._name}: {text}")


def _parsed_counts(text: str) -> dict[str, Count] | None:
    """Return the steps and the position of each axis in the answer to ``GET_POSITION``."""
    steps = dict(re.findall(r"stepper_([xyz]):(-?\d+)(?![\d.])", text))
    motors = dict(re.findall(r"stepper_([xyz]):(-?\d+\.\d+)", text))
    axes = {axis.lower(): float(value) for axis, value in re.findall(r"([XYZ]):(-?\d+\.\d+)", _kinematic(text))}
    if not all(axis in steps and axis in motors and axis in axes for axis in "xyz"):
        return None
    if any(abs(float(motors[axis]) - axes[axis]) > KlipperOptions.tolerance_mm for axis in "xyz"):
        return None
    return {axis: Count(steps=int(steps[axis]), mm=axes[axis]) for axis in "xyz"}


def _kinematic(text: str) -> str:
    return next((line for line in text.splitlines() if "kinematic:" in line), "")


def _message(info: dict[str, Any]) -> str:
    return one_line(info.get("state_message", info.get("state", "")), 200)


def _open(settings: StageSettings, context: Context) -> KlipperStage:
    if settings.port is None:
        raise InputError("[stage] port", None, "is missing; write the address of Moonraker: http://printer.local:7125")
    options = from_plain(KlipperOptions, dict(settings.options), "[stage.options] ")
    return KlipperStage(settings.port, options, clock=context.clock, timeout_s=settings.timeout_s)


DRIVER = Driver(open=_open, summary="Klipper, through Moonraker's HTTP interface", connection="network")
