"""The names of :mod:`tacbench_cad.lab.simulate`, for type checkers and for its lazy loading alike."""

from .contact import DomeContact as DomeContact
from .contact import contact_for as contact_for
from .heights import cell_of as cell_of
from .heights import centres as centres
from .prints import DRIFT_MM as DRIFT_MM
from .prints import smooth_noise as smooth_noise
