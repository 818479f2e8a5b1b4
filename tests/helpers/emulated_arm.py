"""An emulated arm of Universal Robots: two objects with the methods of ur-rtde 1.6.5 that the driver uses.

The names and the orders of the arguments are those of the real package. The arm is a point that moves in time.
"""

from __future__ import annotations

import math
import sys
from types import ModuleType

import pytest

from tacbench_cad.lab.rig.clock import Clock

REACH_M = 0.85


class EmulatedArm:
    """The state of the arm, which both objects share."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.start = self.target = [0.3, 0.1, 0.2, 0.0, math.pi, 0.0]
        self.began_s = self.ends_s = 0.0
        self.connected, self.program, self.protective, self.emergency, self.reachable = True, True, False, False, True
        self.stuck = False

    def pose(self) -> list[float]:
        if (now := self.clock.now_s()) >= self.ends_s:
            return list(self.target)
        part = (now - self.began_s) / (self.ends_s - self.began_s)
        return [a + part * (b - a) for a, b in zip(self.start, self.target, strict=True)]

    # RTDEControlInterface

    def moveL(  # noqa: N802
        self, pose: list[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        assert asynchronous and acceleration > 0.0
        self.start, self.began_s = self.pose(), self.clock.now_s()
        self.target = [0.5 * (a + b) for a, b in zip(self.start, pose, strict=True)] if self.stuck else list(pose)
        self.ends_s = self.began_s + math.dist(self.start[:3], self.target[:3]) / speed
        return self.program

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:  # noqa: N802
        self.start = self.target = self.pose()
        self.ends_s = 0.0

    def isSteady(self) -> bool:  # noqa: N802
        return self.clock.now_s() >= self.ends_s

    def isPoseWithinSafetyLimits(self, pose: list[float]) -> bool:  # noqa: N802
        return math.dist(pose[:3], (0.0, 0.0, 0.0)) <= REACH_M

    def isProgramRunning(self) -> bool:  # noqa: N802
        return self.program

    def reuploadScript(self) -> bool:  # noqa: N802
        self.program = self.connected
        return self.program

    def stopScript(self) -> None:  # noqa: N802
        self.program = False

    # RTDEReceiveInterface

    def getActualTCPPose(self) -> list[float]:  # noqa: N802
        return self.pose()

    def isConnected(self) -> bool:  # noqa: N802
        return self.connected

    def isProtectiveStopped(self) -> bool:  # noqa: N802
        return self.protective

    def isEmergencyStopped(self) -> bool:  # noqa: N802
        return self.emergency

    def disconnect(self) -> None:
        self.connected = False


def install_arm(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> EmulatedArm:
    """Put the emulated package in the place of ur-rtde."""
    arm = EmulatedArm(clock)

    def interface(hostname: str, frequency: float = -1.0) -> EmulatedArm:
        if not arm.reachable:
            raise RuntimeError(f"Error: Could not connect to: {hostname} at 30004, verify the IP")
        return arm

    for name, cls in (("rtde_control", "RTDEControlInterface"), ("rtde_receive", "RTDEReceiveInterface")):
        module = ModuleType(name)
        module.__spec__ = __spec__
        setattr(module, cls, interface)
        monkeypatch.setitem(sys.modules, name, module)
    return arm
