"""The names of :mod:`tacbench_cad.extensions.printer_models`, for type checkers and for its lazy loading alike."""

from .fitting import printer_model as printer_model
from .fitting import read_print_scan as read_print_scan
