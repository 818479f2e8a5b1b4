"""Every format that runs are exported to, and the one function that writes any of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.lab.runs.exporting import hugging_face, image_folder, npz, web_dataset, zarr_group
from tacbench_cad.lab.runs.exporting.card import card
from tacbench_cad.lab.runs.exporting.samples import Progress, Samples
from tacbench_cad.util.errors import one_of
from tacbench_cad.util.files import replacing_folder
from tacbench_cad.util.packages import require

#: What tactile_learning reads: no folder of its own, and images that are changed
#: (:func:`~tacbench_cad.lab.runs.exporting.tactile_data.export_tactile_data`).
TACTILE_DATA = "tactile-data"


@dataclass(frozen=True, kw_only=True)
class ExportFormat:
    """A format.

    Args:
        write: Writes samples into an empty folder.
        loading: Lines of Python that load them there.
        modules: What it needs to be written.
        head: What its README.md begins with.
    """

    write: Callable[[Samples, Path], None]
    loading: str
    modules: tuple[str, ...] = ()
    head: Callable[[Samples], str] = lambda samples: ""


#: The formats by their names.
FORMATS = {
    "huggingface": ExportFormat(
        write=hugging_face.write, loading=hugging_face.LOADING, modules=("pyarrow",), head=hugging_face.card_head
    ),
    "webdataset": ExportFormat(write=web_dataset.write, loading=web_dataset.LOADING),
    "imagefolder": ExportFormat(write=image_folder.write, loading=image_folder.LOADING),
    "zarr": ExportFormat(write=zarr_group.write, loading=zarr_group.LOADING, modules=("zarr", "cv2")),
    "npz": ExportFormat(write=npz.write, loading=npz.LOADING, modules=("cv2",)),
}


def export_runs(folders: Iterable[Path], to: str, out: Path, progress: Progress = lambda done, count: None) -> Samples:
    """Write the frames of runs with their columns in another format.

    Each frame is compared with its checksum on the way, and no more than a few are in memory. The folder is whole or
    not there.

    Args:
        folders: Run folders, or folders that hold some.
        to: One of :data:`FORMATS`.
        out: A folder that does not exist yet.
        progress: Receives the number of frames written so far and the number of all.

    Returns:
        What was written.

    Raises:
        InputError: The format is unknown, a run cannot be read or has frames that the format cannot hold, or ``out``
            exists or cannot be written.
        CheckFailedError: A frame is missing, damaged or changed.
        MissingToolError: The format needs a package that is not installed.
    """
    chosen = FORMATS[one_of("to", to, FORMATS)]
    require(f"--to {to}", *chosen.modules)
    samples = Samples(folders, progress)
    with replacing_folder(out) as folder:
        chosen.write(samples, folder)
        (folder / "README.md").write_text(chosen.head(samples) + card(samples, chosen.loading), encoding="utf-8")
    return samples
