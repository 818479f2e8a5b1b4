"""The names of :mod:`tacbench_cad.extensions.foreign_meshes`, for type checkers and for its lazy loading alike."""

from .on_mesh import texture_on_mesh as texture_on_mesh
