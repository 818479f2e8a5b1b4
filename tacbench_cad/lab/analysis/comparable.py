"""Which runs can be analysed together: those whose presses are comparable."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import Pressed, PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError


def require_comparable(runs: Sequence[Run]) -> None:
    """Check that the runs can be analysed together.

    Raises:
        InputError: Two runs have the same print, or their presses are not comparable.
    """
    first = runs[0]
    seen: dict[str, Run] = {}
    files: dict[tuple[str | None, ...], tuple[Block | str | None, Path]] = {}
    for run in runs:
        known = _common(first.info)
        for what, value in _common(run.info).items():
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


def _common(info: RunInfo) -> dict[str, object]:
    """Return the facts that must be equal in all runs, so that their presses are comparable."""
    block, protocol, common = info.printed.block, info.protocol, dict[str, object]()
    if protocol is not None:
        levels = "forces_n" if protocol.targets.contact == "force" else "depths_mm"
        common = {"contact": protocol.targets.contact, levels: list(getattr(protocol.targets, levels))}
        grid = protocol.positions.grid
        common["grid"] = [[round(place, 9) for place in line] for line in (grid.x_mm, grid.y_mm)]
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
