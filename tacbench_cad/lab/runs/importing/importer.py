"""The import of sources as run folders. An interrupted import can be resumed."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tacbench_cad.lab.runs.importing.grouping import Group, Names, grouped
from tacbench_cad.lab.runs.importing.import_formats import sources_of
from tacbench_cad.lab.runs.importing.import_options import ImportOptions
from tacbench_cad.lab.runs.importing.imported_frames import Prepared, prepared
from tacbench_cad.lab.runs.importing.sources import LeftOutFile, Sample, Source
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.origins import IMAGE, write_origins
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.schema import IMAGE_SUFFIXES, RUN_FILE
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import sha256
from tacbench_cad.util.packages import quiet_opencv, require
from tacbench_cad.util.processes import cpu_count

#: The number of threads that load frames, and the number of loaded frames that may wait to be written.
MAX_THREADS, MAX_WAITING = 4, 4
#: The number of frames that determine the shape of a run's frames.
PROBES = 3

#: The number of samples of a run that are listed with the same reason for being left out. More samples share a line.
MAX_ALIKE = 10

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
    whole_kinds = {source.kind for source in sources if source.whole}
    work = _Work(out=out, progress=progress, total=total, whole_kinds=whole_kinds)
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

    def __init__(self, out: Path, progress: Progress, total: int, whole_kinds: Collection[str]) -> None:
        self.out, self.progress, self.total = out, progress, total
        self.left_out: list[LeftOutFile] = []
        self._done = 0
        self._digests: dict[Path, str] = {}
        #: The frames of the run that were loaded to determine the shape, by the identity of their samples.
        self._probed: dict[int, Outcome] = {}
        #: The run folder of each file that has only frames of a single print, by the checksum of the file.
        self._whole = dict(_imported_files(out, whole_kinds))

    def run(self, group: Group, pool: Executor) -> ImportedRun | None:
        """Write a group's run folder. The result is None if none of its samples can be imported."""
        folder, done = self.out / group.specimen.name, self._done
        left_out: list[LeftOutFile] = []
        imported = present = 0
        try:
            info = self._info(group, folder, pool)
            known = {name for _, _, row in group.samples for name, value in row.items() if value is not None}
            with RunWriter.open(folder, info, durable=False, optional=known) as writer, ExitStack() as on_leaving:
                present = len(writer.done)
                on_leaving.callback(_write_origins, writer, group)
                missing = [each for each in group.samples if each[0] not in writer.done]
                self._done += len(group.samples) - len(missing)
                threads = all(source.threads for source in group.sources)
                for (number, sample, row), frame in _loaded(
                    missing, pool, MAX_THREADS + MAX_WAITING if threads else 1, self._probed
                ):
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

    def _info(self, group: Group, folder: Path, pool: Executor) -> RunInfo:
        """Return the contents of ``run.json`` for a group.

        Raises:
            InputError: No frame can be read, or a file was already imported as another print.
        """
        files = [{"name": path.name, "sha256": self._digest(path)} for source in group.sources for path in source.files]
        for source in group.sources:
            for path in source.files if source.whole else ():
                other = self._whole.setdefault(self._digest(path), folder)
                if other.name != folder.name:
                    raise InputError("file", str(path), f"was already imported as {other}")
        there = (folder / RUN_FILE).is_file()
        sensor = Run.open(folder).info.sensor if there else self._sensor(group, pool)
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
            sensor=sensor,
            source={**group.source, "files": files},
        )

    def _sensor(self, group: Group, pool: Executor) -> Mapping[str, Any]:
        """Describe the sensor by some of the frames, with the shape that most of these have."""
        count = len(group.samples)
        firsts = [group.samples[i] for i in sorted({i * (count - 1) // max(1, PROBES - 1) for i in range(PROBES)})]
        self._probed = {id(sample): frame for (_, sample, _), frame in _loaded(firsts, pool, 1)}
        good = [frame for frame in self._probed.values() if isinstance(frame, Prepared)]
        if not good:  # these frames are damaged, so try the others
            others = _loaded((each for each in group.samples if each not in firsts), pool, 1)
            good = list(islice((frame for _, frame in others if isinstance(frame, Prepared)), 1))
        if not good:
            _, sample, _ = firsts[0]
            what = f"no frame can be read; the first is {sample.where}: {self._probed[id(sample)]}"
            raise InputError("frames", None, what)
        shape = Counter(frame.shape for frame in good).most_common(1)[0][0]
        first = next(frame for frame in good if frame.shape == shape)
        counts = first.file.suffix in IMAGE_SUFFIXES or any(source.whole for source in group.sources)
        return {
            "simulated": first.simulated,
            "units": "counts" if counts else "unknown unit",
            "shape": list(shape),
        }

    def _digest(self, path: Path) -> str:
        if path not in self._digests:
            self.progress(f"checksum of {path.name}", self._done, self.total)
            self._digests[path] = sha256(path)
        return self._digests[path]


def _write_origins(writer: RunWriter, group: Group) -> None:
    """Write the table of the origins of all frames that the run has."""
    rows = sorted(writer.rows, key=lambda row: row.number)
    write_origins(writer.folder, [{IMAGE: row.sensor_image, **group.origins[row.number]} for row in rows])


def _loaded(
    samples: Iterable[tuple[int, Sample, Mapping[str, Any]]],
    pool: Executor,
    waiting: int,
    known: Mapping[int, Outcome] = MappingProxyType({}),
) -> Iterator[tuple[tuple[int, Sample, Mapping[str, Any]], Outcome]]:
    """Yield the samples in order, each with its frame or its fault.

    Args:
        samples: The samples.
        pool: The executor that loads the frames.
        waiting: The largest number of frames that are being loaded or wait.
        known: Frames that were loaded before, by the identity of their samples.
    """
    under_way: deque[tuple[Any, Future[Outcome]]] = deque()
    try:
        for each in samples:
            under_way.append((each, pool.submit(_load, each[1], known)))
            if len(under_way) >= waiting:
                item, future = under_way.popleft()
                yield item, future.result()
        while under_way:
            item, future = under_way.popleft()
            yield item, future.result()
    finally:
        for _, future in under_way:
            future.cancel()


def _load(sample: Sample, known: Mapping[int, Outcome]) -> Outcome:
    if id(sample) in known:
        return known[id(sample)]
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


def _imported_files(out: Path, whole_kinds: Collection[str]) -> Iterator[tuple[str, Path]]:
    """Yield the checksums of files that were imported into a folder as a single print, with their run folders.

    Args:
        out: The folder.
        whole_kinds: The kinds of sources whose files have frames of a single print.
    """
    for path in sorted(out.glob(f"*/{RUN_FILE}")):
        try:
            source = Run.open(path.parent).info.source
        except InputError:  # `tacbench check-runs` reports the fault
            continue
        files = source.get("files") if any(kind in str(source.get("kind")) for kind in whole_kinds) else ()
        for entry in files if isinstance(files, list) else ():
            if isinstance(entry, dict) and isinstance(entry.get("sha256"), str):
                yield entry["sha256"], path.parent
