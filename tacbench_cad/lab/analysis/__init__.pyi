"""The names of :mod:`tacbench_cad.lab.analysis`, for type checkers and for its lazy loading alike."""

from .feature import Exhibit as Exhibit
from .feature import Feature as Feature
from .feature import Words as Words
from .published import PAPER_FLOORS as PAPER_FLOORS
from .published import PAPER_ROW_NAMES as PAPER_ROW_NAMES
from .published import PAPER_VARIANCE as PAPER_VARIANCE
from .regions import region_in as region_in
from .report.results import ReportSection as ReportSection
from .report.results import Results as Results
from .study_design import Design as Design
from .tables import Shown as Shown
from .variance.cells import ALL_LEVELS as ALL_LEVELS
from .variance.result import Variance as Variance
