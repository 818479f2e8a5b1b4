"""Statistics of public frames of two TacTips, and the same statistics of the simulated looks that follow them.

``tactip-bristol``: mattclifford1/tactip-sensor-IQM-VIS, one still image for each press. ``tactip-sussex``: the
recording Movement4 of shepai/RoboSkin. The values are medians over some 10 frames; a range covers several recordings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from helpers.frame_measure import (
    Dome,
    find_dome,
    find_pins,
    frame_statistics,
    grey_of,
    light_outside,
    noise_by_level,
)
from tacbench_cad.lab.simulate import LOOKS, TacTip, contact_for
from tacbench_cad.lab.study import HolderRim, PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N

#: The allowed deviation from the measured value: this fraction, or the absolute value for the unit if that is larger.
FRACTION = 0.2
SLACK = {"counts": 5.0, "px": 0.3}
#: Statistic; unit; tactip-bristol; tactip-sussex.
MEASURED = """
dome centre, column; px; 304; 301
dome centre, row; px; 248; 262
dome radius; px; 210; 169
motion of the dome's centre, peak to peak; px; 0.14; 1.3
motion of the dome's radius, peak to peak; px; 0.07; 1.8
blur of the dome's edge; px; 1.2; 1.0
rings of pins, farthest from the measured radius; px; 0; 0
pins seen; 1; 331; 119
peaks of the Laplacian; 1; 331; 127
pin width, centre; px; 11.7; 9.1
pin width, middle; px; 11.2; 10.4
pin width, rim; px; 10.5; 10.0
pin spacing, centre; px; 19; 13
pin spacing, middle; px; 17; 16
pin spacing, rim; px; 16; 15
blur of a pin's edge, centre; px; 0.73; 1.2
blur of a pin's edge, middle; px; 0.75; 1.2
blur of a pin's edge, rim; px; 0.95; 1.3
pin peak, centre; counts; 150; 247
pin peak, middle; counts; 139; 248
pin peak, rim; counts; 145; 248
skin between pins, centre; counts; 22; 92
skin between pins, middle; counts; 23; 89
skin between pins, rim; counts; 24; 95
skin beyond the pins; counts; 31; 109
grey at 1.02 R; counts; 191; 248
B of the pins; counts; 195; 227
G of the pins; counts; 144; 240
R of the pins; counts; 106; 237
B of the skin; counts; 36; 92
G of the skin; counts; 25; 96
R of the skin; counts; 22; 106
mean, whole frame; counts; 113; 188
mean, inside; counts; 54; 127
mean, outside; counts; 160; 212
5 % quantile, inside; counts; 16; 81
50 % quantile, inside; counts; 29; 103
95 % quantile, inside; counts; 145; 247
saturated, whole frame; %; 3.1; 3.5
saturated, inside; %; 0.16; 2.3
saturated, outside; %; 4.8; 3.8
bright spots; 1; 9; 17.5
bright spots, largest diameter; px; 8.3; 34
Laplacian after a blur of 0, whole frame; counts^2; 573; 102 to 193
Laplacian after a blur of 2, whole frame; counts^2; 14; 8
Laplacian after a blur of 0, inside; counts^2; 1023; 467
Laplacian after a blur of 2, inside; counts^2; 27; 22
noise at 16 to 32; counts; 1.37;
noise at 32 to 48; counts; 1.25;
noise at 48 to 64; counts; 1.09;
noise at 64 to 96; counts; 0.96;
noise at 96 to 128; counts; 0.91;
noise at 128 to 160; counts; 0.76;
noise at 160 to 192; counts; 0.78;
noise at 0 to 256; counts; ; 0 to 0.24
drift in 100 presses; %; 0.6;
light from press to press; %; 0.18;
drift in a minute; %; ; -1.0 to 0.3
light from frame to frame; %; ; 0.004 to 0.26
light at the start of a recording; %; ; 7
step ratio of blocks; 1; 1.0; 1.10 to 1.38
"""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """The properties of a sensor that are needed to measure its frames.

    Args:
        dome: The outline of the dome.
        rings_px: The radii of the rings of pins at rest.
        log: Sigma and threshold of the Laplacian of a Gaussian that finds the pins.
        levels: The ranges of grey levels for which the noise was measured.
        recording: The number of frames in which the motion of the dome was measured.
    """

    dome: Dome
    rings_px: tuple[float, ...]
    log: tuple[float, float]
    levels: tuple[tuple[int, int], ...]
    recording: int

    @property
    def field(self) -> float:
        """The radius of the field of pins, as a fraction of the dome's radius."""
        return self.rings_px[-1] / self.dome.radius


SENSORS = {
    "tactip-bristol": Sensor(
        dome=Dome(x=304.0, y=248.0, radius=210.0),
        rings_px=(20.5, 39.0, 57.0, 74.0, 91.5, 108.0, 124.5, 140.0, 156.0, 170.0),
        log=(5.0, 30.0),
        levels=((16, 32), (32, 48), (48, 64), (64, 96), (96, 128), (128, 160), (160, 192)),
        recording=100,
    ),
    "tactip-sussex": Sensor(
        dome=Dome(x=301.0, y=262.0, radius=169.0),
        rings_px=(28.0, 41.0, 58.0, 75.0, 92.0, 108.0, 124.0),
        log=(3.5, 45.0),
        levels=((0, 256),),
        recording=40,
    ),
}


@dataclass(frozen=True, kw_only=True)
class Goal:
    """The measured range of a statistic of real frames, which a simulated statistic has to meet."""

    name: str
    unit: str
    low: float
    high: float

    @property
    def shown(self) -> str:
        """The measured value or range as text."""
        return f"{self.low:g}" if self.low == self.high else f"{self.low:g} to {self.high:g}"

    def met_by(self, value: float) -> bool:
        """Return whether a simulated value lies in the measured range, within the allowed deviation."""

        def slack(measured: float) -> float:
            return max(FRACTION * abs(measured), SLACK.get(self.unit, 0.0))

        return self.low - slack(self.low) <= value <= self.high + slack(self.high)


def goals(look: str) -> dict[str, Goal]:
    """Return the goals of a look by the names of their statistics."""
    chosen = {}
    for line in MEASURED.strip().splitlines():
        name, unit, *values = (cell.strip() for cell in line.split(";"))
        low, _, high = values[list(SENSORS).index(look)].partition(" to ")
        if low:
            chosen[name] = Goal(name=name, unit=unit, low=float(low), high=float(high or low))
    return chosen


def simulated_statistics(look: str, *, presses: int = 6, recording: int | None = None) -> dict[str, float]:
    """Return the statistics of a look: medians over presses of the textures at the middle force, and of frames at rest.

    Args:
        look: The name of the look.
        presses: The number of presses whose frames are measured completely.
        recording: The number of presses in which the dome's motion is measured; None for the number of frames of the
            real recording.
    """
    sensor, tactip = SENSORS[look], TacTip(look=LOOKS[look])
    rng = np.random.Generator(np.random.SFC64(1))
    later = 20.0
    single: list[Mapping[str, float]] = []
    domes = []
    pressed = []
    for texture in range(1, 7):
        printed = PrintedBlock(block=Block.of(texture), printer="form-3", filament="grey-v4")
        contact = contact_for(printed, HolderRim())
        pressed.append((contact, (6.5, 20.5, contact.z_for_force(6.5, 20.5, FORCES_N[1]))))
    for i in range(recording or sensor.recording):
        pins = tactip.approach(*pressed[i % len(pressed)], rng)
        frame = tactip.frame(pins, rng, later)
        domes.append(find_dome(grey_of(frame).astype(np.float64), sensor.dome))
        if i < presses:
            markers = tactip.markers(pins)
            visible = markers.centres_px[markers.visible]
            single.append(frame_statistics(frame, sensor.dome, sensor.field, sensor.log, visible))
    values = {name: float(np.median([statistics[name] for statistics in single])) for name in single[0]}
    values["motion of the dome's centre, peak to peak"] = float(
        max(np.ptp([dome.x for dome in domes]), np.ptp([dome.y for dome in domes]))
    )
    values["motion of the dome's radius, peak to peak"] = float(np.ptp([dome.radius for dome in domes]))
    still = [tactip.frame(tactip.rest, rng, later) for _ in range(40)]
    at_rest = frame_statistics(still[0], sensor.dome, sensor.field, sensor.log)
    values |= {name: value for name, value in at_rest.items() if name.startswith("pin spacing")}
    pins_px = find_pins(grey_of(still[0]).astype(np.float64), sensor.dome, *sensor.log)
    radii = np.hypot(*(pins_px - (sensor.dome.x, sensor.dome.y)).T)
    rings = [float(np.median(radii[np.abs(radii - ring) < 5.0])) for ring in sensor.rings_px]
    off = float(np.max(np.abs(np.array(rings) - sensor.rings_px)))
    values["rings of pins, farthest from the measured radius"] = off
    for (low, high), noise in zip(sensor.levels, noise_by_level(still, sensor.levels, sensor.dome), strict=True):
        values[f"noise at {low} to {high}"] = noise
    light = light_outside(still, sensor.dome)
    values["light from frame to frame"] = 100.0 * float(np.std(np.diff(light)) / np.mean(light))
    values["light from press to press"] = 100.0 * float(np.std(light) / np.mean(light))
    start, first, last = (
        light_outside(
            [tactip.frame(tactip.rest, np.random.Generator(np.random.SFC64(i)), at) for i in range(8)], sensor.dome
        ).mean()
        for at in (0.0, 4.0, 404.0)
    )
    values["drift in 100 presses"] = 100.0 * (last / first - 1.0)
    values["drift in a minute"] = values["drift in 100 presses"] * 60.0 / 400.0
    values["light at the start of a recording"] = 100.0 * (start / first - 1.0)
    return values
