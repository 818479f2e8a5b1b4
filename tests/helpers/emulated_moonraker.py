"""An emulated Moonraker with a small Klipper behind it. It is no recording, and no code of either project.

It imitates what a driver has to cope with: a script returns when its commands are queued, unless ``M400`` waits for
them; the commanded position is ahead of the live one; limits and unhomed axes are refused with HTTP 400; an emergency
stop ends a waiting script with an error; after a restart no axis is homed.
"""

from __future__ import annotations

import json
import math
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

Point = tuple[float, float, float]
LOW, HIGH = (0.0, 0.0, 0.0), (220.0, 220.0, 250.0)


class RefusedError(Exception):
    """The message of an HTTP error."""


class EmulatedMoonraker:
    """A server on this machine.

    Args:
        speed: How many times faster than real time the carriage moves.
        homes_to: Where homing ends.
        api_key: The key without which requests are refused.
    """

    def __init__(self, speed: float = 1.0, homes_to: Point = (0.0, 0.0, 10.0), api_key: str = "") -> None:
        self.speed, self.homes_to, self.api_key = speed, homes_to, api_key
        self.state, self.homed = "ready", ""
        self.start = self.target = (0.0, 0.0, 0.0)
        self.began_s = self.ends_s = 0.0
        self.rate_mm_s, self.mesh_mm, self.restart_s = 10.0, 0.0, 0.05
        self.scripts: list[str] = []
        #: The position in mm at which the controller's count of steps is 0, and the slip of each motor since homing.
        self.steps_per_mm, self.zero_mm, self.slip_mm = (80.0, 80.0, 400.0), [3.0, -7.0, 11.0], [0.0, 0.0, 0.0]
        #: How far the position of a motor is from that of its axis: not 0 for kinematics like corexy.
        self.motor_mm = 0.0
        self.messages: list[dict[str, Any]] = []
        self.silent = False
        self._gcode = threading.Lock()
        emulation = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                emulation._answer(self)

            def do_POST(self) -> None:
                emulation._answer(self)

            def log_message(self, format: str, *words: Any) -> None:
                pass

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"
        threading.Thread(target=self.server.serve_forever, args=(0.01,), daemon=True).start()

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()

    def now_s(self) -> float:
        return time.monotonic() * self.speed

    def live(self) -> Point:
        if self.now_s() >= self.ends_s:
            return self.target
        part = (self.now_s() - self.began_s) / (self.ends_s - self.began_s)
        x, y, z = (a + part * (b - a) for a, b in zip(self.start, self.target, strict=True))
        return (x, y, z)

    def _answer(self, request: BaseHTTPRequestHandler) -> None:
        body = request.rfile.read(int(request.headers.get("Content-Length") or 0))
        if self.silent:
            return
        code, document = 200, {}
        try:
            if self.api_key and request.headers.get("X-Api-Key") != self.api_key:
                code, document = 401, {"error": {"code": 401, "message": "Unauthorized"}}
            else:
                document = {"result": self._do(request.path, json.loads(body or b"{}"))}
        except RefusedError as error:
            code, document = 400, {"error": {"code": 400, "message": str(error)}}
        data = json.dumps(document).encode()
        request.send_response(code)
        request.send_header("Content-Length", str(len(data)))
        request.end_headers()
        request.wfile.write(data)

    def _do(self, path: str, body: dict[str, Any]) -> Any:
        if path == "/printer/info":
            return {
                "state": self.state,
                "state_message": f"Printer is {self.state}",
                "software_version": "v0.12.0-emulated",
            }
        if path.startswith("/printer/objects/query"):
            head = {"homed_axes": self.homed, "position": [*self.target, 0.0], "axis_maximum": [*HIGH, 0.0]}
            report = {"live_position": [*self.live(), 0.0]}
            return {"eventtime": self.now_s(), "status": {"toolhead": head, "motion_report": report}}
        if path.startswith("/server/gcode_store"):
            return {"gcode_store": self.messages[-int(path.split("=")[1]) :]}
        if path == "/printer/emergency_stop":
            self.target = self.start = self.live()
            self.state, self.homed, self.ends_s = "shutdown", "", 0.0
            return "ok"
        if path == "/printer/firmware_restart":
            self.state, self.homed, self.zero_mm = "startup", "", [50.0, 60.0, 70.0]
            threading.Timer(self.restart_s, self._ready).start()
            return "ok"
        if path == "/printer/gcode/script":
            with self._gcode:
                for line in body["script"].split("\n"):
                    self._line(line)
            return "ok"
        raise RefusedError(f"Not Found: {path}")

    def _ready(self) -> None:
        self.state = "ready"

    def _line(self, line: str) -> None:
        self.scripts.append(line)
        if self.state != "ready":
            raise RefusedError("Printer is shutdown: emergency stop")
        command, *words = line.split()
        values = {word[0]: float(word[1:]) for word in words if "=" not in word}
        if command == "G28":
            self._go(self.homes_to, 100.0)
            self._wait()
            self.homed = "xyz"
            self.zero_mm = [zero + slip for zero, slip in zip(self.zero_mm, self.slip_mm, strict=True)]
            self.slip_mm = [0.0, 0.0, 0.0]
        elif command == "G1":
            if self.homed != "xyz":
                raise RefusedError("Must home axis first: 0.000 0.000 0.000 [0.000]")
            x, y, z = (values.get(axis, at) for axis, at in zip("XYZ", self.target, strict=True))
            if not all(low <= value <= high for low, value, high in zip(LOW, (x, y, z), HIGH, strict=True)):
                raise RefusedError(f"Move out of range: {x:.3f} {y:.3f} {z:.3f} [0.000]")
            self._wait()
            self._go((x, y, z + self.mesh_mm), values["F"] / 60.0)
        elif command == "M400":
            self._wait()
        elif command == "GET_POSITION":
            self.messages.append({"message": self._position(), "time": time.time(), "type": "response"})

    def _position(self) -> str:
        counts = zip("xyz", self.target, self.zero_mm, self.steps_per_mm, strict=True)
        steps = " ".join(f"stepper_{axis}:{round((at - zero) * per_mm)}" for axis, at, zero, per_mm in counts)
        motors = " ".join(
            f"stepper_{axis}:{at + self.motor_mm:.6f}" for axis, at in zip("xyz", self.target, strict=True)
        )
        axes = " ".join(f"{axis}:{at:.6f}" for axis, at in zip("XYZ", self.target, strict=True))
        return f"// mcu: {steps}\n// stepper: {motors}\n// kinematic: {axes}\n// toolhead: {axes} E:0.000000"

    def _go(self, target: Point, speed_mm_s: float) -> None:
        self.start, self.target, self.began_s = self.live(), target, self.now_s()
        self.ends_s = self.began_s + math.dist(self.start, target) / speed_mm_s

    def _wait(self) -> None:
        while self.now_s() < self.ends_s:
            time.sleep(0.002)
        if self.state != "ready":
            raise RefusedError("Shutdown due to webhooks request")
