"""The first press on a new rig: one press with little force in the middle of the press grid."""

from __future__ import annotations

from dataclasses import replace

from tacbench_cad.lab.study.spec import Study
from tacbench_cad.spec.protocol import PressGrid

#: The force of the press and the half width of its band, in N.
FORCE_N, BAND_N = 0.1, 0.02
#: The depth of the press below first touch on a rig without a gauge, in mm.
DEPTH_MM = 0.2
#: The force above which the press is stopped, in N.
LIMIT_N = 1.0
#: The longest step down, in mm.
STEP_MM = 0.05


def first_press(study: Study) -> Study:
    """Return a study of one careful press on the first block of a study.

    Forces, depth and steps are small, whatever the study's protocol says. Its other settings stay.
    """
    protocol = study.protocol
    x, y = protocol.grid.x_mm, protocol.grid.y_mm
    careful = replace(
        protocol,
        grid=PressGrid(x_mm=(x[len(x) // 2],), y_mm=(y[len(y) // 2],)),
        repeats=1,
        stationary_frames=0,
        forces_n=(FORCE_N,),
        bands_n=(BAND_N,),
        depths_mm=(DEPTH_MM,),
        hard_limit_n=min(protocol.hard_limit_n, LIMIT_N),
        approach_step_mm=min(protocol.approach_step_mm, STEP_MM),
    )
    return replace(
        study, blocks=(replace(study.blocks[0], levels=careful.all_levels),), protocol=careful, grid_spacing="own"
    )
