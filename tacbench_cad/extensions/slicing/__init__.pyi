"""The names of :mod:`tacbench_cad.extensions.slicing`, for type checkers and for its lazy loading alike."""

from .comparison import AsSliced as AsSliced
from .comparison import slice_check as slice_check
from .overhang import overhangs as overhangs
from .plate_files import write_plates as write_plates
from .plates import Plate as Plate
from .plates import arrange_plates as arrange_plates
from .printed_surface import BedPlace as BedPlace
from .printers import Printer as Printer
from .printers import printer_named as printer_named
from .printers import printers as printers
from .slicing_pictures import as_sliced_picture as as_sliced_picture
from .slicing_pictures import plate_picture as plate_picture
