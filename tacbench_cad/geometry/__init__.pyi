"""The names of :mod:`tacbench_cad.geometry`, for type checkers and for its lazy loading alike."""

from .block_mesh import mesh_block as mesh_block
from .block_part import as_part as as_part
from .block_part import block_spec as block_spec
from .mesh import Certificate as Certificate
from .mesh import ExpectedGeometry as ExpectedGeometry
from .mesh import Mesh as Mesh
from .mesh import cross as cross
from .mesh import manifold_of as manifold_of
from .meshing.certify import prove_axis as prove_axis
from .meshing.certify import vertical as vertical
from .meshing.certify_cells import Cells as Cells
from .meshing.top import single as single
from .part import PrintPart as PrintPart
from .textured.amount import added_volume_mm3 as added_volume_mm3
from .textured.body import Area as Area
from .textured.body import texture_body as texture_body
from .textured.field import Fade as Fade
from .textured.frame import Frame as Frame
from .textured.frame import axes_of as axes_of
from .textured.height import FLOOR_MM as FLOOR_MM
from .textured.height import around as around
from .textured.height import height_over as height_over
from .textured.height import require_fade as require_fade
from .textured.height_grid import body_between as body_between
from .texturing import Texturing as Texturing
from .texturing import texturing as texturing
