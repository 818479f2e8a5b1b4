"""What is plugged in: cameras with their sizes, and what a serial port says when it is asked."""

from __future__ import annotations

import contextlib
from collections import Counter
from dataclasses import dataclass

from tacbench_cad.lab.rig.camera_devices import STABLE_FOLDERS, Opener, cameras, open_capture
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.lab.rig.samples import parse_numbers
from tacbench_cad.util.errors import InputError, TacbenchError

#: Rates at which a port is listened to.
_BAUDS = (115_200, 9_600, 57_600, 230_400, 921_600)
#: Longest real time to wait for the first words after opening a port restarted the board.
_START_S = 2.5
#: Time over which a stream of samples is counted.
_LISTEN_S = 0.5
#: Least lines that tell a stream of samples.
_MIN_LINES = 4
#: Longest real time that each firmware is given to answer.
_ANSWER_S = 3.0


@dataclass(frozen=True, kw_only=True)
class PluggedCamera:
    """A camera that is plugged in.

    Args:
        name: Its stable name, for ``[sensor] device``.
        size_px: Width and height of the pictures that it gives unasked, or None if it does not open.
    """

    name: str
    size_px: tuple[int, int] | None


def plugged_cameras(opener: Opener = open_capture) -> tuple[PluggedCamera, ...]:
    """The cameras with a stable name, each opened for a moment.

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


def identify(port: str) -> str:
    """Ask what is at a port. Opening it restarts many boards, so only ports that a person names are asked.

    First it is listened to at the usual rates: gauges and taxels talk unasked. Then it is greeted as GRBL and as
    Marlin. Nothing that moves is sent.

    Args:
        port: Path, name or pyserial URL.

    Returns:
        A line for people.

    Raises:
        InputError: There is no such port.
    """
    from tacbench_cad.lab.rig.grbl import GrblStage
    from tacbench_cad.lab.rig.marlin import MarlinStage

    heard = _listen(port)
    if heard is not None:
        return heard
    for stage in (GrblStage, MarlinStage):
        try:
            with stage(port, clock=Clock(), timeout_s=_ANSWER_S) as device:
                return device.identity
        except InputError:
            raise
        except TacbenchError:
            continue
    return "no numbers, no GRBL, no Marlin"


def _listen(port: str) -> str | None:
    """What a device that talks unasked is, or None."""
    from tacbench_cad.lab.rig.line import Line

    with Line(port, baud=_BAUDS[0], what="device") as line:
        for i, baud in enumerate(_BAUDS):
            if i:
                line.set_baud(baud)
            first = line.read_line(_START_S if i == 0 else _LISTEN_S)
            if first is None and i == 0:
                # It says nothing at all, not even in the wrong rate.
                return None
            lines = [] if first is None else [first, *line.lines(_LISTEN_S)]
            columns = Counter(len(numbers) for text in lines if (numbers := parse_numbers(text)) is not None)
            count, times = columns.most_common(1)[0] if columns else (0, 0)
            if times >= max(_MIN_LINES, 0.7 * len(lines)):
                rate = times / _LISTEN_S
                return f"samples of {count} number(s), about {rate:.0f} a second at {baud} baud: {lines[-1][:40]}"
            if lines and not any("\ufffd" in text for text in lines):
                # Plain words: the rate is right, and it is no stream of samples.
                return None
    return None
