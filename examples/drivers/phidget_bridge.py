"""A load cell on a Phidget bridge (1046, DAQ1500) as a gauge: driver = "phidget_bridge:PhidgetBridge".

Install its package with pip install Phidget22. Find newtons_per_mv_v with a known mass: divide its weight in newtons by
the change of the ratio in mV/V. This example was tried with an emulated bridge only.
"""

import contextlib
import time

import numpy as np

from tacbench_cad.lab import Closing, Force
from tacbench_cad.lab.rig import DeviceLostError, NoAnswerError


class PhidgetBridge(Closing):
    """A load cell.

    Args:
        newtons_per_mv_v: The force for 1 mV/V; negative if the ratio falls in compression.
        channel: The input of the bridge.
        serial_number: The serial number of the bridge; None for the only one.
        interval_ms: The time between two samples.
    """

    simulated = ""

    def __init__(self, newtons_per_mv_v, channel=0, serial_number=None, interval_ms=10):
        from Phidget22.Devices.VoltageRatioInput import VoltageRatioInput

        self.newtons_per_ratio, self.zero_n, self.samples = 1000.0 * newtons_per_mv_v, 0.0, []
        self.calibration = {"newtons_per_mv_v": newtons_per_mv_v}
        self.input = VoltageRatioInput()
        self.input.setChannel(channel)
        if serial_number is not None:
            self.input.setDeviceSerialNumber(serial_number)
        self.input.setOnVoltageRatioChangeHandler(lambda _, ratio: self.samples.append(ratio))
        try:
            self.input.openWaitForAttachment(5000)
            self.input.setDataInterval(interval_ms)
            self.input.setVoltageRatioChangeTrigger(0.0)  # every sample, also without a change
        except Exception as error:
            self.close()
            raise DeviceLostError(f"phidget bridge: cannot be opened: {error}") from error
        self.identity = f"{self.input.getDeviceName()} {self.input.getDeviceSerialNumber()}, channel {channel}"

    def read(self, window_s):
        if self.input is None:
            raise DeviceLostError("phidget bridge: is closed")
        self.samples.clear()
        until = time.monotonic() + window_s
        while time.monotonic() < until or not self.samples:
            time.sleep(0.002)
            if time.monotonic() > until + 2.0:
                raise NoAnswerError("phidget bridge: sends no samples; check its cable")
        values = self.newtons_per_ratio * np.array(self.samples)
        return Force(mean_n=float(values.mean()) - self.zero_n, spread_n=float(values.std()), samples=len(values))

    def tare(self):
        self.zero_n += self.read(1.0).mean_n

    def close(self):
        device, self.input = self.input, None
        with contextlib.suppress(Exception):
            device.close()
