"""The input of every target (a block, its closed mesh, and its heights on an even grid) and the output of a target."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from tacbench_cad.geometry import Cells, Certificate, Mesh, mesh_block, prove_axis, vertical
from tacbench_cad.spec import VALUES, Block, SampleGrid, grid_of_same_step
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The intended largest distance between the surface of an even grid and the formula, in mm.
GRID_DISTANCE_MM = 0.025
#: The grid is at most this many times as fine as the preset's own grid. If that is too coarse for
#: :data:`GRID_DISTANCE_MM`, the grid is used all the same, and its note states the larger error.
MAX_TIMES = 8
#: The largest number of samples of a grid. Larger files would be of no practical use.
MAX_SAMPLES = 20_000_000
#: The density of the printed blocks (PLA), in kg/m^3, for the calculation of masses.
DENSITY_KG_M3 = 1240.0


@dataclass(frozen=True, kw_only=True)
class TargetFiles:
    """The files that a target has written into a folder.

    Args:
        files: The paths of the files relative to the folder, with ``/``.
        note: Markdown for the folder's README: files, units, axes, error, contact settings, and tests.
    """

    files: tuple[str, ...]
    note: str


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightField:
    """Heights on an even grid, in the block frame.

    Args:
        x_mm: The x coordinates of the columns, from 0 to the length of the side, shape (nx,).
        y_mm: The y coordinates of the rows, shape (ny,).
        z_mm: The heights, shape (ny, nx). Row 0 is at y = 0, and column 0 is at x = 0.
        certificate: Proved bounds for the surface that joins the samples by triangles. They hold for both choices of
            the diagonal in each cell.
    """

    x_mm: Floats
    y_mm: Floats
    z_mm: Floats
    certificate: Certificate

    @property
    def pitch_mm(self) -> tuple[float, float]:
        """The distance between neighbouring samples along x and y, in mm."""
        return (float(self.x_mm[-1]) / (len(self.x_mm) - 1), float(self.y_mm[-1]) / (len(self.y_mm) - 1))


@dataclass(frozen=True, eq=False)
class SimulatorAsset:
    """A block that is exported to simulators.

    Args:
        block: The block, without a key. The meshes keep its label.

    Raises:
        InputError: The block has a key or an outline. A height field is a rectangle.
    """

    block: Block

    def __post_init__(self) -> None:
        if self.block.key_mm is not None:
            raise InputError("key", self.block.key_mm, "must not be set; only blocks without a key can be exported")
        if self.block.outline is not None:
            raise InputError("outline", str(self.block.outline), "must not be set; only rectangles can be exported")

    @property
    def name(self) -> str:
        """The name of the texture, which is also the stem of the file names."""
        return self.block.texture.name

    @cached_property
    def _meshed(self) -> tuple[Mesh, Certificate]:
        return mesh_block(self.block)

    @property
    def mesh(self) -> Mesh:
        """The closed mesh for printing, in mm."""
        return self._meshed[0]

    @property
    def mesh_certificate(self) -> Certificate:
        """The proved bounds for the top of the mesh."""
        return self._meshed[1]

    @cached_property
    def heights(self) -> HeightField:
        """The heights on an even grid.

        If the block has a sample grid, that grid is used; otherwise a grid that is fine enough for
        :data:`GRID_DISTANCE_MM`, within the limits of :data:`MAX_TIMES` and :data:`MAX_SAMPLES`.
        """
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
        """The mass of the block in kg, if it is printed in PLA with 100 % infill."""
        return self.block.volume_mm3(self.block.datum_mm) * 1e-9 * DENSITY_KG_M3


def sampled(block: Block, grid: SampleGrid) -> HeightField:
    """Evaluate the formula of a block on a grid.

    Args:
        block: The block. Its datum is kept, also if the grid has other samples than the block's own.
        grid: The numbers of samples.

    Raises:
        InputError: The grid has more than :data:`MAX_SAMPLES` samples.
    """
    if grid.nx * grid.ny > MAX_SAMPLES:
        raise InputError(
            "grid", f"{grid.nx}x{grid.ny}", f"must have at most {MAX_SAMPLES:,} samples; use a smaller domain"
        )
    x, y = replace(block, sampling=grid).samples_mm
    z = block.surface.grid(x, y)
    return HeightField(
        x_mm=x,
        y_mm=y,
        z_mm=block.datum_mm + z.T,
        certificate=_certificate(block, x, y, z).plus(block.surface.error, block.surface.evidence),
    )


def _certificate(block: Block, x: Floats, y: Floats, z: Floats) -> Certificate:
    surface = block.surface
    if surface.is_separable:
        bound = vertical(
            prove_axis(surface.along_u, x, surface.along_u(x)), prove_axis(surface.along_v, y, surface.along_v(y))
        )
    else:
        cells = Cells(surface, x, y)
        bound = max(float(cells.prove(z, rising=way).max()) for way in (False, True))
    return Certificate(distance_mm=bound, vertical_mm=bound)
