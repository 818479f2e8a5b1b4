"""The list of simulators. To add one, add a module to this package and a row to ``SIMULATOR_TARGETS``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.extensions.simulators import glb, heightmaps, mjcf, obj, sdf, taxim, urdf, usd
from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles


@dataclass(frozen=True)
class SimulatorTarget:
    """A format or engine that a texture can be exported to.

    Args:
        name: The word for ``--to``.
        title: The heading of the target's note.
        write: A function that writes the target's files into an existing folder. It creates the subfolders.
    """

    name: str
    title: str
    write: Callable[[SimulatorAsset, Path], TargetFiles]


#: The targets, by their words for ``--to``.
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
