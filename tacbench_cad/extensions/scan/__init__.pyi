"""The names of :mod:`tacbench_cad.extensions.scan`, for type checkers and for its lazy loading alike."""

from .analysing import ScanOptions as ScanOptions
from .analysing import analyse as analyse
from .cloud import Cloud as Cloud
from .estimates import Estimate as Estimate
from .estimates import ScanFit as ScanFit
from .estimates import WaveEstimate as WaveEstimate
from .fitting import fit_scan as fit_scan
from .fitting import identify as identify
from .limits import Limits as Limits
from .pose import Pose as Pose
from .reading import read_scan as read_scan
from .result import PrintOrigin as PrintOrigin
from .result import ScanResult as ScanResult
from .result_files import write_result as write_result
from .scan_pictures import deviation_picture as deviation_picture
from .scan_pictures import waves_picture as waves_picture
from .simulating import ScanTruth as ScanTruth
from .simulating import simulate_scan as simulate_scan
