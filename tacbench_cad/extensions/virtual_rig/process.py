"""Starting a virtual rig in its own process, and communication with it other than through its ports."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from typing import Any

from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.setup import Setup
from tacbench_cad.lab.rig import Closing, DeviceLostError
from tacbench_cad.lab.study import Point
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError

#: The child gets exactly our module path: -P and PYTHONSAFEPATH exclude the files of the current folder.
_PROGRAM = (
    "import sys; sys.path[:] = {path!r}; from tacbench_cad.extensions.virtual_rig.__main__ import launched; launched()"
)


class VirtualRig(Closing):
    """A running virtual rig. It ends with :meth:`close`, and also when this process ends.

    Attributes:
        port: The stage's port: a path, or ``socket://...``.
        gauge_port: The load cell's port.
        setup: The settings of the rig.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", _PROGRAM.format(path=sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONSAFEPATH": "1"},
        )
        try:
            ports = self._ask(to_plain(setup))
        except BaseException:
            self.close()
            raise
        self.port = str(ports["port"])
        self.gauge_port = str(ports["gauge_port"])

    def inject(self, fault: Fault) -> None:
        """Add a fault, now or at the fault's time.

        Raises:
            DeviceLostError: The process has ended.
        """
        self._ask({"do": "inject", "fault": to_plain(fault)})

    def put(self, stimulus: Mapping[str, Any] | None) -> None:
        """Replace the object under the carriage; None for nothing."""
        self._ask({"do": "put", "stimulus": stimulus})

    def true_position(self) -> Point:
        """Return the true position of the carriage in mm, in the frame that the firmware has after homing."""
        x, y, z = self._ask({"do": "look"})["true_mm"]
        return (x, y, z)

    def reported_position(self) -> Point:
        """Return the position that the firmware's counters give, in mm."""
        x, y, z = self._ask({"do": "look"})["reported_mm"]
        return (x, y, z)

    def force_n(self) -> float:
        """Return the true force on the load cell in N, without noise."""
        return float(self._ask({"do": "look"})["force_n"])

    def motors_off(self) -> int:
        """Return how often the motors lost their power at rest."""
        return int(self._ask({"do": "look"})["motors_off"])

    def now_s(self) -> float:
        """Return the rig time in s."""
        return float(self._ask({"do": "look"})["now_s"])

    @property
    def process_id(self) -> int:
        """The ID of the process."""
        return self._process.pid

    def close(self) -> None:
        """End the process. Never raises; a second call has no effect."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        try:
            self._process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _ask(self, order: Mapping[str, Any]) -> dict[str, Any]:
        stdin, stdout = self._process.stdin, self._process.stdout
        line = ""
        if stdin is not None and stdout is not None:
            with self._lock, contextlib.suppress(OSError, ValueError):
                print(json.dumps(order), file=stdin, flush=True)
                line = stdout.readline()
        if not line:
            raise DeviceLostError("the virtual rig's process has ended")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise InputError("virtual rig", None, str(answer["error"]))
        return answer


def launch(kind: str, **options: Any) -> VirtualRig:
    """Start a virtual rig. Use it in a ``with`` statement.

    Args:
        kind: The firmware: ``grbl``, ``grblhal``, ``marlin`` or ``arduino``.
        **options: Other fields of ``Setup``, and keyword arguments of the
            firmware: ``settings`` of ``grbl``, ``emergency_parser`` of ``marlin``.

    Raises:
        InputError: An argument is not allowed.
        DeviceLostError: The process ended at once.
    """
    return VirtualRig(Setup.of(kind, **options))
