# The public names. lazy_loader reads this file at run time; type checkers and editors read it as well.

from . import bd as bd
from . import coupon as coupon
from . import cq as cq
from . import lettering as lettering
from . import marks as marks
from . import seat as seat
from .assembly import Assembly as Assembly
from .coupon import Coupon as Coupon
from .fits import FITS as FITS
from .fits import clearance_mm as clearance_mm
from .fixture import Fixture as Fixture
from .holder import Holder as Holder
from .jig import Jig as Jig
from .kinds import FIXTURES as FIXTURES
from .placement import Placement as Placement
from .shapes import Rectangle as Rectangle
