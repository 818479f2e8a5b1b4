"""The names of :mod:`tacbench_cad.checks`, for type checkers and for its lazy loading alike."""

from .meshcheck import read_mesh as read_mesh
from .report import Check as Check
from .report import Report as Report
