"""The names of :mod:`tacbench_cad.lab.acquire`, for type checkers and for its lazy loading alike."""

from .events import PROGRESS_FILE as PROGRESS_FILE
from .events import ProgressFile as ProgressFile
from .force_search import ContactForce as ContactForce
from .person import Person as Person
from .person import is_label as is_label
from .progress import PressProgress as PressProgress
from .safety import Carriage as Carriage
