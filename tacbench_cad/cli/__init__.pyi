"""The names of :mod:`tacbench_cad.cli`, for type checkers and for its lazy loading alike."""

from . import completing as completing
from . import options as options
from .application import PANELS as PANELS
from .application import main as main
from .application import tacbench as tacbench
from .common import ask_line as ask_line
from .common import next_block as next_block
from .common import next_paths as next_paths
from .common import note as note
from .common import print_json as print_json
from .common import print_lines as print_lines
from .common import print_next as print_next
from .common import print_table as print_table
from .common import write_picture as write_picture
from .completing import Items as Items
from .completing import of_run_folders as of_run_folders
from .completing import of_words as of_words
from .make import show_print_set as show_print_set
from .progress import ProgressLine as ProgressLine
