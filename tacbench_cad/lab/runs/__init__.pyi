"""The names of :mod:`tacbench_cad.lab.runs`, for type checkers and for its lazy loading alike."""

from .importing.array_files import Frames as Frames
from .importing.array_files import array_name as array_name
from .importing.array_files import array_source as array_source
from .importing.array_files import require_frames as require_frames
from .importing.companions import columns_of_array as columns_of_array
from .importing.companions import describes_frames as describes_frames
from .importing.image_folders import files_below as files_below
from .importing.image_folders import is_image_file as is_image_file
from .importing.image_folders import name_fault as name_fault
from .importing.image_folders import natural_path as natural_path
from .importing.image_folders import table_source as table_source
from .importing.import_formats import ImportFormat as ImportFormat
from .importing.import_options import ImportOptions as ImportOptions
from .importing.import_options import Paths as Paths
from .importing.sources import LeftOutFile as LeftOutFile
from .importing.sources import Loaded as Loaded
from .importing.sources import Rows as Rows
from .importing.sources import Sample as Sample
from .importing.sources import Source as Source
from .importing.sources import columns_of_fields as columns_of_fields
from .npyfile import mapped as mapped
from .schema import RUN_FILE as RUN_FILE
