"""The names of :mod:`tacbench_cad.render`, for type checkers and for its lazy loading alike."""

from .bodies import relief_of as relief_of
from .raster import Body as Body
from .raster import Camera as Camera
from .raster import render as render
from .viewing.page import page_of as page_of
from .viewing.page import require_page as require_page
from .viewing.scene import Scene as Scene
from .viewing.scene import SceneFormula as SceneFormula
from .viewing.scene import Thing as Thing
