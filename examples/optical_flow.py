"""The mean optical flow since the frame without contact, as a feature of variance, classification and report.

python examples/optical_flow.py runs
"""

import sys

import cv2
import numpy as np

from tacbench_cad import lab
from tacbench_cad.lab.runs import grey, read_frame, runs_of


class OpticalFlow(lab.Feature):
    """The mean optical flow (Farneback 2003) in each of ``cells`` x ``cells`` parts of the image, in px."""

    name, unit, few_numbers, summary = "flow", "px", True, "the mean optical flow"

    def __init__(self, cells=4):
        self.cells = cells

    def fit(self, presses, y=None):
        self.rest_ = {str(run.folder): grey(*run.resting_frames(1)).astype(np.uint8) for run in runs_of(presses)}
        return super().fit(presses, y)

    def of_press(self, row):
        frame = grey(read_frame(row.frame)).astype(np.uint8)
        flow = cv2.calcOpticalFlowFarneback(self.rest_[row.folder], frame, None, 0.5, 3, 15, 3, 5, 1.2, 0)
        return cv2.resize(flow, (self.cells, self.cells), interpolation=cv2.INTER_AREA).astype(np.float64)


if __name__ == "__main__":
    presses = lab.read(sys.argv[1])
    print(lab.variance(presses, OpticalFlow()).table)
    print(lab.classify(presses, OpticalFlow(cells=8), trials=1).table)
    print(lab.report(presses, "flow.html", OpticalFlow())[0])
