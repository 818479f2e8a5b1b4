"""The design of a study: which textures, prints, positions and forces a table of presses has, and what is unknown."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.published import variance_of
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.press_table import COLUMNS, STEP, runs_of, simulated_parts
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.names import COMBINATIONS
from tacbench_cad.lab.study.spec import UNKNOWN, ContactMode, Pressed, PrintedBlock, Protocol
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import natural_unique
from tacbench_cad.util.types import Floats

#: The facts that may be unknown, each with its column.
FACTS = {"label": "texture", "print": "copy", "force": "force_level"}
FACTS |= {name: name for name in ("printer", "filament", "session", "position", "repeat")}


def keyed(presses: pd.DataFrame) -> pd.DataFrame:
    """Return presses in their order, with the columns by which analyses group them.

    Unknown texts are ``unknown`` and unknown numbers are 0 in the result. If the repeat is unknown, the samples of one
    print, level and position are numbered. Three columns are added: ``combination`` (printer and filament,
    ``bambu-p1p_pla-minus``), ``level`` (the force level) and ``print_number`` (the copy as a number from 1).

    Args:
        presses: The table, see :mod:`tacbench_cad.lab.runs.press_table`. Columns that it does not have are unknown.

    Raises:
        InputError: The table has no row or no frame, or contains a press twice.
    """
    if presses.empty:
        raise InputError("presses", 0, "must be at least one press")
    if "frame" not in presses:
        raise InputError("presses", None, "has no column frame, the path of the frame's file")
    table = _with_all_columns(presses).reset_index(drop=True)
    table["run"] = table["run"].astype(object).fillna(UNKNOWN)
    if table["press"].isna().any():
        table["press"] = np.arange(1, len(table) + 1)
    twice = table.duplicated(_identity(table))
    if twice.any():
        row = table[twice].iloc[0]
        raise InputError("presses", f"{row['run']} {row['press']}", "is in the table twice")
    for name in ("texture", "printer", "filament", "session"):
        table[name] = table[name].astype(object).fillna(UNKNOWN).astype(str)
    table["combination"] = table["printer"] + "_" + table["filament"]
    table["level"], table["position"] = (table[name].fillna(0).astype("int64") for name in ("force_level", "position"))
    if all(isinstance(copy, int | np.integer) for copy in table["copy"]):
        table["print_number"] = table["copy"] = table["copy"].astype("int64")
    else:
        table["copy"] = [UNKNOWN if pd.isna(copy) else str(copy) for copy in table["copy"]]
        table["print_number"] = np.unique(table["copy"].to_numpy(str), return_inverse=True)[1] + 1
    if table["repeat"].isna().any() or not table["planned"].eq(True).all():
        same = ["combination", "texture", "copy", "level", "position", *([STEP] if STEP in table else [])]
        table["repeat"] = table.groupby(same, sort=False).cumcount() + 1
    table["repeat"] = table["repeat"].astype("int64")
    return table


def at_level(presses: pd.DataFrame, level: int) -> pd.DataFrame:
    """Return the presses at one force level; 0 stands for an unknown level.

    Raises:
        InputError: No press has this level.
    """
    levels = _with_all_columns(presses)["force_level"].fillna(0).astype(int)
    if level not in levels.unique():
        known = ", ".join(map(str, sorted(levels.unique())))
        raise InputError("force-level", level, f"must be a level of the runs: {known}")
    return presses[levels == level].reset_index(drop=True)


def unknown_facts(presses: pd.DataFrame) -> frozenset[str]:
    """Return the facts of :data:`FACTS` that are unknown for some press."""
    known = _with_all_columns(presses)
    return frozenset(fact for fact, column in FACTS.items() if known[column].isna().any())


def _with_all_columns(presses: pd.DataFrame) -> pd.DataFrame:
    """Return presses with every column of the table; those that they do not have are missing values."""
    return presses.reindex(columns=list(dict.fromkeys((*COLUMNS, *presses.columns))))


def _identity(presses: pd.DataFrame) -> list[str]:
    """Return the columns that identify a row."""
    return ["run", "press", *([STEP] if STEP in presses else [])]


def _in_order(presses: pd.DataFrame) -> pd.DataFrame:
    """Return the presses by run, press and step; the runs keep the order in which they are in the table."""
    runs = {name: number for number, name in enumerate(presses["run"].unique())}
    numbered = presses.assign(run_number=presses["run"].map(runs))
    return numbered.sort_values(["run_number", *_identity(presses)[1:]], ignore_index=True)


def data_key(presses: pd.DataFrame) -> str:
    """Return a checksum that identifies presses and their frames, or their series."""
    columns = ["run", "press", "image_sha256", *([STEP, "measured_force_n"] if STEP in presses else [])]
    text = presses[columns].to_csv(index=False, header=False)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """The design of a study, computed from its table of presses with :meth:`of`.

    Args:
        presses: The table from :func:`keyed`, by run, press and step. ``run_number`` is the index into ``runs``, if all
            presses are in run folders.
        runs: The runs; none for frames that are in no run folder.
        unknown: The facts of :data:`FACTS` that are unknown for some press.
    """

    presses: pd.DataFrame
    runs: tuple[Run, ...]
    unknown: frozenset[str]

    @classmethod
    def of(cls, presses: pd.DataFrame) -> Design:
        """Compute the design of a study.

        Raises:
            InputError: The presses are not comparable, so they cannot be analysed together: they have another grid,
                block or sensor, or two runs have the same print. The message names both runs and the difference.
        """
        unknown = unknown_facts(presses)
        runs = runs_of(_with_all_columns(presses))
        require_comparable(runs, series=STEP in presses)
        design = cls(presses=_in_order(keyed(presses)), runs=runs, unknown=unknown)
        _ = design.level_values  # checks that a level has the same force in all runs
        return design

    def __len__(self) -> int:
        """Return the number of presses, also if the table has their series."""
        return len(self.first_steps)

    @cached_property
    def first_steps(self) -> pd.DataFrame:
        """One row for each press: of series, the row of the first step."""
        return self.presses[self.presses[STEP] == 1].reset_index(drop=True) if self.steps else self.presses

    @cached_property
    def steps(self) -> int:
        """The number of frames of each press's series; 0 if the table has the frames of presses."""
        return int(self.presses[STEP].max()) if STEP in self.presses else 0

    @cached_property
    def textures(self) -> tuple[str, ...]:
        """The names of the textures in natural order: ``material-2`` before ``material-10``."""
        return tuple(natural_unique(self.presses["texture"].to_numpy(str))[0].tolist())

    @cached_property
    def combinations(self) -> tuple[str, ...]:
        """The printer-filament combinations: first the paper's, in its order, then others by name."""
        order = {f"{printer}_{filament}": i for i, (printer, filament) in enumerate(COMBINATIONS)}
        names = natural_unique(self.presses["combination"].to_numpy(str))[0].tolist()
        return tuple(sorted(names, key=lambda name: order.get(name, 99)))

    @cached_property
    def levels(self) -> tuple[int, ...]:
        """The force levels, sorted; 0 stands for an unknown level."""
        return tuple(sorted(self.presses["level"].unique().tolist()))

    @property
    def info(self) -> RunInfo | None:
        """The contents of the first ``run.json``, for facts that all runs have in common; None without a run."""
        return self.runs[0].info if self.runs else None

    @property
    def protocol(self) -> Protocol | None:
        """The protocol that planned the presses; None for other people's frames."""
        return self.info.protocol if self.info else None

    @property
    def planned(self) -> bool:
        """Whether a protocol planned the presses."""
        return self.protocol is not None

    @property
    def block(self) -> Block | None:
        """A block of the study; None if its geometry is unknown."""
        return self.info.printed.block if self.info else None

    @property
    def frame_shape(self) -> tuple[int, ...]:
        """The shape of the sensor's frames; empty if it is unknown."""
        return (self.info.frame_shape if self.info else None) or ()

    @property
    def sensor(self) -> str:
        """The name of the sensor; empty if it is unknown."""
        names = self.presses["sensor"].dropna()
        return "" if names.empty else str(names.iloc[0])

    @property
    def units(self) -> str:
        """The unit of the sensor's frames: ``counts`` for images."""
        units = self.presses["units"].dropna()
        return "counts" if units.empty else str(units.iloc[0])

    @property
    def in_counts(self) -> bool:
        """Whether the frames have counts of images, as in the paper."""
        return self.units == "counts"

    @cached_property
    def simulated(self) -> tuple[str, ...]:
        """The simulated parts of the data, each part once; empty for real data."""
        return tuple(simulated_parts(self.presses))

    @cached_property
    def data_key(self) -> str:
        """A checksum that identifies the presses and their frames, or their series."""
        return data_key(self.presses)

    @cached_property
    def contact(self) -> ContactMode | None:
        """Whether the levels are forces or depths; None if unknown."""
        known = self.presses["contact"].dropna()
        return None if known.empty else known.iloc[0]

    @cached_property
    def level_values(self) -> Mapping[int, float | None]:
        """The force in N, or the depth in mm, of each level; None if only the name of the level is known.

        Raises:
            InputError: A level has different forces in different runs.
        """
        protocol = self.protocol
        if protocol is not None:
            targets = protocol.targets
            return dict(enumerate(targets.forces_n if targets.contact == "force" else targets.depths_mm, start=1))
        values: dict[int, float | None] = {}
        for level, of_level in self.presses.groupby("level"):
            forces = [None if pd.isna(force) else float(force) for force in of_level["target_force_n"].unique()]
            if len(forces) > 1:
                raise InputError("force level", level, f"has the forces {forces} N in different runs; read them alone")
            values[int(str(level))] = forces[0]
        return values

    @cached_property
    def positions_mm(self) -> Floats:
        """The coordinates of each position, (n, 2), in mm; NaN if unknown."""
        if self.protocol is not None:
            return self.protocol.positions.grid.positions_mm
        placed = self.presses[self.presses["position"] > 0]
        positions = np.full((int(placed["position"].max()) if len(placed) else 0, 2), np.nan)
        for position, of_position in placed.groupby("position"):
            places = of_position[["pose_x", "pose_y"]].drop_duplicates()
            if len(places) == 1:
                positions[int(str(position)) - 1] = places.to_numpy(np.float64)[0]
        return positions

    @cached_property
    def grid(self) -> PressGrid | None:
        """The grid of the positions; None if they do not form a grid."""
        positions = self.positions_mm
        if self.protocol is not None:
            return self.protocol.positions.grid
        if not len(positions) or not np.isfinite(positions).all():
            return None
        x_mm, y_mm = (tuple(np.unique(places).tolist()) for places in positions.T)
        grid = PressGrid(x_mm=x_mm, y_mm=y_mm)
        return grid if np.array_equal(grid.positions_mm, positions) else None

    @cached_property
    def repeats(self) -> int:
        """The largest number of samples of one print at one position and level."""
        return self.protocol.repeats if self.protocol is not None else int(self.presses["repeat"].max())

    def level_name(self, level: int | str) -> str:
        """Return the name of a level for figures and tables: ``1.91 N``, ``1.70 mm deep``, ``mean of all forces``."""
        depth = self.contact == "depth"
        if isinstance(level, str):
            return "mean of all depths" if depth else "mean of all forces"
        value = self.level_values.get(level)
        if value is None:
            return f"force level {level}" if level else "force unknown"
        return f"{value:.2f} mm deep" if depth else f"{value:.2f} N"

    def has(self, fact: str) -> bool:
        """Whether a fact of :data:`FACTS` is known for every press."""
        return fact not in self.unknown

    @property
    def unknown_groups(self) -> tuple[str, ...]:
        """The unknown groups of other people's frames, of ``prints`` and ``sessions``; empty for planned presses."""
        return () if self.planned else tuple(f"{group}s" for group in ("print", "session") if not self.has(group))

    def require(self, purpose: str, *needed: str) -> None:
        """Check that the facts are known that an analysis needs.

        Args:
            purpose: The analysis: ``the variance table``.
            needed: Facts of :data:`FACTS`. An argument such as ``print or repeat`` needs only one of its facts.

        Raises:
            InputError: A fact is unknown. The message says which column is missing.
        """
        for words in needed:
            if not any(self.has(word) for word in words.split(" or ")):
                first = words.partition(" ")[0]
                raise InputError(
                    purpose,
                    None,
                    f"needs the {words} of every sample, which is unknown for these runs; import them with a column "
                    f"for it: --columns {first}=COLUMN",
                )

    @cached_property
    def beside_paper(self) -> bool:
        """Whether a comparison with the paper makes sense.

        It does if the presses were planned, or if the paper has a figure for one of their printers, filaments and
        textures. It never does for series, because the paper's sensor did not move in contact.
        """
        names = self.presses[["printer", "filament", "texture"]].drop_duplicates().itertuples(index=False)
        return not self.steps and (self.planned or any(variance_of(*map(str, of)) is not None for of in names))


def require_comparable(runs: Sequence[Run], *, series: bool = False) -> None:
    """Check that runs can be analysed together.

    Args:
        runs: The runs.
        series: Whether their series of moving frames are analysed, so that their motions must be the same.

    Raises:
        InputError: Two runs have the same print, or their presses are not comparable.
    """
    seen: dict[str, Run] = {}
    files: dict[tuple[str | None, ...], tuple[Block | str | None, Path]] = {}
    for run in runs:
        first, known = runs[0], _common(runs[0].info, series)
        for what, value in _common(run.info, series).items():
            expected = known.get(what, value)  # the block may be known in some imported runs and unknown in others
            if value != expected:
                raise InputError(
                    what, value, f"in {run.folder}, but {expected!r} in {first.folder}; analyse them separately"
                )
        printed = run.info.printed
        file = _printed_file(printed)
        # The files of a texture have the same name for all printers, and the same content for each printer.
        stem, both = file and file.texture.name, (printed.texture, printed.combination)
        for key, value in ((both[:1], stem), (both, file)):
            other, folder = files.setdefault(key, (value, run.folder))
            if other != value:
                allowed = f"of {run.folder} differs from that of {folder}; analyse them separately"
                raise InputError("printed file", stem, allowed)
        name = printed.name
        if name in seen:
            raise InputError("run", str(run.folder), f"has the same print as {seen[name].folder}: {name}")
        seen[name] = run


def _printed_file(printed: Pressed) -> Block | None:
    """Return the block in the printed file, if it differs from the block that the print is expected to equal."""
    return printed.file if isinstance(printed, PrintedBlock) else None


def _common(info: RunInfo, series: bool) -> dict[str, object]:
    """Return the facts that must be equal in all runs, so that their presses are comparable."""
    block, protocol, common = info.printed.block, info.protocol, dict[str, object]()
    if protocol is not None:
        targets, grid = protocol.targets, protocol.positions.grid
        levels = "forces_n" if targets.contact == "force" else "depths_mm"
        common = {"contact": targets.contact, levels: list(getattr(targets, levels))}
        common["grid"] = [[round(place, 9) for place in line] for line in (grid.x_mm, grid.y_mm)]
        common |= {"motion": str(protocol.motion)} if series else {}
    if block is not None:
        common |= {"block size": [round(side, 9) for side in block.size_mm]}
        common |= {"preset": block.preset, "scale": block.scale}
        file = _printed_file(info.printed)
        common |= {"printed file": "that of the block" if file is None else "another than that of the block"}
    return {
        "protocol": "none" if protocol is None else "planned",
        **common,
        "sensor": info.sensor.get("name"),
        "sensor shape": list(info.frame_shape or ()),
        "sensor units": info.sensor.get("units"),
    }
