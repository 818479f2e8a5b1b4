"""The runs of a study as one table of presses; readings stay on the disk until they are asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run, find_runs
from tacbench_cad.lab.study.names import COMBINATIONS
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Ints

Chosen = Ints | Bools


def _of_print(name: str) -> cached_property[NDArray[Any]]:
    """What each press was made on: an attribute of the printed block."""

    def values(self: Collection) -> NDArray[Any]:
        return np.array([getattr(run.info.printed, name) for run in self.runs])[self.run]

    return cached_property(values)


def _of_press(place: int) -> cached_property[NDArray[Any]]:
    """What each press was: an entry of its row's key."""

    def values(self: Collection) -> NDArray[Any]:
        pairs = zip(self.run.tolist(), self.number.tolist(), strict=True)
        return np.array([self._rows[run][number].key[place] for run, number in pairs], dtype=np.int64)

    return cached_property(values)


@dataclass(frozen=True, kw_only=True, eq=False)
class Collection:
    """Presses of one or many runs that may be compared: the same protocol, grid, kind of block and sensor.

    Every array has one entry a press, in the order of runs and then of press numbers.

    Args:
        runs: The runs.
        run: Index into ``runs``, shape (n,).
        number: Press number within the run, shape (n,).
        features: What is taken of a reading: its numbers, or how far the markers in its image moved.
    """

    runs: tuple[Run, ...]
    run: Ints
    number: Ints
    features: Literal["pixels", "markers"] = "pixels"

    @classmethod
    def open(cls, folders: Sequence[Path]) -> Collection:
        """Open the runs in, or below, some folders.

        Raises:
            InputError: There is no run, one cannot be read or has no press, two are of the same print, or two must not
                be mixed; the message names both and what differs.
        """
        runs = tuple(Run.open(folder) for folder in find_runs(folders))
        _require_mixable(runs)
        empty = next((run for run in runs if not run.rows), None)
        if empty is not None:
            raise InputError("run", str(empty.folder), "has no press yet; finish it or leave it out")
        numbers = [sorted(row.number for row in run.rows) for run in runs]
        return cls(
            runs=runs,
            run=np.repeat(np.arange(len(runs)), [len(presses) for presses in numbers]),
            number=np.concatenate([np.array(presses, dtype=np.int64) for presses in numbers]),
        )

    def __len__(self) -> int:
        return len(self.run)

    def chosen(self, which: Chosen) -> Collection:
        """The presses at some indices, or where a mask is true."""
        return replace(self, run=self.run[which], number=self.number[which])

    def at_level(self, level: int) -> Collection:
        """The presses of one force level.

        Raises:
            InputError: There is none.
        """
        if level not in self.levels:
            raise InputError("force-level", level, f"the runs have {', '.join(map(str, self.levels))}")
        return self.chosen(self.level == level)

    @property
    def info(self) -> RunInfo:
        """What all runs have in common: the first one's."""
        return self.runs[0].info

    @property
    def simulated(self) -> tuple[str, ...]:
        """What of any run was simulated, each once; empty for real data."""
        return tuple(dict.fromkeys(what for run in self.runs for what in run.info.simulated))

    @property
    def units(self) -> str:
        """The unit of a reading's numbers: ``counts`` for images, ``px`` for displacements of their markers."""
        return "px" if self.features == "markers" else str(self.info.sensor.get("units", "counts"))

    @property
    def in_counts(self) -> bool:
        """Whether readings are counts of an image, as the paper's are."""
        return self.units == "counts"

    @cached_property
    def data_key(self) -> str:
        """Names the presses by the checksums of their readings."""
        digest = hashlib.sha256()
        for run, number in zip(self.run.tolist(), self.number.tolist(), strict=True):
            row = self._rows[run][number]
            digest.update(f"{self.runs[run].info.printed.name} {number} {row.image_sha256}\n".encode())
        return digest.hexdigest()

    #: Name of the texture, printer, filament, and both of these (``bambu-p1p_pla-minus``), each (n,).
    texture = _of_print("texture")
    printer = _of_print("printer")
    filament = _of_print("filament")
    combination = _of_print("combination")
    #: Number of the print's copy, (n,).
    copy = _of_print("copy")
    #: Force level, repeat and position, each from 1, (n,).
    level = _of_press(0)
    repeat = _of_press(1)
    position = _of_press(2)

    @property
    def textures(self) -> tuple[str, ...]:
        """The textures there are, sorted."""
        return tuple(str(value) for value in np.unique(self.texture))

    @property
    def combinations(self) -> tuple[str, ...]:
        """The printer-filament combinations there are: the paper's in its order, then others by name."""
        order = {f"{printer}_{filament}": i for i, (printer, filament) in enumerate(COMBINATIONS)}
        return tuple(sorted((str(value) for value in np.unique(self.combination)), key=lambda c: (order.get(c, 99), c)))

    @property
    def levels(self) -> tuple[int, ...]:
        """The force levels there are."""
        return tuple(int(value) for value in np.unique(self.level))

    def frame(self, index: int) -> Frame:
        """The reading of a press, as it was recorded.

        Raises:
            CheckFailedError: Its file is missing or damaged; the message names it.
        """
        run = int(self.run[index])
        return self.runs[run].frame(self._rows[run][int(self.number[index])])

    def path(self, index: int) -> str:
        """Where a press's reading lies, from its run folder: ``sensor_images/image_7.png``."""
        return schema.frame_path(self._rows[int(self.run[index])][int(self.number[index])].sensor_image)

    @cached_property
    def _rows(self) -> list[dict[int, schema.Row]]:
        return [{row.number: row for row in run.rows} for run in self.runs]


def _require_mixable(runs: Sequence[Run]) -> None:
    """Refuse runs that cannot stand in one table.

    Raises:
        InputError: Two runs are of the same print, or differ in what makes presses comparable.
    """
    first = runs[0]
    seen: dict[str, Run] = {}
    for run in runs:
        for what, value in _common(run.info).items():
            expected = _common(first.info)[what]
            if value != expected:
                raise InputError(
                    what, value, f"in {run.folder}, but {expected!r} in {first.folder}; analyse them apart"
                )
        name = run.info.printed.name
        if name in seen:
            raise InputError("run", str(run.folder), f"is of the same print as {seen[name].folder}: {name}")
        seen[name] = run


def _common(info: RunInfo) -> dict[str, object]:
    """What must be equal for presses to be comparable."""
    block, protocol = info.printed.block, info.protocol
    grid = [[round(place, 9) for place in line] for line in (protocol.grid.x_mm, protocol.grid.y_mm)]
    levels = "forces_n" if protocol.contact == "force" else "depths_mm"
    return {
        "contact": protocol.contact,
        levels: list(getattr(protocol, levels)),
        "grid": grid,
        "block size": [round(side, 9) for side in block.size_mm],
        "preset": block.preset,
        "scale": block.scale,
        "sensor": info.sensor.get("name"),
        "sensor shape": list(info.frame_shape or ()),
        "sensor units": info.sensor.get("units"),
    }
