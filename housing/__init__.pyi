# The public names. lazy_loader reads this file at run time; type checkers and editors read it as well.

from . import bd as bd
from . import cq as cq
from .assembly import Assembly as Assembly
from .coupon import CLEARANCES_MM as CLEARANCES_MM
from .coupon import FLOOR_MM as FLOOR_MM
from .coupon import GAP_MM as GAP_MM
from .coupon import STUB_MM as STUB_MM
from .coupon import TAB_MM as TAB_MM
from .coupon import Coupon as Coupon
from .fits import FITS as FITS
from .fits import clearance_mm as clearance_mm
from .fixture import Fixture as Fixture
from .holder import Holder as Holder
from .jig import Jig as Jig
from .kinds import FIXTURES as FIXTURES
from .lettering import HEIGHT_MM as HEIGHT_MM
from .marks import DATUM_MM as DATUM_MM
from .marks import DEPTH_MM as DEPTH_MM
from .marks import HAIR_MM as HAIR_MM
from .placement import Placement as Placement
from .seat import AIR_MM as AIR_MM
from .shapes import Rectangle as Rectangle
