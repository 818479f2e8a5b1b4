"""Compare the simulated TacTip with the measurements that it was built from, and time a press and an image.

    python benchmarks/tactip.py [--runs 200]

Claims: markers at rest are within 0.3 px of 601 r / (48.9 + z); on a flat plate F = 0.47 d^1.5 within a factor of 2;
every pose has its target force within a hundredth of the paper's band; the deformation grows with the force on every
texture; computing one force takes less than 1 ms.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import time
from collections.abc import Callable
from itertools import product

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command sets it

import cv2
import numpy as np

from tacbench_cad.lab.simulate.appearances import CLEAN, LOOKS
from tacbench_cad.lab.simulate.contact import DomeContact, contact_for
from tacbench_cad.lab.simulate.heights import flat_plate
from tacbench_cad.lab.simulate.tactip import TacTip
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import DOME_RADIUS_MM, FORCE_SPREADS_N, FORCES_N, PressGrid, contact_radius_mm


def rng(seed: int = 0) -> np.random.Generator:
    """Return a generator of random numbers."""
    return np.random.Generator(np.random.SFC64(seed))


def worst_marker_px() -> float:
    """Return the largest distance between the centroid of a marker in an image and the position of its pin, in px."""
    image = TacTip(colour=False).image(None, (0.0, 0.0, 0.0), rng())
    weight = np.where(image > 20, image, 0).astype(np.uint8)
    count, labels = cv2.connectedComponents((weight > 0).astype(np.uint8))
    centres = []
    for label in range(1, count):
        moments = cv2.moments(np.where(labels == label, weight, 0).astype(np.float32))
        centres.append((moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]))
    worst = 0.0
    for pins, first, step, r, z in CLEAN.rings:
        for i in range(pins):
            azimuth, radius = math.radians(first + step * i), 601.0 * r / (48.9 + z)
            place = (319.5 + radius * math.cos(azimuth), 239.5 - radius * math.sin(azimuth))
            worst = max(worst, min(math.dist(place, centre) for centre in centres))
    return worst


def milliseconds(call: Callable[[int], object], runs: int) -> float:
    """Return the median time of a call, in ms."""
    times = []
    for i in range(runs):
        start = time.perf_counter()
        call(i)
        times.append(time.perf_counter() - start)
    return 1e3 * statistics.median(times)


def main() -> int:
    """Print the figures; the exit code is 1 if a claim does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="calls for each time (default 200)")
    runs = parser.parse_args().runs
    holds = True
    worst = worst_marker_px()
    holds &= worst <= 0.3
    print(f"markers at rest: at most {worst:.3f} px from 601 r / (48.9 + z)")

    plate = DomeContact(flat_plate())
    print(f"{'force (N)':>10}{'depth on a plate (mm)':>24}{'0.47 d^1.5 / F':>16}{'radius (mm)':>13}{'PAPER':>8}")
    for force in FORCES_N:
        z = plate.z_for_force(0.0, 0.0, force)
        overlap = plate.overlap(0.0, 0.0, z)
        radius = math.sqrt(np.count_nonzero(overlap.depth_mm) / math.pi) * overlap.cell_mm
        ratio = 0.47 * (-z) ** 1.5 / force
        holds &= 0.5 <= ratio <= 2.0
        print(f"{force:>10.4f}{-z:>24.3f}{ratio:>16.3f}{radius:>13.2f}{contact_radius_mm(force):>8.2f}")

    sensor, places = TacTip(colour=False), PressGrid.paper().positions_mm
    print(f"{'texture':>10}{'mean shift of the markers at the three forces (px)':>54}{'worst force error / band':>26}")
    for texture in range(1, 7):
        printed = PrintedBlock(block=Block.of(texture), printer="bambu-p1p", filament="pla-minus")
        contact = contact_for(printed, HolderRim())
        shifts, error = [], 0.0
        for force, band in zip(FORCES_N, FORCE_SPREADS_N, strict=True):
            distances = []
            for x, y in places:
                pose = (float(x), float(y), contact.z_for_force(x, y, force))
                error = max(error, abs(contact.force_n(*pose) - force) / band)
                tips = sensor.pins(contact, pose).tips_mm
                distances.append(
                    np.linalg.norm(sensor.camera.pixels(tips) - sensor.camera.pixels(sensor.rest.tips_mm), axis=1)
                )
            shifts.append(float(np.mean(distances)))
        holds &= shifts == sorted(shifts) and error < 0.01
        print(f"{texture:>10}{', '.join(f'{shift:.3f}' for shift in shifts):>54}{error:>26.5f}")

    cv2.setNumThreads(1)
    x, y = (float(value) for value in places[12])
    z = contact.z_for_force(x, y, FORCES_N[-1])
    one_force = milliseconds(lambda i: contact.force_n(x + 1e-4 * i, y, z), runs)
    holds &= one_force < 1.0
    print(f"one force at a new place: {one_force:.3f} ms (dome of {DOME_RADIUS_MM:g} mm at {FORCES_N[-1]} N)")
    print(
        f"pose for a force: {milliseconds(lambda i: contact.z_for_force(x + 1e-4 * i, y, FORCES_N[-1]), runs):.3f} ms"
    )
    print(f"pins: {milliseconds(lambda i: sensor.pins(contact, (x + 1e-4 * i, y, z)), runs):.3f} ms")
    for look, colour in product(LOOKS.values(), (False, True)):
        camera = TacTip(colour=colour, look=look)
        time_ms = milliseconds(lambda i, camera=camera: camera.frame(camera.rest, rng(i)), runs)  # type: ignore[misc]
        print(f"frame of {look.name}, {'colour' if colour else 'grey'}: {time_ms:.3f} ms")
    print(f"all claims: {'yes' if holds else 'NO'}")
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
