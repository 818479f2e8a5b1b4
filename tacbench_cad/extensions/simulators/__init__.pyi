"""The names of :mod:`tacbench_cad.extensions.simulators`, for type checkers and for its lazy loading alike."""

from .asset import SimulatorAsset as SimulatorAsset
from .asset import TargetFiles as TargetFiles
from .folder import export_to_simulators as export_to_simulators
from .targets import SIMULATOR_TARGETS as SIMULATOR_TARGETS
from .targets import SimulatorTarget as SimulatorTarget
