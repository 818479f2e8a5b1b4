"""Measure the detection rate, accuracy and speed of the marker finder, and compare them with OpenCV's blob detector.

    python benchmarks/markers.py [--presses 60]

The frames are simulated, so the true markers are known. A marker counts as visible if its peak is 5 standard
deviations of the noise above its surroundings and no reflection covers its centre. The blob detector uses thresholds,
areas and circularity that were tuned for these frames. Both run in the same process, so the ratio does not depend on
the machine.

Claims: for tactip-bristol (331 pins) at least 99 % are found and at most 0.5 % are false; for tactip-sussex (133 pins)
95 % and 5 %; centres are within 0.2 px rms; a frame of 640 x 480 takes less than 15 ms on one core.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from helpers.simulated_markers import detection_rates, simulated_frames

from tacbench_cad.extensions.markers.markers import MarkerFinder, Markers
from tacbench_cad.extensions.markers.tracking import MarkerTracker
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.frame_files import grey

#: For each look: the smallest fraction found and the largest fraction false; threshold, areas and circularity of the
#: blob detector.
LOOKS = {
    "tactip-bristol": ((0.99, 0.005), (60, (38, 209), None)),
    "tactip-sussex": ((0.95, 0.05), (60, (31, 173), 0.5)),
}
LIMIT_MS, LIMIT_RMS_PX = 15.0, 0.2


def blob_detector(threshold: float, areas: tuple[int, int], circularity: float | None) -> Callable[[Frame], Markers]:
    """Return OpenCV's blob detector as a function with the same interface as the marker finder."""
    settings = cv2.SimpleBlobDetector_Params()
    settings.blobColor, settings.minThreshold, settings.maxThreshold = 255, threshold, 255
    settings.minArea, settings.maxArea = areas
    settings.filterByCircularity, settings.minCircularity = circularity is not None, circularity or 0.1
    settings.filterByConvexity = settings.filterByInertia = False
    detector = cv2.SimpleBlobDetector_create(settings)

    def find(frame: Frame) -> Markers:
        centres = np.array([point.pt for point in detector.detect(grey(frame).astype(np.uint8))]).reshape(-1, 2)
        return Markers(centres_px=centres, contrast=np.ones(len(centres)), quality=np.ones(len(centres)))

    return find


def milliseconds(call: Callable[[Frame], object], frames: Sequence[Frame]) -> float:
    """Return the median processor time of a call for a frame, in ms."""
    times = []
    for frame in frames:
        start = time.process_time()
        call(frame)
        times.append(1e3 * (time.process_time() - start))
    return statistics.median(times)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--presses", type=int, default=60)
    presses = parser.parse_args().presses
    cv2.setNumThreads(1)
    holds = True
    for look, ((min_found, max_false), tuned) in LOOKS.items():
        shots = list(simulated_frames(look, presses))
        frames = [frame for frame, _ in shots[1:]]
        start = time.process_time()
        finder = MarkerFinder.learn([shots[0][0]])
        learned = time.process_time() - start
        tracker = MarkerTracker(reference_px=finder.find(shots[0][0]).centres_px)
        fraction_found, fraction_false, rms = detection_rates(shots[1:], finder.find)
        time_ms = milliseconds(finder.find, frames)
        tracking_ms = milliseconds(tracker.follow, [finder.find(frame).centres_px for frame in frames])
        blobs = blob_detector(*tuned)
        blobs_found, blobs_false, blobs_rms = detection_rates(shots[1:], blobs)
        blobs_ms = milliseconds(blobs, frames[:10])
        print(f"{look}, {len(frames)} presses (learned in {learned:.2f} s)")
        print(f"  ours:  {fraction_found:.2%} found, {fraction_false:.2%} false, {rms:.3f} px rms; ", end="")
        print(f"{time_ms:.1f} ms, following {tracking_ms:.1f} ms")
        print(f"  blobs: {blobs_found:.2%} found, {blobs_false:.2%} false, {blobs_rms:.3f} px rms; {blobs_ms:.1f} ms")
        print(f"  our time divided by the blob detector's: {time_ms / blobs_ms:.2f}")
        holds &= (
            fraction_found >= min_found and fraction_false <= max_false and rms <= LIMIT_RMS_PX and time_ms < LIMIT_MS
        )
    print("every claim holds" if holds else "a claim does not hold")
    return 0 if holds else 1


if __name__ == "__main__":
    raise SystemExit(main())
