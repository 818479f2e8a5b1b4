"""The names of :mod:`tacbench_cad.extensions.foreign_meshes`, for type checkers and for its lazy loading alike."""

from .files import textured_mesh as textured_mesh
from .files import write_textured_mesh as write_textured_mesh
from .on_mesh import TexturedMesh as TexturedMesh
