"""The names of :mod:`tacbench_cad.extensions.exchange`, for type checkers and for its lazy loading alike."""

from .exporting.export_formats import ExportFormat as ExportFormat
from .exporting.export_formats import export_runs as export_runs
from .exporting.exported_frames import Samples as Samples
from .exporting.tactile_data import Processing as Processing
from .exporting.tactile_data import export_tactile_data as export_tactile_data
from .publishing.crate import publish as publish
from .publishing.publication import Author as Author
from .publishing.publication import Publication as Publication
from .publishing.publication import read_publication as read_publication
