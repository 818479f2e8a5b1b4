"""Frames of the simulated sensor with the true positions of their markers, and the detection rates of a finder."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tacbench_cad.extensions.markers.markers import Markers
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.simulate.appearances import look_named
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.simulate.tactip import PinPositions, TacTip
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N

#: The largest distance between a marker and its detection, in pixels.
NEAR_PX = 3.0


def simulated_frames(look: str, presses: int, seed: int = 0) -> Iterator[tuple[Frame, PinPositions]]:
    """Yield frames and their true markers: a frame without contact, then presses of textures 2 and 4.

    The positions are random; the forces take turns.
    """
    sensor = TacTip(look=look_named(look))
    rng = np.random.default_rng(seed)
    pins = sensor.pins(None, (0.0, 0.0, 0.0))
    yield sensor.frame(pins, rng), sensor.markers(pins)
    grounds = [
        contact_for(PrintedBlock(block=Block.of(number), printer="form-3", filament="grey-v4"), HolderRim())
        for number in (2, 4)
    ]
    for i in range(presses):
        ground, (x, y) = grounds[i % 2], rng.uniform((4.0, 18.0), (9.0, 23.0))
        pins = sensor.pins(ground, (x, y, ground.z_for_force(x, y, FORCES_N[i % 3])))
        yield sensor.frame(pins, rng), sensor.markers(pins)


def detection_rates(
    frames: Iterable[tuple[Frame, PinPositions]], find: Callable[[Frame], Markers]
) -> tuple[float, float, float]:
    """Return the fraction of visible markers found, the fraction of false ones, and the rms error in pixels."""
    visible = false = 0
    errors: list[NDArray[np.float64]] = []
    for frame, truth in frames:
        centres = find(frame).centres_px
        distance = cKDTree(centres).query(truth.centres_px[truth.visible])[0]
        errors.append(distance[distance < NEAR_PX])
        visible += len(distance)
        false += int(np.sum(cKDTree(truth.centres_px).query(centres)[0] > NEAR_PX))
    everything = np.concatenate(errors)
    return len(everything) / visible, false / visible, float(np.sqrt(np.mean(everything**2)))
