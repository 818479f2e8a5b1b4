"""Read presses as a table and as arrays, and test a pipeline of scikit-learn on splits that do not leak.

    python examples/own_pipeline.py runs

The folder has runs, or images with a table or in a folder for each class.
"""

import sys

from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline

from tacbench_cad import lab

# My data as a table and as arrays
presses = lab.read(sys.argv[1])  # a pandas.DataFrame: one row for each press
frames = lab.frames(presses, size=(64, 48))  # numpy, (n, 48, 64); lazily with lab.iter_frames
print(presses[["texture", "printer", "copy", "position", "measured_force_n"]].head())
print(frames.shape, frames.dtype)

# My own pipeline on splits that do not leak
pipeline = make_pipeline(lab.Pixels(size=(64, 48)), RandomForestClassifier())
print(cross_val_score(pipeline, presses, presses.texture, cv=lab.HoldOut("copy")))
