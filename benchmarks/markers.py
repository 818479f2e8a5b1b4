"""Measure how many markers are found and followed, how exactly and how fast, against OpenCV's blob detector.

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

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.vision.markers import MarkerFinder, Markers, grey
from tacbench_cad.lab.vision.tracking import MarkerTracker

#: For each look: smallest fraction found, largest fraction false; the detector's threshold, areas and circularity.
LOOKS = {
    "tactip-bristol": ((0.99, 0.005), (60, (38, 209), None)),
    "tactip-sussex": ((0.95, 0.05), (60, (31, 173), 0.5)),
}
LIMIT_MS, LIMIT_RMS_PX = 15.0, 0.2


def blob_detector(threshold: float, areas: tuple[int, int], circularity: float | None) -> Callable[[Frame], Markers]:
    """OpenCV's blob detector, called in the same way as our finder."""
    how = cv2.SimpleBlobDetector_Params()
    how.blobColor, how.minThreshold, how.maxThreshold = 255, threshold, 255
    how.minArea, how.maxArea = areas
    how.filterByCircularity, how.minCircularity = circularity is not None, circularity or 0.1
    how.filterByConvexity = how.filterByInertia = False
    detector = cv2.SimpleBlobDetector_create(how)

    def find(frame: Frame) -> Markers:
        centres = np.array([point.pt for point in detector.detect(grey(frame).astype(np.uint8))]).reshape(-1, 2)
        return Markers(centres_px=centres, contrast=np.ones(len(centres)), quality=np.ones(len(centres)))

    return find


def milliseconds(call: Callable[[Frame], object], frames: Sequence[Frame]) -> float:
    """Median processor time of a call on a frame, in ms."""
    times = []
    for frame in frames:
        began = time.process_time()
        call(frame)
        times.append(1e3 * (time.process_time() - began))
    return statistics.median(times)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--presses", type=int, default=60)
    presses = parser.parse_args().presses
    cv2.setNumThreads(1)
    held = True
    for look, ((least, most), tuned) in LOOKS.items():
        shots = list(simulated_frames(look, presses))
        frames = [frame for frame, _ in shots[1:]]
        began = time.process_time()
        finder = MarkerFinder.learn([shots[0][0]])
        learned = time.process_time() - began
        tracker = MarkerTracker(reference_px=finder.find(shots[0][0]).centres_px)
        found, false, rms = detection_rates(shots[1:], finder.find)
        took = milliseconds(finder.find, frames)
        follow = milliseconds(tracker.follow, [finder.find(frame).centres_px for frame in frames])
        blobs = blob_detector(*tuned)
        blobs_found, blobs_false, blobs_rms = detection_rates(shots[1:], blobs)
        blobs_took = milliseconds(blobs, frames[:10])
        print(f"{look}, {len(frames)} presses (learned in {learned:.2f} s)")
        print(
            f"  ours:  {found:.2%} found, {false:.2%} false, {rms:.3f} px rms; {took:.1f} ms, following {follow:.1f} ms"
        )
        print(f"  blobs: {blobs_found:.2%} found, {blobs_false:.2%} false, {blobs_rms:.3f} px rms; {blobs_took:.1f} ms")
        print(f"  our time divided by the blob detector's: {took / blobs_took:.2f}")
        held &= found >= least and false <= most and rms <= LIMIT_RMS_PX and took < LIMIT_MS
    print("every claim holds" if held else "a claim does not hold")
    return 0 if held else 1


if __name__ == "__main__":
    raise SystemExit(main())
