"""Slice a block with PrusaSlicer or CuraEngine."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from helpers.outsiders import Run

#: The folder in which Debian's package ``cura`` installs the definitions of printers and extruders.
CURA_DEFINITIONS = Path("/usr/share/cura/resources")
_ENDER_3 = CURA_DEFINITIONS / "definitions" / "creality_ender3.def.json"


def cura_search_path() -> str | None:
    """Return the value for ``CURA_ENGINE_SEARCH_PATH``; None if the definitions are missing."""
    folders = [str(CURA_DEFINITIONS / name) for name in ("definitions", "extruders")]
    return os.pathsep.join(folders) if _ENDER_3.is_file() else None


def by_prusa(run: Run, model: Path, target: Path, layer_mm: float, *options: str, nozzle_mm: float = 0.4) -> Path:
    """Slice with PrusaSlicer: equal layers, a skirt, a brim and 20 % infill."""
    run(
        [
            *("--export-gcode", "--layer-height", f"{layer_mm}", "--first-layer-height", f"{layer_mm}"),
            *("--nozzle-diameter", f"{nozzle_mm}", "--filament-diameter", "1.75", "--skirts", "2", "--brim-width", "3"),
            *("--fill-density", "20%", *options, "--output", target, model),
        ]
    )
    return target


def by_cura(run: Run, model: Path, target: Path, layer_mm: float, options: Sequence[str] = ()) -> Path:
    """Slice with CuraEngine for an Ender-3: equal layers, a skirt and 20 % infill."""
    settings = (
        f"layer_height={layer_mm}",
        f"layer_height_0={layer_mm}",
        "machine_end_gcode=",  # only Cura's window replaces its placeholders
        "adhesion_type=skirt",
        "infill_sparse_density=20",
        *options,
    )
    words = [word for setting in settings for word in ("-s", setting)]
    own = ("roofing_layer_count=0", "material_diameter=1.75", *settings[4:])
    extruder = [word for setting in own for word in ("-s", setting)]
    run(["slice", "-j", _ENDER_3, *words, "-e0", *extruder, "-o", target, "-l", model])
    return target
