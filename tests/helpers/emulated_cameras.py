"""Emulated cameras: the parts of picamera2 0.3.38 and of harvesters 1.4.3 that the drivers use.

The names and arguments are those of the real packages. No camera and no recording is behind them.
"""

from __future__ import annotations

import sys
import time
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest


def picture(seed: int, width: int, height: int) -> Any:
    """Return bright squares with noise, each channel with its own brightness: blue 60, green 120, red 240."""
    noise = np.random.default_rng(seed).integers(0, 4, (height, width, 3), dtype=np.uint8)
    image = np.zeros((height, width, 3), dtype=np.uint8)
    for row in range(8, height - 8, 32):
        for column in range(8, width - 8, 32):
            image[row : row + 8, column : column + 8] = (60, 120, 240)
    return image + noise


class EmulatedPiCamera:
    """A Raspberry Pi camera; ``picamera2.Picamera2`` returns it."""

    def __init__(self) -> None:
        self.controls: dict[str, Any] = {}
        self.main: dict[str, Any] = {}
        self.count = self.settles_after = 0
        self.running = self.silent = False
        self.changes: dict[str, Any] = {}
        self.asked_s: list[float] = []

    def create_video_configuration(self, main: dict[str, Any], controls: dict[str, Any]) -> dict[str, Any]:
        return {"main": main, "controls": controls}

    def configure(self, configuration: dict[str, Any]) -> None:
        self.main, self.controls = configuration["main"], configuration["controls"]

    def start(self) -> None:
        self.running = True

    def stop(self) -> None:
        self.running = False

    def close(self) -> None:
        self.main = {}

    def capture_request(self, wait: float, flush: bool) -> Any:
        assert flush is True and self.running and self.main["format"] == "RGB888"
        if self.silent:
            raise TimeoutError
        self.count += 1
        self.asked_s.append(time.monotonic())
        width, height = self.main["size"]
        names = ("ExposureTime", "AnalogueGain", "ColourGains")
        values = {name: self.controls[name] for name in names} | self.changes
        if self.count <= self.settles_after:
            values["ExposureTime"] = 33_000
        image = picture(self.count, width, height)
        return SimpleNamespace(make_array=lambda name: image, get_metadata=lambda: values, release=lambda: None)


def install_picamera(monkeypatch: pytest.MonkeyPatch, *models: str) -> EmulatedPiCamera:
    """Put the emulated package in the place of picamera2."""
    camera = EmulatedPiCamera()

    class Picamera2:
        def __new__(cls, camera_num: int = 0) -> Any:
            return camera

        @staticmethod
        def global_camera_info() -> list[dict[str, Any]]:
            return [{"Num": number, "Model": model} for number, model in enumerate(models)]

    _install(monkeypatch, "picamera2", Picamera2=Picamera2)
    return camera


class Node:
    """A feature of a camera. Its value can be fixed, or rounded."""

    def __init__(self, value: Any, *, fixed: bool = False) -> None:
        self._value, self.fixed = value, fixed

    @property
    def value(self) -> Any:
        return self._value

    @value.setter
    def value(self, value: Any) -> None:
        if not self.fixed:
            self._value = value


class UnavailableNode:
    """A feature that the camera lists but does not have. The real package raises an AccessException."""

    @property
    def value(self) -> Any:
        raise RuntimeError("Node is not readable. : AccessException thrown in node")

    @value.setter
    def value(self, value: Any) -> None:
        raise RuntimeError("Node is not writable. : AccessException thrown in node")


class EmulatedGenicam:
    """An image acquirer of harvesters with the camera behind it."""

    def __init__(self, width: int = 96, height: int = 80) -> None:
        self.nodes = SimpleNamespace(
            **{name: Node("Continuous") for name in ("ExposureAuto", "GainAuto", "BalanceWhiteAuto")},
            **{name: Node("") for name in ("PixelFormat", "TriggerSelector", "TriggerMode", "TriggerSource")},
            ExposureTime=Node(20_000.0),
            Gain=Node(0.0),
            Width=Node(width),
            Height=Node(height),
            TriggerSoftware=SimpleNamespace(execute=self._trigger),
        )
        self.remote_device = SimpleNamespace(node_map=self.nodes)
        self.waiting: list[Any] = []
        self.count = 0
        self.started = self.silent = self.destroyed = False

    def _trigger(self) -> None:
        modes = (self.nodes.TriggerSelector.value, self.nodes.TriggerMode.value, self.nodes.TriggerSource.value)
        assert self.started and modes == ("FrameStart", "On", "Software")
        self.count += 1
        if not self.silent:
            self.waiting.append(self._picture(self.count))

    def _picture(self, seed: int) -> Any:
        image = picture(seed, self.nodes.Width.value, self.nodes.Height.value)
        image = {"Mono8": image[..., 2], "BGR8": image, "RGB8": image[..., ::-1]}[self.nodes.PixelFormat.value]
        return SimpleNamespace(data=image.ravel(), height=image.shape[0], width=image.shape[1])

    def start(self) -> None:
        self.started = True

    def stop(self) -> None:
        self.started = False

    def destroy(self) -> None:
        self.destroyed = True

    def try_fetch(self, *, timeout: float) -> Any:
        assert timeout > 0.0, "harvesters would wait for ever"
        return SimpleNamespace(queue=lambda: None) if self.waiting and self.waiting.pop(0) is not None else None

    @contextmanager
    def fetch(self, *, timeout: float = 0) -> Any:
        assert timeout > 0.0, "harvesters would wait for ever"
        if not self.waiting:
            raise RuntimeError("GenTL exception: Operation timed out before completion")
        yield SimpleNamespace(payload=SimpleNamespace(components=[self.waiting.pop(0)]))


def install_genicam(monkeypatch: pytest.MonkeyPatch, *serial_numbers: str) -> EmulatedGenicam:
    """Put the emulated package in the place of harvesters."""
    camera = EmulatedGenicam()

    class Harvester:
        def add_file(self, file_path: str) -> None:
            self.file = file_path

        def update(self) -> None:
            pass

        def create(self, search_key: dict[str, str] | None = None) -> EmulatedGenicam:
            known = [number for number in serial_numbers if search_key in (None, {"serial_number": number})]
            if not known or (search_key is not None and len(known) > 1):
                raise ValueError("no device found: provide sufficient search key")
            return camera

        def reset(self) -> None:
            pass

    _install(monkeypatch, "harvesters")
    _install(monkeypatch, "harvesters.core", Harvester=Harvester)
    return camera


def _install(monkeypatch: pytest.MonkeyPatch, name: str, **attributes: Any) -> None:
    module = ModuleType(name)
    module.__spec__ = __spec__
    vars(module).update(attributes)
    monkeypatch.setitem(sys.modules, name, module)
