"""grblHAL 1.1f: where it differs from GRBL on the wire."""

from __future__ import annotations

from collections.abc import Mapping

from tacbench_cad.virtual_rig.grbl import Grbl
from tacbench_cad.virtual_rig.grbl_memory import Dialect
from tacbench_cad.virtual_rig.machine import Carriage

#: How grblHAL 1.1f differs on the wire.
GRBLHAL = Dialect(
    banner="GrblHAL 1.1f ['$' or '$HELP' for help]",
    version="[VER:1.1f.20200818:SIMULATED]",
    options="[OPT:VNMZSL,35,1024,3,0]",
    fresh_memory="error:7",
    status_in_alarm=True,
    alarm_pause_s=0.0,
    abort_alarm=False,
    more_fields="|A:|H:0|TLR:0",
    buffer_field=True,
    status_s=0.005,
)


class GrblHal(Grbl):
    """grblHAL 1.1f: answers in ALARM:2, resets in motion without an alarm, reports more, and has more room.

    Args:
        carriage: What it moves.
        settings: ``$`` settings that differ from GRBL's.
        boot_s: Seconds from a reset to the banner.
    """

    rx_bytes = 1024

    def __init__(self, carriage: Carriage, *, settings: Mapping[int, float] | None = None, boot_s: float = 0.3) -> None:
        super().__init__(carriage, settings=settings, boot_s=boot_s, dialect=GRBLHAL)
