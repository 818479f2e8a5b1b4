"""The names of :mod:`tacbench_cad.extensions.markers`, for type checkers and for its lazy loading alike."""

from .displacements import MIN_FOUND as MIN_FOUND
from .displacements import MarkerFeatures as MarkerFeatures
from .feature import MarkerDisplacements as MarkerDisplacements
from .markers import MarkerFinder as MarkerFinder
from .markers import Markers as Markers
from .markers import MarkerSettings as MarkerSettings
from .tracking import MarkerTracker as MarkerTracker
from .tracking import Track as Track
