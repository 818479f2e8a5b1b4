"""The names of :mod:`tacbench_cad.extensions.virtual_rig`, for type checkers and for its lazy loading alike."""

from .faults import Fault as Fault
from .loadcell import FlatSpring as FlatSpring
from .server import VirtualRig as VirtualRig
from .server import launch as launch
from .setup import Setup as Setup
