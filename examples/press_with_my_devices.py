"""Press a block with your own devices: any objects with the methods of the interface.

Replace the two classes by objects that call the libraries of your robot and of your sensor. Those below only pretend:
they say that they are simulated, and their clock never waits, so the example takes some seconds.

    python examples/press_with_my_devices.py RIG.toml FOLDER
"""

import math
import sys

import numpy as np

from tacbench_cad import Block, lab
from tacbench_cad.lab.rig import Clock

CLOCK = Clock(speed=math.inf)


class MyStage:
    """A stage that is always where it should be."""

    identity, simulated = "my arm", "stage of the example"
    clock = CLOCK  # only for a simulation: the time of the whole rig
    at = (0.0, 0.0, 50.0)

    def home(self):
        """Find the end stops."""
        MyStage.at = (0.0, 0.0, 50.0)

    def move(self, target_mm, speed_mm_s):
        """Move in a straight line, wait, and return the position. Your arm: arm.move_to(*target_mm, speed_mm_s)."""
        MyStage.at = target_mm
        return target_mm

    def position(self):
        """Return the position in mm."""
        return MyStage.at

    def stop(self):
        """Stop at once. It is called in the middle of a move and never raises."""

    def close(self):
        """Close the connection."""


class MySensor:
    """A sensor of 12 x 16 pixels that become brighter the deeper it is pressed into a flat block."""

    name, units, shape = "my skin", "counts", (12, 16)
    simulated, settings = "sensor of the example", {}
    random = np.random.default_rng(0)

    def read(self):
        """Return a new frame. Yours: camera.read()."""
        depth_mm = max(0.0, 10.0 - MyStage.at[2])  # rig.toml: the block's highest point is at z = 10 mm
        return np.uint8(60.0 + 100.0 * depth_mm + self.random.normal(0.0, 1.0, self.shape))

    def close(self):
        """Close the camera."""


if __name__ == "__main__":
    alignment, out = sys.argv[1:]
    rig = lab.Rig(stage=MyStage(), sensor=MySensor(), alignment=alignment)
    run = lab.press(Block.of(4), rig, out, printer="mk4", filament="pla", depths_mm=(0.5, 1.0), repeats=2)
    print(run)
