"""Textures for simulators: a folder for each texture, with each engine's files and a note of frame, units and contact.

A print format is one part in one file, checked and put in place by itself (:mod:`tacbench_cad.formats`). A target here
is several files that refer to each other and to the folder that they lie in, so these have a package of their own. A
new target is one file here and one row of :data:`SIMULATOR_TARGETS`. Every writer needs the base install only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.formats.simulators import glb, heightmaps, mjcf, obj, sdf, taxim, urdf, usd
from tacbench_cad.formats.simulators.asset import SimulatorAsset, TargetFiles


@dataclass(frozen=True)
class SimulatorTarget:
    """What a texture can be exported to.

    Args:
        name: What ``--to`` calls it.
        title: Heading of its note.
        write: Writes its files into an existing folder, of which it makes the subfolders.
    """

    name: str
    title: str
    write: Callable[[SimulatorAsset, Path], TargetFiles]


#: What a texture can be written for, by the names of ``--to``.
SIMULATOR_TARGETS: dict[str, SimulatorTarget] = {
    target.name: target
    for target in (
        SimulatorTarget("mjcf", "MuJoCo (MJCF)", mjcf.write_mjcf),
        SimulatorTarget("urdf", "URDF, for PyBullet", urdf.write_urdf),
        SimulatorTarget("sdf", "SDFormat, for Drake", sdf.write_sdf),
        SimulatorTarget("usd", "OpenUSD", usd.write_usd),
        SimulatorTarget("glb", "glTF (binary)", glb.write_glb),
        SimulatorTarget("obj", "Wavefront OBJ", obj.write_obj),
        SimulatorTarget("npy", "NumPy array of heights", heightmaps.write_npy),
        SimulatorTarget("png16", "16-bit PNG of heights", heightmaps.write_png16),
        SimulatorTarget("taxim", "Taxim (PLY of the top)", taxim.write_taxim),
    )
}
