"""The looks of simulated TacTips: numbers of camera, light and geometry, which one renderer uses.

Lengths in the image are in px of a frame of 640 x 480; brightness is in counts (0 to 255, BT.601 grey). The numbers of
``tactip-bristol`` and ``tactip-sussex`` were measured on public frames of these sensors. If the frames leave a number
open, its comment says that it is a choice.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Interval, Len

from tacbench_cad.lab.study.spec import Seed
from tacbench_cad.spec.skin import CAMERA_BELOW_MM, FOCAL_PX, TIP_RADIUS_MM
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError

#: A limit for profiles that reach to the end of the image.
FAR = 1e6

#: Lengths in px or mm, levels of grey, and fractions.
Width = Annotated[float, Interval(ge=0.0, le=10_000.0)]
Counts = Annotated[float, Interval(ge=0.0, le=1000.0)]
Fraction = Annotated[float, Interval(ge=0.0, le=1.0)]
#: A ring of pins: their number, first azimuth and step in degrees, tip's r and z in the dome frame in mm.
Ring = tuple[int, float, float, float, float]
#: Values at increasing positions, with linear interpolation: ((position, value), ...).
Profile = Annotated[tuple[tuple[float, Counts], ...], Len(1)]
#: Colours by grey level, with linear interpolation from black at 0: ((grey, (blue, green, red)), ...).
Tint = Annotated[tuple[tuple[float, tuple[Counts, Counts, Counts]], ...], Len(1)]


@dataclass(frozen=True, kw_only=True)
class Spot(Checked):
    """A reflection of a shiny surface: a disc whose brightness is added to the image.

    Args:
        radius: The distance from the dome's centre, in radii of the dome.
        azimuth_deg: The direction from the centre, anticlockwise in the image.
        diameter_px: The width at half of the brightness.
        counts: The brightness of the centre; more than the camera's highest level saturates.
        edge_px: The width of the edge.
    """

    radius: Width
    azimuth_deg: float
    diameter_px: Width
    counts: float
    edge_px: Width


@dataclass(frozen=True, kw_only=True)
class Look(Checked):
    """A sensor's geometry, light and camera, in numbers.

    Args:
        name: The name of the look.
        source: The source of the numbers.
        rings: The pins at rest.
        focal_px: The focal length of the pinhole camera.
        centre_px: The column and row of the dome's axis.
        dome_px: The half widths of the dome along the image's columns and rows; 0 for no outline.
        dome_edge_px: The width of the dome's outline.
        pin_diameter_mm: The diameter of a pin.
        pin_counts: The brightness of pins at rest, at the centre, the middle and the rim of their field. A single value
            is the mean of pins that six LEDs light as matt discs.
        pin_spread: The standard deviation of the brightness from pin to pin, as a fraction.
        pin_edge_px: The width of a pin's edge, at the centre, the middle and the rim; a single value holds everywhere.
        skin: The brightness of the skin between and beyond the pins, by the distance from the centre in radii of the
            dome.
        surround: The brightness beyond the dome, including ring and vignetting, by the same distance.
        black_counts: The counts of the camera without any light.
        unevenness: The standard deviation of skin and of surround from place to place, as a fraction of each.
        unevenness_px: The correlation lengths of this unevenness.
        grain: The standard deviation of a fixed pattern from pixel to pixel, of skin and of surround, in counts: dust
            and texture, or camera noise that a video's compression has frozen.
        glints: Reflections on the skin.
        leds: LEDs and their reflections beyond the dome.
        white_counts: The highest level of the camera.
        tints: The colours of the dome and, up to given distances from its centre in its radii, of the parts beyond it.
        sharpening: The fraction of the difference between a frame and its average over 3 x 3 pixels that the camera
            adds to the frame.
        noise: The standard deviation of a pixel from frame to frame, by its level, in counts, after any compression.
        noise_in_each_channel: Whether each channel of a colour image has its own noise. Otherwise all channels share
            the same noise, as in cameras that send brightness at full and colour at half resolution.
        flicker: The standard deviation of the light from frame to frame, as a fraction.
        transients: Excess of the light at the start of a run, as a fraction, and the time in s in which it falls to
            1/e: an exposure that settles, or (below 0) lamps that become brighter as they warm up.
        jpeg_quality: The quality of a compression in blocks of 8 x 8 pixels; None for no compression.
        approach_mm: The standard deviation of the summit's position along x and y from one approach of a press to the
            next. It is a calibration: with it, the variance of repeats at the middle force is about 3 counts^2 at 40 %
            of the size, as the authors' notebooks saved it for repeats of single prints (2.6 to 3.7; Bambu, PLA-).
        sway_px: The standard deviation of the dome's outline from one approach to the next: of its centre along the
            columns and the rows, and of its radius.
        seed: The seed of the unevenness.
    """

    name: str
    source: str
    rings: Annotated[tuple[Ring, ...], Len(1)]
    focal_px: Annotated[float, Interval(ge=1.0, le=100_000.0)]
    centre_px: tuple[float, float]
    dome_px: tuple[Width, Width] = (0.0, 0.0)
    dome_edge_px: Width = 1.0
    pin_diameter_mm: Annotated[float, Interval(ge=0.01, le=10.0)]
    pin_counts: Annotated[tuple[Counts, ...], Len(1)]
    pin_spread: Fraction = 0.0
    pin_edge_px: Annotated[tuple[Annotated[float, Interval(ge=0.01, le=100.0)], ...], Len(1)]
    skin: Profile = ((0.0, 0.0),)
    surround: Profile = ((0.0, 0.0),)
    black_counts: Counts = 0.0
    unevenness: tuple[Fraction, Fraction] = (0.0, 0.0)
    unevenness_px: tuple[Width, Width] = (1.0, 1.0)
    grain: tuple[Counts, Counts] = (0.0, 0.0)
    glints: tuple[Spot, ...] = ()
    leds: tuple[Spot, ...] = ()
    white_counts: Annotated[int, Interval(ge=1, le=255)] = 255
    tints: Annotated[tuple[tuple[float, Tint], ...], Len(1)]
    sharpening: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.0
    noise: Profile
    noise_in_each_channel: bool = False
    flicker: Fraction
    transients: tuple[tuple[float, Annotated[float, Ge(1e-3)]], ...] = ()
    jpeg_quality: Annotated[int, Interval(ge=1, le=100)] | None = None
    approach_mm: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.0
    sway_px: tuple[Width, Width] = (0.0, 0.0)
    seed: Seed = 0

    @property
    def misses(self) -> bool:
        """Whether each approach of a press has its own error."""
        return any((self.approach_mm, *self.sway_px))

    @property
    def dome_radius_px(self) -> float:
        """The radius of the circle with the area of the dome's outline."""
        return math.sqrt(self.dome_px[0] * self.dome_px[1])


def rings_seen(
    counts: tuple[int, ...], radii_px: tuple[float, ...], first_deg: float, focal_px: float
) -> tuple[Ring, ...]:
    """Return rings of pins that the camera sees at given radii, as far from the centre as TIP_RADIUS_MM.

    Args:
        counts: The number of pins of each ring, equally spaced.
        radii_px: The radius of each ring in the image, from the dome's centre.
        first_deg: The azimuth of each ring's first pin.
        focal_px: The camera's focal length.
    """
    rings = []
    for count, radius in zip(counts, radii_px, strict=True):
        # This solves f t sin(a) = radius (below + t cos(a)) for the polar angle a.
        far = TIP_RADIUS_MM * math.hypot(focal_px, radius)
        polar = math.atan2(radius, focal_px) + math.asin(radius * CAMERA_BELOW_MM / far)
        rings.append(
            (count, first_deg, 360.0 / count, TIP_RADIUS_MM * math.sin(polar), TIP_RADIUS_MM * math.cos(polar))
        )
    return tuple(rings)


def _spots(*rows: tuple[float, float, float, float, float]) -> tuple[Spot, ...]:
    return tuple(
        Spot(radius=radius, azimuth_deg=azimuth, diameter_px=diameter, counts=counts, edge_px=edge)
        for radius, azimuth, diameter, counts, edge in rows
    )


#: Bright markers on black: only the pins are shown.
CLEAN = Look(
    name="clean",
    source="geometry measured on one TacTip of 133 pins; light and camera are ideal",
    rings=(
        (1, 0.0, 0.0, 0.0, 17.48),
        (12, 7.5, 30.0, 3.38, 17.14),
        (12, 7.5, 30.0, 4.90, 16.77),
        (12, 7.5, 30.0, 7.03, 15.98),
        (24, 7.5, 15.0, 9.03, 14.92),
        (24, 7.5, 15.0, 10.88, 13.60),
        (24, 7.5, 15.0, 12.53, 12.02),
        (24, 7.5, 15.0, 14.00, 10.30),
    ),
    focal_px=FOCAL_PX,
    centre_px=(319.5, 239.5),
    pin_diameter_mm=1.0,
    pin_counts=(200.0,),
    pin_edge_px=(1.5,),
    black_counts=2.0,
    tints=((FAR, ((255.0, (234.6, 255.0, 244.8)),)),),
    noise=((0.0, 1.4),),
    noise_in_each_channel=True,
    flicker=0.003,
)

BRISTOL = Look(
    name="tactip-bristol",
    source="stills of mattclifford1/tactip-sensor-IQM-VIS, 640 x 480, one for each press",
    rings=rings_seen(
        (1, *range(6, 66, 6)),
        (0.0, 20.5, 39.0, 57.0, 74.0, 91.5, 108.0, 124.5, 140.0, 156.0, 169.6),
        0.0,
        558.0,
    ),
    focal_px=558.0,
    centre_px=(304.0, 248.0),
    dome_px=(210.0, 210.0),
    dome_edge_px=4.0,
    pin_diameter_mm=1.36,
    pin_counts=(146.0, 136.0, 142.0),
    pin_spread=0.08,
    pin_edge_px=(2.5, 2.6, 3.8),
    skin=((0.0, 22.0), (0.45, 23.0), (0.8, 25.0), (0.9, 31.0), (1.0, 32.0)),
    surround=((1.0, 182.0), (1.1, 182.0), (1.3, 165.0), (1.5, 142.0), (1.8, 105.0), (2.0, 85.0)),
    unevenness=(0.2, 0.07),
    unevenness_px=(25.0, 50.0),
    grain=(1.0, 1.8),
    glints=_spots(
        (0.475, 48.0, 4.7, 300.0, 2.5),
        (0.477, 168.0, 5.1, 300.0, 2.5),
        (0.472, 288.0, 4.5, 300.0, 2.5),
        (0.70, 122.0, 4.9, 300.0, 2.5),
        (0.94, 20.0, 5.3, 300.0, 2.5),
        (0.93, 80.0, 4.9, 300.0, 2.5),
        (0.94, 168.0, 8.6, 300.0, 2.5),
        (0.95, 231.0, 4.7, 300.0, 2.5),
        (0.93, 281.0, 5.1, 300.0, 2.5),
    ),
    # Six LEDs, and the light of each on the parts around it.
    leds=_spots(
        *((1.075, 60.0 * i, 43.0, 400.0, 6.0) for i in range(6)),
        *((1.075, 60.0 * i, 60.0, 45.0, 40.0) for i in range(6)),
    ),
    tints=(
        (1.0, ((25.3, (36.0, 25.0, 22.0)), (138.5, (195.0, 144.0, 106.0)), (255.0, (255.0, 255.0, 255.0)))),
        (FAR, ((201.5, (185.0, 204.0, 203.0)), (255.0, (255.0, 255.0, 255.0)))),
    ),
    sharpening=1.2,
    noise=((24.0, 1.37), (40.0, 1.25), (56.0, 1.09), (80.0, 0.96), (112.0, 0.91), (144.0, 0.76), (176.0, 0.78)),
    flicker=0.0022,
    transients=((-0.0135, 600.0),),
    approach_mm=0.22,
    sway_px=(0.03, 0.015),
    seed=1,
)

SUSSEX = Look(
    name="tactip-sussex",
    source="the recording Movement4 of shepai/RoboSkin, 640 x 480, MPEG-4",
    rings=rings_seen((1, 12, 12, 12, 24, 24, 24, 24), (0.0, 28.0, 41.0, 58.0, 75.0, 92.0, 108.0, 124.0), 7.5, 521.0),
    focal_px=521.0,
    centre_px=(301.0, 262.0),
    dome_px=(165.0, 175.0),
    dome_edge_px=3.0,
    pin_diameter_mm=1.24,
    pin_counts=(242.0, 239.0, 237.0),
    pin_spread=0.01,
    pin_edge_px=(3.6, 3.6, 4.0),
    skin=(
        (0.0, 90.0),
        (0.45, 87.0),
        (0.7, 92.0),
        (0.76, 99.0),
        (0.85, 106.0),
        (0.92, 125.0),
        (0.96, 150.0),
        (1.0, 165.0),
    ),
    surround=(
        (1.0, 250.4),
        (1.11, 250.4),
        (1.13, 225.0),
        (1.22, 225.0),
        (1.25, 244.0),
        (1.42, 237.0),
        (1.84, 191.0),
        (2.1, 172.0),
        (2.6, 143.0),
    ),
    unevenness=(0.04, 0.025),
    unevenness_px=(30.0, 50.0),
    grain=(2.9, 2.8),
    glints=_spots(
        # A large one over four pins, small ones over one pin each, others between and beyond the pins.
        (0.205, 52.5, 34.0, 300.0, 8.0),
        (0.444, 112.5, 6.0, 300.0, 4.0),
        (0.343, 217.5, 9.0, 300.0, 5.0),
        (0.444, 232.5, 6.0, 300.0, 4.0),
        (0.343, 277.5, 6.0, 300.0, 4.0),
        (0.444, 322.5, 6.0, 300.0, 4.0),
        (0.544, 22.5, 6.0, 300.0, 4.0),
        (0.343, 157.5, 6.0, 300.0, 4.0),
        (0.243, 337.5, 6.0, 300.0, 4.0),
        (0.80, 60.0, 6.0, 300.0, 3.0),
        (0.83, 130.0, 5.5, 300.0, 3.0),
        (0.86, 200.0, 6.0, 300.0, 3.0),
        (0.82, 255.0, 5.5, 300.0, 3.0),
        (0.87, 310.0, 6.5, 300.0, 3.0),
        (0.69, 15.0, 5.0, 300.0, 3.0),
        (0.69, 195.0, 5.0, 300.0, 3.0),
        (0.80, 95.0, 5.5, 300.0, 3.0),
        (0.85, 340.0, 6.5, 300.0, 3.0),
    ),
    white_counts=251,
    # The white ring round the dome, a green one round that, and the rest.
    tints=(
        (1.0, ((98.0, (92.0, 96.0, 106.0)), (237.6, (227.0, 240.0, 237.0)), (255.0, (255.0, 255.0, 255.0)))),
        (1.12, ((246.4, (250.0, 252.0, 234.0)), (250.0, (252.0, 252.0, 248.0)), (255.0, (255.0, 255.0, 255.0)))),
        (1.23, ((225.0, (205.0, 240.0, 203.0)), (255.0, (255.0, 255.0, 255.0)))),
        (FAR, ((246.4, (250.0, 252.0, 234.0)), (255.0, (255.0, 255.0, 255.0)))),
    ),
    sharpening=0.3,
    noise=((0.0, 0.2),),
    flicker=0.0005,
    transients=((0.07, 0.7), (-0.004, 600.0)),
    jpeg_quality=88,
    approach_mm=0.22,
    sway_px=(0.25, 0.42),
    seed=2,
)

#: The looks by their names.
LOOKS: Mapping[str, Look] = {look.name: look for look in (CLEAN, BRISTOL, SUSSEX)}


def look_named(name: str) -> Look:
    """Return a look by its name.

    Raises:
        InputError: There is no look with this name.
    """
    if name not in LOOKS:
        raise InputError("look", name, f"must be one of: {', '.join(LOOKS)}")
    return LOOKS[name]
