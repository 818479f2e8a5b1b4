"""The known positions, forces and repeats of a study's presses, from the protocol of its runs or from their rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import ContactMode, Protocol
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Pressing:
    """The positions, forces and repeats of a study's presses.

    Args:
        protocol: The protocol; None for imported runs.
        contact: Whether the levels are forces or depths; None if unknown.
        levels: The force in N, or the depth in mm, of each level; None if only the name of the level is known. Level 0
            stands for an unknown level.
        positions_mm: The coordinates of each position, (n, 2), in mm; NaN if unknown.
        grid: The grid of the positions; None if they do not form a grid.
        repeats: The largest number of samples of one print at one position and level.
    """

    protocol: Protocol | None
    contact: ContactMode | None
    levels: Mapping[int, float | None]
    positions_mm: Floats
    grid: PressGrid | None
    repeats: int

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Pressing:
        """Collect the positions, forces and repeats of some runs.

        Raises:
            InputError: A level has different forces in different runs.
        """
        protocol = runs[0].info.protocol
        if protocol is not None:
            of_levels = protocol.targets.forces_n if protocol.targets.contact == "force" else protocol.targets.depths_mm
            return cls(
                protocol=protocol,
                contact=protocol.targets.contact,
                levels=dict(enumerate(of_levels, start=1)),
                positions_mm=protocol.positions.grid.positions_mm,
                grid=protocol.positions.grid,
                repeats=protocol.repeats,
            )
        levels: dict[int, float | None] = {}
        places: dict[int, set[tuple[float, float]]] = {}
        presses: Counter[tuple[object, ...]] = Counter()
        for run in runs:
            for row in run.rows:
                level, position = row.force_level or 0, row.position or 0
                if levels.setdefault(level, row.target_force_n) != row.target_force_n:
                    both = f"{row.target_force_n} N, but {levels[level]} N in other runs; import them together"
                    raise InputError("force level", level, f"is in {run.folder} {both}")
                places.setdefault(position, set()).add(row.pose_mm[:2])
                presses[
                    run.info.printed.combination, run.info.printed.texture, run.info.printed.copy, level, position
                ] += 1
        places.pop(0, None)
        positions = np.full((max(places, default=0), 2), np.nan)
        for position, of_position in places.items():
            if len(of_position) == 1:
                positions[position - 1] = of_position.pop()
        return cls(
            protocol=None,
            contact="force" if any(levels.values()) else None,
            levels=levels,
            positions_mm=positions,
            grid=_grid(positions),
            repeats=max(presses.values()),
        )

    def level_name(self, level: int | str) -> str:
        """Return the name of a level for figures and tables: ``1.91 N``, ``1.70 mm deep``, ``mean of all forces``."""
        depth = self.contact == "depth"
        if not isinstance(level, int):
            return "mean of all depths" if depth else "mean of all forces"
        value = self.levels.get(level)
        if value is None:
            return f"force level {level}" if level else "force unknown"
        return f"{value:.2f} mm deep" if depth else f"{value:.2f} N"


def _grid(positions_mm: Floats) -> PressGrid | None:
    """Return the grid that has these positions, row by row; None if there is none."""
    if not len(positions_mm) or not np.isfinite(positions_mm).all():
        return None
    x_mm, y_mm = (tuple(np.unique(places).tolist()) for places in positions_mm.T)
    grid = PressGrid(x_mm=x_mm, y_mm=y_mm)
    return grid if np.array_equal(grid.positions_mm, positions_mm) else None
