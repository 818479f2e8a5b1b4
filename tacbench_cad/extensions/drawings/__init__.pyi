"""The names of :mod:`tacbench_cad.extensions.drawings`, for type checkers and for its lazy loading alike."""

from .blocks import block_drawing as block_drawing
from .fixtures import coupon_drawing as coupon_drawing
from .fixtures import fixture_drawing as fixture_drawing
from .fixtures import holder_drawing as holder_drawing
from .fixtures import jig_drawing as jig_drawing
from .ink import save_drawing as save_drawing
from .sheet import Dimension as Dimension
from .sheet import Drawing as Drawing
