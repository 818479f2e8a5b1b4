"""The names of :mod:`tacbench_cad.extensions.printer_models`, for type checkers and for its lazy loading alike."""

from .correction import Corrected as Corrected
from .correction import corrected_for as corrected_for
from .effect import effect_of as effect_of
from .fitting import printer_model as printer_model
from .fitting import read_print_scan as read_print_scan
from .model import PrinterModel as PrinterModel
from .model import read_printer_model as read_printer_model
from .model import write_printer_model as write_printer_model
