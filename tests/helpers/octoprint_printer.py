"""OctoPrint's own virtual Marlin printer behind a pseudo-terminal; run it with the Python that has OctoPrint installed.

It prints the terminal's path and runs until its standard input ends. It needs no OctoPrint server, settings folder or
port, because the printer object gets its plugin's default settings. With ``--marlin2`` some settings and the answer to
M114 are changed to resemble Marlin 2; without it the printer is OctoPrint's own.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import threading
import tty
from types import SimpleNamespace
from typing import Any

from octoprint.plugins.virtual_printer import VirtualPrinterPlugin, virtual

virtual.plugin_manager = lambda: SimpleNamespace(get_hooks=lambda name: {})

MARLIN2 = {
    "firmwareName": "Marlin 2.1.2 (OctoPrint virtual)",
    "sendWait": False,
    "sendBusy": True,
    "rxBuffer": 128,
    "resetLines": ["start", "Marlin 2.1.2"],
    # OctoPrint writes as many decimals as Python does; Marlin always writes two.
    "m114FormatString": "X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:{e[current]:.2f}",
    "simulated_errors": [],
}


class Settings:
    """The part of OctoPrint's settings that the printer reads."""

    def __init__(self, values: dict[str, Any], folder: str) -> None:
        self.values, self.folder = values, folder

    def get(self, path: list[str], merged: bool = False) -> Any:
        value: Any = self.values
        for key in path:
            value = value[key]
        return value

    def get_int(self, path: list[str]) -> int:
        return int(self.get(path))

    def get_float(self, path: list[str]) -> float:
        return float(self.get(path))

    def get_boolean(self, path: list[str]) -> bool:
        return bool(self.get(path))

    def global_get_basefolder(self, name: str) -> str:
        return self.folder


class Marlin2(virtual.VirtualPrinter):  # type: ignore[misc]
    """A printer that answers M114 as Marlin does, and takes commands in their order.

    M114 sends the position on a separate line, then ``ok``. OctoPrint's printer moves in a second thread, which reads
    the target of a move when its turn comes. So a move that waits would be taken as absolute after ``G90``, and would
    end after a later ``G28``. Marlin reads a target when the line arrives, and homes when all moves have ended.
    """

    def _gcode_M114(self, data: str) -> None:  # noqa: N802 (their name)
        self._send(self._generatePositionOutput())

    def _gcode_G28(self, data: str) -> None:  # noqa: N802 (their name)
        self.buffered.join()
        super()._gcode_G28(data)

    def _gcode_G90(self, data: str) -> None:  # noqa: N802 (their name)
        self.buffered.join()
        super()._gcode_G90(data)

    def _gcode_G91(self, data: str) -> None:  # noqa: N802 (their name)
        self.buffered.join()
        super()._gcode_G91(data)


def main() -> None:
    """Serve until the standard input ends."""
    values = VirtualPrinterPlugin.get_settings_defaults(SimpleNamespace())
    marlin2 = "--marlin2" in sys.argv
    values.update(MARLIN2 if marlin2 else {})
    folder = tempfile.mkdtemp()
    kind = Marlin2 if marlin2 else virtual.VirtualPrinter
    # The other end stays open here, so that the terminal survives when a client closes it.
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    printer = kind(Settings(values, folder), None, folder, read_timeout=0.2)

    def inwards() -> None:
        # OctoPrint's printer takes only one line from each write and keeps the rest until the next write, because its
        # own host writes line by line. A serial port has no such units, so the bytes are split into lines here.
        line = bytearray()
        with contextlib.suppress(Exception):
            while data := os.read(ours, 64):
                for byte in data:
                    line.append(byte)
                    if byte == 0x0A:
                        while line:
                            del line[: printer.write(bytes(line)) or len(line)]

    def outwards() -> None:
        while True:
            line = printer.readline()
            if line:
                os.write(ours, line if line.endswith(b"\n") else line + b"\n")

    for work in (inwards, outwards):
        threading.Thread(target=work, daemon=True).start()
    print(os.ttyname(theirs), flush=True)
    sys.stdin.read()
    os._exit(0)


if __name__ == "__main__":
    main()
