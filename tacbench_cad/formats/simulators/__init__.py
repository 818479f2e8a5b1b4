"""Textures for simulators: a folder a texture, each engine's files with a note of frame, units and contact settings.

A print format is one part in one file, checked and put in place by itself (:mod:`tacbench_cad.formats`). A target here
is several files that refer to each other and to the folder that they lie in, so these have a package of their own. A
new target is one file here and one row of :data:`SIMULATOR_TARGETS`. Every writer needs the base install only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.formats.simulators import glb, heightmaps, mjcf, obj, sdf, taxim, urdf, usd
from tacbench_cad.formats.simulators.asset import SimulatorAsset
from tacbench_cad.formats.simulators.written import TargetFiles


@dataclass(frozen=True, kw_only=True)
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
    row.name: row
    for row in (
        SimulatorTarget(name="mjcf", title="MuJoCo (MJCF)", write=mjcf.write_mjcf),
        SimulatorTarget(name="urdf", title="URDF, for PyBullet", write=urdf.write_urdf),
        SimulatorTarget(name="sdf", title="SDFormat, for Drake", write=sdf.write_sdf),
        SimulatorTarget(name="usd", title="OpenUSD", write=usd.write_usd),
        SimulatorTarget(name="glb", title="glTF (binary)", write=glb.write_glb),
        SimulatorTarget(name="obj", title="Wavefront OBJ", write=obj.write_obj),
        SimulatorTarget(name="npy", title="NumPy array of heights", write=heightmaps.write_npy),
        SimulatorTarget(name="png16", title="16-bit PNG of heights", write=heightmaps.write_png16),
        SimulatorTarget(name="taxim", title="Taxim (PLY of the top)", write=taxim.write_taxim),
    )
}
