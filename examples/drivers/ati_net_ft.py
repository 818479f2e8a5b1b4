"""An ATI force-torque sensor with a Net F/T box or an Ethernet Axia as a gauge: driver = "ati_net_ft:AtiNetFt".

The box sends samples over UDP (ATI's protocol RDT, port 49152). The web page of the box shows its counts per force.
This example was tried with an emulated box only.
"""

import socket
import struct
import time

import numpy as np

from tacbench_cad.lab import Closing, Force, RigError
from tacbench_cad.lab.rig import DeviceLostError, NoAnswerError

#: The commands of the protocol, and its packets: header, command, number of samples; three counters and six values.
STOP, START = 0, 2
REQUEST, SAMPLE = struct.Struct("!HHI"), struct.Struct("!IIIiiiiii")


class AtiNetFt(Closing):
    """One axis of a force-torque sensor.

    Args:
        port: The address of the box, with another port if it is not 49152: 192.168.1.1:49152.
        counts_per_newton: As the web page of the box shows it.
        axis: The axis of the force.
        compression: The sign of the force in compression, 1 or -1.
    """

    simulated = ""

    def __init__(self, port, counts_per_newton=1_000_000, axis="z", compression=-1):
        host, _, number = port.partition(":")
        self.identity = f"ATI Net F/T at {port}, axis {axis}"
        self.calibration = {"counts_per_newton": counts_per_newton}
        self.newtons_per_count, self.column = compression / counts_per_newton, "xyz".index(axis)
        self.zero_n, self.socket = 0.0, socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(2.0)
        try:
            self.socket.connect((host, int(number or 49152)))
        except OSError as error:
            self.close()
            raise DeviceLostError(f"{self.identity}: cannot be reached: {error}") from error
        self.read(0.0)

    def read(self, window_s):
        if self.socket is None:
            raise DeviceLostError(f"{self.identity}: is closed")
        values = []
        try:
            self._forget()
            self.socket.send(REQUEST.pack(0x1234, START, 0))
            until = time.monotonic() + window_s
            while time.monotonic() < until or not values:
                _, _, status, *counts = SAMPLE.unpack(self.socket.recv(SAMPLE.size))
                if status:
                    raise RigError(f"{self.identity}: status {status:#010x}; look at the web page of the box")
                values.append(self.newtons_per_count * counts[self.column])
        except (TimeoutError, ConnectionError):
            raise NoAnswerError(f"{self.identity}: sends no samples; check its cable and address") from None
        finally:
            self.socket.send(REQUEST.pack(0x1234, STOP, 0))
        mean = float(np.mean(values)) - self.zero_n
        return Force(mean_n=mean, spread_n=float(np.std(values)), samples=len(values))

    def tare(self):
        self.zero_n += self.read(1.0).mean_n

    def close(self):
        ended, self.socket = self.socket, None
        if ended is not None:
            ended.close()

    def _forget(self):
        """Drop the samples that arrived after the last request to stop."""
        self.socket.setblocking(False)
        try:
            while True:
                self.socket.recv(SAMPLE.size)
        except (BlockingIOError, ConnectionError):
            self.socket.settimeout(2.0)
