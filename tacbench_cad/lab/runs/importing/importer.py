"""The import of sources as run folders. An interrupted import can be resumed."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig.colours import Channels, from_outside
from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs.frame_files import (
    FrameFile,
    as_frame,
    decoded_image,
    encoded,
    image_format,
    simulated_text,
)
from tacbench_cad.lab.runs.importing.grouping import Fields, Group, GroupedSample, Names, grouped
from tacbench_cad.lab.runs.importing.import_formats import sources_of
from tacbench_cad.lab.runs.importing.sources import ImportOptions, LeftOutFile, Loaded, Sample, Source
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.origins import IMAGE, write_origins
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.schema import IMAGE_SUFFIXES, RUN_FILE
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import sha256
from tacbench_cad.util.packages import quiet_opencv, require
from tacbench_cad.util.processes import cpu_count

#: The number of threads that load frames, and the number of frames that are loaded together.
MAX_THREADS, BATCH = 4, 8
#: The number of frames that determine the shape of a run's frames.
PROBES = 3

#: The number of samples of a run that are listed with the same reason for being left out. More samples share a line.
MAX_ALIKE = 10

#: The suffixes of the image files that are kept unchanged, by their format.
_KEPT = {"PNG": ".png", "JPEG": ".jpg"}


class Prepared(NamedTuple):
    """A frame as it will be stored: its file, its shape, and its simulated devices."""

    file: FrameFile
    shape: tuple[int, ...]
    simulated: str


#: A frame, or its fault.
Outcome = Prepared | InputError | CheckFailedError
#: A function that is called with a description of the step, the finished number of samples and the total number.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class ImportedRun:
    """The result of importing a run.

    Args:
        folder: The run folder.
        kind: The kind of source.
        imported: The number of samples that were written.
        present: The number of samples that the run folder already had.
        left_out: The number of samples that could not be imported.
    """

    folder: Path
    kind: str
    imported: int
    present: int
    left_out: int


@dataclass(frozen=True, kw_only=True)
class ImportReport:
    """The result of an import.

    Args:
        runs: The runs, in the order in which they were written.
        left_out: Everything that could not be imported, with the reasons.
        notes: Notes for the user: the meaning that was given to each column.
    """

    runs: tuple[ImportedRun, ...]
    left_out: tuple[LeftOutFile, ...]
    notes: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing was left out."""
        return not self.left_out


def import_samples(
    paths: Sequence[Path],
    out: Path,
    options: ImportOptions | None = None,
    progress: Progress = lambda what, done, total: None,
) -> ImportReport:
    """Import frames as run folders. Samples that an earlier import has written are skipped.

    Folders of images, files of arrays, and the formats of the entry-point group ``tacbench.formats`` are recognised.
    There is one run for each print if the data tell the prints apart, otherwise one for each label. Unknown values
    stay unknown. The report lists everything that cannot be imported; the rest is imported. Only a few frames are in
    memory at a time.

    Args:
        paths: Files and folders.
        out: The folder for the run folders.
        options: The options for reading.
        progress: A function that receives progress updates.

    Raises:
        InputError: The options contradict each other or the data (nothing is written then), or ``out`` cannot be
            written.
        MissingToolError: A package that a kind needs is not installed.
    """
    chosen = options or ImportOptions()
    require("the import of images", "cv2")
    quiet_opencv()
    names = Names() if chosen.names is None else Names.read(chosen.names)
    sources: list[Source] = []
    left_out: list[LeftOutFile] = []
    for item in sources_of(paths, chosen):
        progress("reading the sources", len(sources) + len(left_out), 0)
        if isinstance(item, Source):
            sources.append(item)
        else:
            left_out.append(item)
    groups, faults = grouped(sources, names)
    total = sum(len(group.samples) for group in groups)
    work = _Work(out=out, progress=progress, total=total)
    work.left_out += [*left_out, *faults]
    with ThreadPoolExecutor(min(MAX_THREADS, cpu_count())) as pool:
        runs = [run for group in groups if (run := work.run(group, pool)) is not None]
    return ImportReport(
        runs=tuple(runs),
        left_out=tuple(work.left_out),
        notes=tuple(dict.fromkeys(note for source in sources for note in source.notes)),
    )


class _Work:
    """The state of an import."""

    def __init__(self, out: Path, progress: Progress, total: int) -> None:
        self.out, self.progress, self.total = out, progress, total
        self.left_out: list[LeftOutFile] = []
        self._done = 0
        self._digest = cache(sha256)  # several runs may name a file
        #: The run folder of each imported file, by the checksum of the file.
        self._files = {digest: path.parent.name for path in out.glob(f"*/{RUN_FILE}") for digest in _imported(path)}

    def run(self, group: Group, pool: Executor) -> ImportedRun | None:
        """Write a group's run folder. The result is None if none of its samples can be imported."""
        folder, done = self.out / group.specimen.name, self._done
        left_out: list[LeftOutFile] = []
        imported = present = 0
        try:
            info = self._info(group, folder)
            known = {name for _, _, row in group.samples for name, value in row.items() if value is not None}
            with RunWriter.open(folder, info, durable=False, optional=known) as writer, ExitStack() as on_leaving:
                present = len(writer.done)
                on_leaving.callback(_write_origins, writer, group)
                missing = [each for each in group.samples if each[0] not in writer.done]
                self._done += len(group.samples) - len(missing)
                for number, sample, row, frame in _loaded(missing, pool if group.threads else None):
                    fault = _fault(frame, info)
                    if isinstance(frame, Prepared) and not fault:
                        writer.sample(number, frame.file, **row)
                        imported += 1
                    else:
                        left_out.append(LeftOutFile(where=sample.where, reason=fault))
                    self._done += 1
                    self.progress(folder.name, self._done, self.total)
        except InputError as error:
            if error.field in ("output folder", "output file"):
                raise
            rest = len(group.samples) - imported - present - len(left_out)
            left_out.append(LeftOutFile(where=folder.name, reason=str(error), count=rest))
        self.left_out += _summarised(left_out)
        self._done = done + len(group.samples)
        if not imported and not present:
            return None
        kind, lacking = str(group.source["kind"]), len(group.samples) - imported - present
        return ImportedRun(folder=folder, kind=kind, imported=imported, present=present, left_out=lacking)

    def _info(self, group: Group, folder: Path) -> RunInfo:
        """Return the contents of ``run.json`` for a group.

        Raises:
            InputError: No frame can be read, or a file was already imported as another print.
        """
        files = []
        for source, path in ((each, path) for each in group.sources for path in each.files):
            self.progress(f"checksum of {path.name}", self._done, self.total)
            files.append({"name": path.name, "sha256": self._digest(path)})
            if source.whole and (other := self._files.setdefault(self._digest(path), folder.name)) != folder.name:
                raise InputError("file", str(path), f"was already imported as {self.out / other}")
        there = (folder / RUN_FILE).is_file()
        return RunInfo(
            printed=group.specimen,
            levels=group.levels,
            protocol=None,
            grid_spacing=None,
            holder=None,
            frame=None,
            slot=None,
            stage={},
            gauge={},
            sensor=Run.open(folder).info.sensor if there else _sensor(group),
            source={**group.source, "files": files},
        )


def _imported(path: Path) -> list[str]:
    """Return the checksums of the files that a run was imported from."""
    with suppress(InputError):  # `tacbench check-runs` reports the fault
        files = Run.open(path.parent).info.source.get("files")
        return [str(each.get("sha256")) for each in files or () if isinstance(each, dict)]
    return []


def _sensor(group: Group) -> Mapping[str, Any]:
    """Describe the sensor by the first readable of some frames with the shape that most of these have."""
    samples = [sample for _, sample, _ in group.samples]
    probes = [samples[i * (len(samples) - 1) // (PROBES - 1)] for i in range(PROBES)]
    good = [frame for frame in map(_load, probes) if isinstance(frame, Prepared)]
    good = good or list(islice((frame for frame in map(_load, samples) if isinstance(frame, Prepared)), 1))
    if not good:
        what = f"no frame can be read; the first is {samples[0].where}: {_load(samples[0])}"
        raise InputError("frames", None, what)
    shape = Counter(frame.shape for frame in good).most_common(1)[0][0]
    first = next(frame for frame in good if frame.shape == shape)
    counts = first.file.suffix in IMAGE_SUFFIXES or any(source.whole for source in group.sources)
    units = "counts" if counts else "unknown unit"
    return {"simulated": first.simulated, "units": units, "shape": list(shape)}


def _write_origins(writer: RunWriter, group: Group) -> None:
    """Write the table of the origins of all frames that the run has."""
    rows = sorted(writer.rows, key=lambda row: row.number)
    write_origins(writer.folder, [{IMAGE: row.sensor_image, **group.origins[row.number]} for row in rows])


def _loaded(samples: Sequence[GroupedSample], pool: Executor | None) -> Iterator[tuple[int, Sample, Fields, Outcome]]:
    """Yield the samples in order, each with its frame or its fault. Only a few frames are in memory at a time."""
    for start in range(0, len(samples), BATCH):
        batch = samples[start : start + BATCH]
        frames = (pool.map if pool else map)(_load, [sample for _, sample, _ in batch])
        for (number, sample, row), frame in zip(batch, frames, strict=True):
            yield number, sample, row, frame


def _load(sample: Sample) -> Outcome:
    try:
        return prepared(sample.load(), sample.channels)
    except (InputError, CheckFailedError) as error:
        return error


def _fault(frame: Outcome, info: RunInfo) -> str:
    """Return why a frame is left out; an empty text if it is imported."""
    if isinstance(frame, InputError):
        return frame.allowed
    if isinstance(frame, CheckFailedError):
        return str(frame)
    if frame.shape != info.frame_shape:
        return f"has shape {frame.shape}, but the run has {info.frame_shape}"
    if frame.simulated != info.sensor.get("simulated"):
        return "cannot be in this run, because either the frame or the run is simulated, but not both"
    return ""


def _summarised(left_out: Sequence[LeftOutFile]) -> Iterator[LeftOutFile]:
    """Replace many samples with the same reason by a single entry."""
    alike: dict[str, list[LeftOutFile]] = defaultdict(list)
    for each in left_out:
        alike[each.reason].append(each)
    for reason, members in alike.items():
        if len(members) <= MAX_ALIKE:
            yield from members
        else:
            where = f"{members[0].where} and {len(members) - 1:,} more"
            yield LeftOutFile(where=where, reason=reason, count=sum(each.count for each in members))


def prepared(loaded: Loaded, channels: Channels) -> Prepared:
    """Return the file of a frame.

    PNG and JPEG files with grey or colour pixels of 8 bits are kept unchanged. Other frames are converted without loss.

    Args:
        loaded: The loaded frame.
        channels: The order of the colours of an array. The order in the file of an image is known.

    Raises:
        CheckFailedError: The image is incomplete or too large, or the array does not contain real numbers.
    """
    if not isinstance(loaded, bytes):
        frame, simulated = from_outside(_without_last_axis(loaded), channels), ""
    else:
        image, suffix = decoded_image(loaded), _KEPT.get(image_format(loaded) or "")
        simulated = simulated_text(loaded)
        if suffix and is_image(image):
            return Prepared(FrameFile.of(loaded, suffix), image.shape, simulated)
        frame = as_frame(image)
    if frame.dtype.kind not in "iufb" or not frame.size:
        raise CheckFailedError(f"contains {frame.dtype} of shape {frame.shape}; it must contain real numbers")
    file = FrameFile.of(*encoded(np.ascontiguousarray(frame), (simulated,) if simulated else ()))
    return Prepared(file, frame.shape, simulated)


def _without_last_axis(array: NDArray[Any]) -> NDArray[Any]:
    """Return a grey image of shape (height, width, 1), as many networks take it, without its last axis."""
    is_grey = array.ndim == 3 and array.shape[2] == 1 and is_image(array[..., 0])
    return array[..., 0] if is_grey else array
