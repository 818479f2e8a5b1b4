"""A list of connected devices: the sizes of cameras, and the answer of a serial port with its firmware's settings."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass
from functools import partial

from tacbench_cad.lab.rig.camera_devices import STABLE_FOLDERS, Opener, cameras, open_capture
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.lab.rig.firmware_settings import FirmwareSetting
from tacbench_cad.lab.rig.samples import parse_numbers
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.util.errors import InputError, TacbenchError
from tacbench_cad.util.text import counted

#: The baud rates at which a port is read.
_BAUDS = (115_200, 9_600, 57_600, 230_400, 921_600)
#: The longest wait for the first text after opening a port has restarted the board, in s of real time.
_START_S = 2.5
#: The time over which the rate of a stream of samples is measured, in s.
_LISTEN_S = 0.5
#: The smallest number of lines that proves a stream of samples.
_MIN_LINES = 4
#: The longest wait for the answer of each firmware, in s of real time.
_ANSWER_S = 3.0


@dataclass(frozen=True, kw_only=True)
class PluggedCamera:
    """A connected camera.

    Args:
        name: The stable name, for ``[sensor] device``.
        size_px: The default width and height of its pictures; None if it cannot be opened.
    """

    name: str
    size_px: tuple[int, int] | None


def plugged_cameras(opener: Opener = open_capture) -> tuple[PluggedCamera, ...]:
    """Return the cameras with a stable name. Each is opened for a moment.

    Args:
        opener: Opens a device.
    """
    plugged = []
    for name in cameras(STABLE_FOLDERS):
        size = None
        with contextlib.suppress(DeviceLostError):
            capture = opener(name)
            if capture.isOpened():
                size = (int(capture.get(3)), int(capture.get(4)))
            capture.release()
        plugged.append(PluggedCamera(name=name, size_px=size))
    return tuple(plugged)


@dataclass(frozen=True, kw_only=True)
class PortAnswer:
    """The answer of a port.

    Args:
        identity: The device, for the user.
        settings: The settings of a stage's firmware; none for other devices.
    """

    identity: str
    settings: tuple[FirmwareSetting, ...] = ()


def identify(port: str, stage: StageSettings | None = None) -> PortAnswer:
    """Find out which device is at a port. Opening a port restarts many boards, so only named ports are opened.

    The function first reads the port at the usual baud rates, since gauges and taxels send samples unrequested. Then it
    sends the questions of GRBL and Marlin. It sends nothing that could cause motion.

    Args:
        port: The path, name or pyserial URL of the port.
        stage: The table ``[stage]`` of a study file, with which the settings of a firmware are compared.

    Raises:
        InputError: The port does not exist.
    """
    from tacbench_cad.lab.rig.grbl import GrblStage
    from tacbench_cad.lab.rig.marlin import MarlinStage

    description = _listen(port)
    if description is not None:
        return PortAnswer(identity=description)
    for factory in (partial(GrblStage, checks_settings=False), MarlinStage):
        try:
            with factory(port, clock=Clock(), timeout_s=_ANSWER_S) as device:
                return PortAnswer(identity=device.identity, settings=device.checked_settings(stage))
        except InputError:
            raise
        except TacbenchError:
            continue
    return PortAnswer(identity="sends no samples and answers neither as GRBL nor as Marlin")


def _listen(port: str) -> str | None:
    """Describe a device that sends samples unrequested; return None for other devices."""
    from tacbench_cad.lab.rig.line import Line

    with Line(port, baud=_BAUDS[0], what="device") as line:
        for i, baud in enumerate(_BAUDS):
            if i:
                line.set_baud(baud)
            first = line.read_line(_START_S if i == 0 else _LISTEN_S)
            if first is None and i == 0:
                # The device sends no bytes at all, not even at a wrong baud rate.
                return None
            lines = [] if first is None else [first, *line.lines(_LISTEN_S)]
            columns = Counter(len(numbers) for text in lines if (numbers := parse_numbers(text)) is not None)
            count, times = columns.most_common(1)[0] if columns else (0, 0)
            if times >= max(_MIN_LINES, 0.7 * len(lines)):
                rate = times / _LISTEN_S
                sizes = counted(count, "number")
                return f"sends samples of {sizes}, about {rate:.0f} per second at {baud} baud: {lines[-1][:40]}"
            if lines and not any("\ufffd" in text for text in lines):
                # The text is readable, so the baud rate is right, and the device does not send samples.
                return None
    return None
