"""What every target is written from: a block, its closed mesh, and its heights on an even grid; and what it gives."""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from functools import cached_property

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.certify import paired, prove_axis, vertical
from tacbench_cad.geometry.meshing.certify_cells import Cells
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.presets import VALUES, grid_of_same_step
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: Distance from the formula that an even grid is made fine enough for, in mm.
GRID_DISTANCE_MM = 0.025
#: The grid is at most this many times as fine as the preset's own; past that its error is stated, not met.
MAX_TIMES = 8
#: Samples of one grid: beyond this the files are no longer of use.
MAX_SAMPLES = 20_000_000
#: Density of the printed blocks that masses are worked out from (PLA), in kg/m^3.
DENSITY_KG_M3 = 1240.0


@dataclass(frozen=True, kw_only=True)
class TargetFiles:
    """The files of one target in one folder.

    Args:
        files: Their paths from the folder, with ``/``.
        note: Markdown for the folder's README: files, units, axes, error, contact settings, what was tested.
    """

    files: tuple[str, ...]
    note: str


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
    """Heights on an even grid, in the block frame.

    Args:
        x_mm: Lines along x from 0 to the side, shape (nx,).
        y_mm: Lines along y, shape (ny,).
        z_mm: Heights, shape (ny, nx): row 0 lies at y = 0, column 0 at x = 0.
        certificate: What is proved of the surface that joins the samples by triangles, whichever the diagonals.
    """

    x_mm: Floats
    y_mm: Floats
    z_mm: Floats
    certificate: Certificate

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """Distance between neighbouring samples along x and y, in mm."""
        return (float(self.x_mm[-1]) / (len(self.x_mm) - 1), float(self.y_mm[-1]) / (len(self.y_mm) - 1))


@dataclass(frozen=True, eq=False)
class SimulatorAsset:
    """A block on its way into a simulator.

    Args:
        block: The block, without a key; its label is kept in the meshes.

    Raises:
        InputError: The block has a key: a height field cannot show the missing corner.
    """

    block: Block

    def __post_init__(self) -> None:
        if self.block.key_mm is not None:
            raise InputError("key", self.block.key_mm, "simulation assets are made of blocks without a key")

    @property
    def name(self) -> str:
        """Stem of the files: the texture's name."""
        return self.block.texture.name

    @cached_property
    def _meshed(self) -> tuple[Mesh, Certificate]:
        return mesh_block(self.block)

    @property
    def mesh(self) -> Mesh:
        """The closed mesh that is printed, in mm."""
        return self._meshed[0]

    @property
    def mesh_certificate(self) -> Certificate:
        """What is proved of the mesh's top."""
        return self._meshed[1]

    @cached_property
    def heights(self) -> HeightField:
        """Heights on an even grid: the block's own, or one that is fine enough for :data:`GRID_DISTANCE_MM`."""
        if isinstance(self.block.sampling, SampleGrid):
            return sampled(self.block, self.block.sampling)
        block = self.block
        coarse = grid_of_same_step(VALUES[block.preset], block.nominal_size_mm, block.nominal_mm_per_unit)
        field = sampled(block, coarse)
        for times in range(2, MAX_TIMES + 1):
            grid = SampleGrid(nx=(coarse.nx - 1) * times + 1, ny=(coarse.ny - 1) * times + 1)
            if field.certificate.distance_mm <= GRID_DISTANCE_MM or grid.nx * grid.ny > MAX_SAMPLES:
                break
            field = sampled(block, grid)
        return field

    @property
    def mass_kg(self) -> float:
        """Mass of the printed block, massive PLA, in kg."""
        return self.block.volume_mm3(self.block.datum_mm) * 1e-9 * DENSITY_KG_M3


def sampled(block: Block, grid: SampleGrid) -> HeightField:
    """The formula's heights on a grid of the block.

    Args:
        block: The block; its datum stays its own.
        grid: The samples.

    Raises:
        InputError: The grid has more than :data:`MAX_SAMPLES` samples.
    """
    if grid.nx * grid.ny > MAX_SAMPLES:
        raise InputError(
            "grid", f"{grid.nx}x{grid.ny}", f"must have at most {MAX_SAMPLES:,} samples; take a smaller domain"
        )
    x, y = replace(block, sampling=grid).samples_mm
    z = block.surface.grid(x, y)
    return HeightField(x_mm=x, y_mm=y, z_mm=block.datum_mm + z.T, certificate=_certificate(block, x, y, z))


def _certificate(block: Block, x: Floats, y: Floats, z: Floats) -> Certificate:
    surface = block.surface
    if surface.is_separable:
        proofs = (
            prove_axis(surface.along_u, x, surface.along_u(x)),
            prove_axis(surface.along_v, y, surface.along_v(y)),
        )
        high = vertical(*proofs)
        return Certificate(distance_mm=min(paired(*proofs), high), vertical_mm=high)
    cells = Cells(surface, x, y)
    falling, rising = (astuple(cells.prove(z, rising=way)) for way in (False, True))
    proof = [float(np.maximum(a, b).max()) for a, b in zip(falling, rising, strict=True)]
    return Certificate(distance_mm=proof[0], vertical_mm=proof[1])
