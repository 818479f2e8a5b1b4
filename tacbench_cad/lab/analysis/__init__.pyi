"""The names of :mod:`tacbench_cad.lab.analysis`, for type checkers and for its lazy loading alike."""

from .collection import Collection as Collection
from .feature import Exhibit as Exhibit
from .feature import Feature as Feature
from .feature import Words as Words
from .report.page import ReportOptions as ReportOptions
from .report.page import write_report as write_report
from .report.parts import ReportSection as ReportSection
from .report.parts import list_part as list_part
from .report.parts import long_part as long_part
from .report.parts import text_part as text_part
from .report.results import Results as Results
from .tables import Shown as Shown
from .variance.cells import ALL_LEVELS as ALL_LEVELS
from .variance.cells import parts_of as parts_of
from .variance.view import VarianceView as VarianceView
