"""The names of :mod:`tacbench_cad.lab.simulate`, for type checkers and for its lazy loading alike."""

from .appearances import LOOKS as LOOKS
from .appearances import Look as Look
from .contact import DomeContact as DomeContact
from .contact import contact_for as contact_for
from .heights import cell_of as cell_of
from .heights import centres as centres
from .heights import flat_plate as flat_plate
from .prints import DRIFT_MM as DRIFT_MM
from .prints import VIRTUAL_PRINTERS as VIRTUAL_PRINTERS
from .prints import VirtualPrinter as VirtualPrinter
from .prints import smooth_noise as smooth_noise
from .prints import stimulus as stimulus
from .tactip import TacTip as TacTip
