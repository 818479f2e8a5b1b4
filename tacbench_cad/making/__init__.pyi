"""The names of :mod:`tacbench_cad.making`, for type checkers and for its lazy loading alike."""

from .choice import described as described
from .labelled import blocks_named as blocks_named
from .printset import build as build
from .request import Request as Request
from .request import blocks_of as blocks_of
from .request import plan as plan
from .showing import request_of as request_of
from .showing import write_view as write_view
from .texturing import part_name as part_name
from .texturing import textured as textured
from .writing import export as export
