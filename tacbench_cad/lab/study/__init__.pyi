"""The names of :mod:`tacbench_cad.lab.study`, for type checkers and for its lazy loading alike."""

from .names import own_name as own_name
from .plate import block_in_file as block_in_file
from .presses import Press as Press
from .presses import plan_presses as plan_presses
from .spec import GaugeSettings as GaugeSettings
from .spec import HolderRim as HolderRim
from .spec import Point as Point
from .spec import PrintedBlock as PrintedBlock
from .spec import SensorSettings as SensorSettings
from .spec import StageSettings as StageSettings
from .spec import WorkFrame as WorkFrame
from .spec import minus as minus
from .spec import plus as plus
