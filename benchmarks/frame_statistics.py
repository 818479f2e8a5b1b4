"""Measure statistics of the frames of a TacTip, for simulated frames or for your own frames.

    python benchmarks/frame_statistics.py [--look tactip-bristol]
    python benchmarks/frame_statistics.py FILE.png ... --dome X,Y,R [--field R] [--log SIGMA,THRESHOLD]

The first command prints each statistic of a look next to the value that was measured on public frames of the same
sensor. Goal: within 20 % of the measured value or inside the measured range; for small values within 5 counts or 0.3
px.

The second command prints the same statistics of image files, as medians over the files. With several files it also
prints the noise and the drift of the light, in the order of the file names.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from helpers.frame_measure import Dome, find_dome, frame_statistics, grey_of, light_outside, noise_by_level
from helpers.real_frames import SENSORS, goals, simulated_statistics

LEVELS = ((0, 32), (32, 64), (64, 128), (128, 192), (192, 250))


def print_looks(looks: list[str]) -> bool:
    """Print one table of the looks and return whether every goal is met."""
    values = {look: simulated_statistics(look) for look in looks}
    chosen = {look: goals(look) for look in looks}
    print("| statistic |" + "".join(f" {look}: measured | simulated |" for look in looks))
    print("|---|" + "---|---|" * len(looks))
    missed = 0
    for goal in {goal.name: goal for of_look in chosen.values() for goal in of_look.values()}.values():
        unit = "" if goal.unit == "1" else f" ({goal.unit})"
        line = f"| {goal.name}{unit} |"
        for look in looks:
            if goal.name not in chosen[look]:
                line += " | |"
                continue
            value, is_met = values[look][goal.name], chosen[look][goal.name].met_by(values[look][goal.name])
            missed += not is_met
            line += f" {chosen[look][goal.name].shown} | {value:.3g}{'' if is_met else ' (goal missed)'} |"
        print(line)
    print(f"\n{missed} goals are not met")
    return missed == 0


def print_files(paths: list[Path], near: Dome, field: float, log: tuple[float, float]) -> None:
    """Print the statistics of image files."""
    frames = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths]
    for path, frame in zip(paths, frames, strict=True):
        if frame is None:
            raise SystemExit(f"{path}: OpenCV cannot read this file as an image.")
    try:
        single = [frame_statistics(frame, near, field / near.radius, log) for frame in frames]
    except ValueError as error:
        raise SystemExit(f"{error}; use --dome, --field and --log to describe the dome and the pins.") from None
    for name in single[0]:
        values = [statistics[name] for statistics in single if name in statistics]
        print(f"{name:45}{np.median(values):10.4g}{min(values):10.4g} to {max(values):.4g}")
    if len(frames) > 1:
        for (low, high), noise in zip(LEVELS, noise_by_level(frames, LEVELS, near), strict=True):
            print(f"{f'noise at {low} to {high}':45}{noise:10.4g}")
        light = light_outside(frames, near)
        print(f"{'light from frame to frame (%)':45}{100 * np.std(np.diff(light)) / np.mean(light):10.4g}")
        print(f"{'light from first to last (%)':45}{100 * (light[-1] / light[0] - 1):10.4g}")
        domes = [find_dome(grey_of(frame).astype(np.float64), near) for frame in frames]
        print(f"{'motion of the radius, peak to peak (px)':45}{np.ptp([dome.radius for dome in domes]):10.4g}")


def main() -> int:
    """Print the tables; the exit code is 1 if a goal is not met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, help="images of one size; without files: the looks")
    parser.add_argument("--look", choices=list(SENSORS), help="default: every look that is based on a real sensor")
    parser.add_argument("--dome", help="X,Y,R: a circle near the outline of the dome, in px; needed for FILES")
    parser.add_argument("--field", type=float, help="radius of the field of pins in px (default 0.78 R)")
    parser.add_argument("--log", default="4,30", help="sigma and threshold that find the pins (default 4,30)")
    options = parser.parse_args()
    if options.files:
        if options.dome is None:
            parser.error("FILES need --dome X,Y,R")
        x, y, radius = (float(part) for part in options.dome.split(","))
        sigma, threshold = (float(part) for part in options.log.split(","))
        print_files(options.files, Dome(x=x, y=y, radius=radius), options.field or 0.78 * radius, (sigma, threshold))
        return 0
    return 0 if print_looks([options.look] if options.look else list(SENSORS)) else 1


if __name__ == "__main__":
    raise SystemExit(main())
