"""Writing of the data set: the runs (checked while they are copied), the blocks, the report, metadata and checksums."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from tacbench_cad.extensions.exchange.publishing.metadata import DataSetPart, datacite, write_crate, zenodo
from tacbench_cad.extensions.exchange.publishing.publication import Publication
from tacbench_cad.lab.runs import Reference, Row, Run, Stationary, find_runs
from tacbench_cad.spec import Block
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import (
    LOCK_NAME,
    TEMPORARY_PREFIX,
    locked,
    replacing,
    replacing_folder,
    sha256,
    write_json,
    write_text,
)
from tacbench_cad.util.packages import require
from tacbench_cad.util.text import counted
from tacbench_cad.util.untrusted import open_input, read_bytes

#: The folders of the runs and of the blocks' files in the data set, the report, and the list of checksums.
RUNS, PARTS, REPORT_FILE, SUMS_FILE = "runs", "parts", "report.html", "SHA256SUMS"
#: A function that is called with the name of the run, the number of copied files and the number of all its files.
Progress = Callable[[str, int, int], None]


def publish(
    folders: Sequence[Path],
    out: Path,
    publication: Publication,
    *,
    report: Callable[[Path], object] | None = None,
    parts: Callable[[Sequence[Block], Path], object] | None = None,
    progress: Progress = lambda what, done, count: None,
) -> list[Path]:
    """Write runs as an RO-Crate, a data set for a repository such as Zenodo. Nothing is uploaded.

    Args:
        folders: Run folders, or folders that contain run folders.
        out: A folder or a ``.zip`` file that does not exist yet.
        publication: The user's description of the data set.
        report: A function that writes the report to a path; None for no report.
        parts: A function that writes the files of blocks into a folder; None for no files.
        progress: A function that is called after each copied file.

    Returns:
        The paths of the files, relative to the data set's folder.

    Raises:
        InputError: There is no run, a run cannot be read, two runs have the same name, or ``out`` exists or cannot be
            written.
        CheckFailedError: A frame is missing or was changed.
        MissingToolError: rocrate is not installed.
    """
    require("tacbench publish", "rocrate")
    runs = [Run.open(folder) for folder in find_runs(folders)]
    twice = next((name for name, count in Counter(run.folder.name for run in runs).items() if count > 1), None)
    if twice is not None:
        raise InputError("runs", twice, "is the name of two run folders; publish them separately, or rename one")
    licence = b"" if publication.licence_file is None else read_bytes(Path(publication.licence_file), "licence")
    with _data_set(out) as folder:
        sums: dict[str, str] = {}
        contents = [_copy_run(run, folder, sums, progress) for run in runs]
        blocks = {run.info.printed.block.name: run.info.printed.block for run in runs if run.info.printed.block}
        if parts is not None and blocks:
            (folder / PARTS).mkdir()
            parts(list(blocks.values()), folder / PARTS)
        if report is not None:
            report(folder / REPORT_FILE)
        text = f"{publication.licence}\n{publication.licence_url}\n".encode()
        (folder / "LICENSE.txt").write_bytes(licence or text)
        described = " ".join(filter(None, [publication.description.strip(), _summary(runs)]))
        simulated = [word for word in ("simulated",) if any(run.info.simulated for run in runs)]
        keywords = list(dict.fromkeys(["tactile", *simulated, *publication.keywords]))
        write_json(folder / "datacite.json", datacite(publication, described, keywords))
        write_json(folder / ".zenodo.json", zenodo(publication, described, keywords))
        write_text(folder / "README.md", _page(publication, described))
        others = {path: sha256(folder / path) for path in _files(folder) if path not in sums}
        contents += [
            DataSetPart(path=path, name=Path(path).name, sha256=digest, size=(folder / path).stat().st_size)
            for path, digest in others.items()
        ]
        sums |= others
        of_paper = any(block.texture.number for block in blocks.values())
        write_crate(folder, publication, described, keywords, contents, textures=of_paper)
        sums |= {path: sha256(folder / path) for path in _files(folder) if path not in sums}
        write_text(folder / SUMS_FILE, "".join(f"{digest}  {path}\n" for path, digest in sorted(sums.items())))
        return [Path(path) for path in _files(folder)]


@contextlib.contextmanager
def _data_set(out: Path) -> Iterator[Path]:
    """Yield a temporary folder, whose contents become ``out`` at the end of the block."""
    if out.suffix.lower() != ".zip":
        with replacing_folder(out) as folder:
            yield folder
        return
    if out.exists():
        raise InputError("output file", str(out), "already exists; remove it or choose another folder")
    with (
        locked(out.parent),
        replacing(out) as archive,
        tempfile.TemporaryDirectory(prefix=TEMPORARY_PREFIX, dir=out.parent) as name,
    ):
        yield Path(name)
        with zipfile.ZipFile(archive, "w") as stream:
            for path in _files(Path(name)):
                stream.write(Path(name) / path, path)


def _files(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def _copy_run(run: Run, folder: Path, sums: dict[str, str], progress: Progress) -> DataSetPart:
    """Copy a run folder into the data set, and record the checksum of each file.

    Raises:
        CheckFailedError: A frame is missing, or differs from the checksum in its row.
    """
    target = folder / RUNS / run.folder.name
    frames: list[Row | Reference | Stationary] = [*run.rows, *run.references, *run.stationary_frames]
    expected = {row.path: row.image_sha256 for row in frames} | run.series_files()
    names = [name for name in _files(run.folder) if not Path(name).name.startswith((LOCK_NAME, TEMPORARY_PREFIX))]
    missing = next((name for name in expected if name not in names), None)
    if missing is not None:
        raise CheckFailedError(f"{run.folder / missing}: is missing, but a row refers to it")
    for count, name in enumerate(names, start=1):
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        with (
            open_input(run.folder / name, "run", within=run.folder) as source,
            (target / name).open("wb") as copy,
        ):
            shutil.copyfileobj(source, copy)
        digest = sums[f"{RUNS}/{run.folder.name}/{name}"] = sha256(target / name)
        if digest != expected.get(name, digest):
            raise CheckFailedError(f"{run.folder / name}: was changed: its checksum differs from the recorded one")
        progress(run.folder.name, count, len(names))
    origin = f"simulated ({'; '.join(run.info.simulated)})" if run.info.simulated else "nothing is marked as simulated"
    return DataSetPart(
        path=f"{RUNS}/{run.folder.name}/",
        name=run.folder.name,
        description=f"{counted(len(run.rows), 'frame')}; {origin}. See its targets.csv.",
    )


def _summary(runs: Sequence[Run]) -> str:
    frames = sum(len(run.rows) for run in runs)
    printed = [run.info.printed for run in runs]
    labels = {block.texture for block in printed if block.texture is not None}
    combinations = {block.combination for block in printed if block.printer is not None or block.filament is not None}
    text = f"{counted(frames, 'frame')} of a tactile sensor, in {counted(len(runs), 'run')}"
    known = [counted(len(labels), "label")] if labels else []
    known += [counted(len(combinations), "combination") + " of printer and filament"] if combinations else []
    simulated = sum(bool(run.info.simulated) for run in runs)
    origin = (
        f"Simulated data: {simulated} of {counted(len(runs), 'run')}."
        if simulated
        else "Nothing is marked as simulated."
    )
    details = f" ({', '.join(known)})" if known else ""
    return f"{text}{details}. {origin}"


def _page(publication: Publication, description: str) -> str:
    authors = "; ".join(f"{author.name} ({author.affiliation})" for author in publication.authors)
    return f"""# {publication.title}

{authors}. {publication.publisher}, {publication.year}. Licence: {publication.licence} (LICENSE.txt).

{description}

- `{RUNS}/`: one folder for each recording; `targets.csv` has a row for each frame, `run.json` describes it.
- `{PARTS}/`: the printed blocks as STL, 3MF and STEP files, if they are known.
- `{REPORT_FILE}`: the analysis of the data, if it was written.
- `{SUMS_FILE}`: the checksums; check the files with `sha256sum -c {SUMS_FILE}`.
- `ro-crate-metadata.json`, `datacite.json`, `.zenodo.json`: the same metadata for machines.
"""
