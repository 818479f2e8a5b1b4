"""The formats of exports, and the function that writes them.

Formats are named in the entry-point group ``tacbench.export_formats``, ours as well as those of other packages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.extensions.exchange.exporting.card import card
from tacbench_cad.extensions.exchange.exporting.exported_frames import Progress, Samples
from tacbench_cad.util.entries import load_named
from tacbench_cad.util.files import replacing_folder
from tacbench_cad.util.packages import require

#: The format that tactile_learning reads. It is written by
#: :func:`~tacbench_cad.extensions.exchange.exporting.tactile_data.export_tactile_data`, because it changes the images
#: and can be written into the run folder.
TACTILE_DATA = "tactile-data"
#: The entry-point group of the formats.
GROUP = "tacbench.export_formats"


@dataclass(frozen=True, kw_only=True)
class ExportFormat:
    """An export format. Its name is that of its entry point.

    Args:
        write: The function that writes samples into an empty folder.
        loading: The lines of Python that load the data from the folder.
        modules: The Python modules that writing needs.
        head: The function that returns the beginning of README.md.
    """

    write: Callable[[Samples, Path], None]
    loading: str
    modules: tuple[str, ...] = ()
    head: Callable[[Samples], str] = lambda samples: ""


def export_runs(folders: Iterable[Path], to: str, out: Path, progress: Progress = lambda done, count: None) -> Samples:
    """Write the frames of runs with their columns in another format.

    Each frame is compared with its checksum, and only a few frames are in memory at a time. The folder is written
    completely or not at all.

    Args:
        folders: Run folders, or folders that contain run folders.
        to: The name of the format.
        out: A folder that does not exist yet.
        progress: A function that is called with the number of frames written so far and the number of all frames.

    Returns:
        The written samples.

    Raises:
        InputError: The format is unknown, a run cannot be read or has frames that the format cannot store, or ``out``
            exists or cannot be written.
        CheckFailedError: A frame is missing, damaged or changed.
        MissingToolError: The format needs a package that is not installed.
    """
    chosen: ExportFormat = load_named(GROUP, "to", to)
    require(f"--to {to}", *chosen.modules)
    samples = Samples(folders, progress)
    with replacing_folder(out) as folder:
        chosen.write(samples, folder)
        (folder / "README.md").write_text(chosen.head(samples) + card(samples, chosen.loading), encoding="utf-8")
    return samples
