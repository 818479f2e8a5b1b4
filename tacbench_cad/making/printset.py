"""Making of a print set: build each part, write its files, check and rename them, and update the manifest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.making import manifest
from tacbench_cad.making.planning import FileSource, LeftOut, Plan
from tacbench_cad.making.request import Request, asks_for_cad, plan
from tacbench_cad.making.writing import Failure, Outcome, make_files, make_in_child
from tacbench_cad.util import plotting
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError, MissingToolError, TacbenchError
from tacbench_cad.util.files import MANIFEST_NAME, locked, remove_leftovers
from tacbench_cad.util.packages import require, why_missing
from tacbench_cad.util.processes import Workers, cpu_count, why_not_importable
from tacbench_cad.util.text import report

__all__ = ["PREVIEW_NAME", "Failure", "LeftOut", "Plan", "PrintSet", "Request", "build", "plan"]

#: The name of the picture sheet in the output folder.
PREVIEW_NAME = "preview.png"

#: The largest number of child processes. Each of them imports the CAD kernel.
MAX_CHILDREN = 3

#: A function that is called after each step with a message, the number of finished steps and the number of steps.
Progress = Callable[[str, int, int], None]


@dataclass(kw_only=True)
class PrintSet:
    """The result of a call.

    Attributes:
        out: The output folder.
        rows: The manifest rows of the files, sorted by name.
        failures: The files that failed their checks and are therefore not in the folder.
        left_out: The files and parts that were left out, with the reasons.
        preview: Whether the picture sheet was drawn.
    """

    out: Path
    rows: list[manifest.Row] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    left_out: list[LeftOut] = field(default_factory=list)
    preview: bool = False

    @property
    def ok(self) -> bool:
        """Whether all files passed their checks."""
        return not self.failures

    def __str__(self) -> str:
        """Return a line for each file with its deviation or its faults, and then a line for everything left out."""
        lines = []
        for row in self.rows:
            distance = manifest.largest_distance(row)
            far = distance and f", at most {distance} mm from the formula"
            lines.append((str(row["file"]), f"{len(row['checks'])} checks passed{far}"))
        lines += [(failure.file, f"not made: {'; '.join(failure.faults)}") for failure in self.failures]
        lines += [(left.what, f"left out: {left.reason}") for left in self.left_out]
        return report(f"{len(self.rows)} file{'' if len(self.rows) == 1 else 's'} in {self.out}", lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the document that ``tacbench make --json`` prints."""
        return {
            "version": __version__,
            "ok": self.ok,
            "files": self.rows,
            "failed": to_plain(self.failures),
            "left_out": to_plain(self.left_out),
            "preview": PREVIEW_NAME if self.preview else None,
        }


def build(request: Request, progress: Progress = lambda message, done, total: None) -> PrintSet:
    """Make all parts of a request.

    All errors in the request are raised before the first file is written. Each file is written under a temporary name,
    read back, and renamed only if it passes all checks. After an interruption all files in the folder are complete, and
    the manifest describes them.

    Args:
        request: The options.
        progress: Receives progress updates after each step.

    Returns:
        The result. It lists files that failed their checks; they are not in the folder.

    Raises:
        InputError: An option or the output folder is not allowed.
        MissingToolError: A format or part in the request needs a package that is missing or does not work.
    """
    work = plan(request)
    if request.full:
        require("verify = 'full':", "pymeshlab")
    with Workers(_children(work)) as workers:
        kernel = _load_kernel(work, workers)
        progress("loading the CAD kernel" if kernel else "meshing", 0, work.file_count)
        for source in work.sources:
            block = source.part.block
            if block is not None:
                if block.outline is not None or not block.surface.is_separable:
                    # such a mesh can take several seconds
                    progress(f"meshing {source.part.name}", 0, work.file_count)
                _ = source.part.mesh  # raises InputError if the tolerance is too fine, before any file is written
        if kernel is not None:
            if not why_missing("matplotlib"):
                plotting.load()  # while a child loads the kernel
            work = _with_kernel(request, work, kernel.result())
        if not work.sources:
            raise InputError("parts", None, "nothing can be made: " + "; ".join(left.reason for left in work.left_out))
        with locked(request.out):
            return _Making(request, work, workers, progress).run()


def _children(work: Plan) -> int:
    """Return the number of child processes: one for each solid, and one for all fixtures, but at most three."""
    solids = sum(bool(source.slow_formats) and not source.in_child for source in work.sources)
    fixtures = bool(work.assemblies) or any(source.in_child for source in work.sources)
    return max(1, min(MAX_CHILDREN, cpu_count(), solids + fixtures))


def _load_kernel(work: Plan, workers: Workers) -> Future[str | None] | None:
    """Begin to load the CAD kernel in a child; None if the plan needs no kernel."""
    if not work.needs_kernel:
        return None
    return workers.submit(why_not_importable, (*work.needs_kernel, make_in_child.__module__))


def _with_kernel(request: Request, work: Plan, reason: str | None) -> Plan:
    """If the CAD kernel cannot be loaded, leave out its parts, or raise an error if the user asked for them."""
    if reason is None:
        return work
    message = f"the CAD kernel does not load ({reason}); tacbench doctor shows the repair"
    if asks_for_cad(request):
        raise MissingToolError(message)
    return work.without_kernel(message)


class _Making:
    """A run in a locked output folder.

    Args:
        request: The options.
        work: The plan.
        workers: The child processes for work that needs the kernel.
        progress: Receives progress updates after each file.
    """

    def __init__(self, request: Request, work: Plan, workers: Workers, progress: Progress) -> None:
        self._out, self._full = request.out, request.full
        self._work, self._workers, self._progress = work, workers, progress
        self._result = PrintSet(out=request.out, left_out=list(work.left_out))
        self._fixture_meshes: dict[str, Mesh] = {}
        self._old = manifest.read_rows(request.out)
        for name in (MANIFEST_NAME, PREVIEW_NAME):
            if (self._out / name).is_dir():
                raise InputError("output file", str(self._out / name), "is a folder; move it away")

    def run(self) -> PrintSet:
        """Make the files, the picture sheet and the manifest."""
        try:
            slow = self._start_slow()
            together = {self._submit([one], "formats"): [one] for one in self._work.assemblies}
            for source in self._work.sources:
                if source.own_formats:
                    self._take(make_files(source.part, source.own_formats, self._out, self._full))
            with_meshes = {job: sources for job, sources in slow.items() if sources[0].in_child}
            self._finish(with_meshes, "slow_formats")
            self._preview()  # the children still make solids
            self._finish({job: sources for job, sources in slow.items() if job not in with_meshes}, "slow_formats")
            self._finish(together, "formats")
            if self._result.failures:
                self._preview()
        finally:
            self._workers.close()
            remove_leftovers(self._out)
            self._write_manifest()
        return self._result

    def _start_slow(self) -> dict[Future[Any], list[FileSource]]:
        """Start the work that needs the kernel: all fixtures in one call, and solids beginning with the slowest."""
        jobs: dict[Future[Any], list[FileSource]] = {}
        fixtures = [source for source in self._work.sources if source.in_child]
        if fixtures:
            jobs[self._submit(fixtures, "slow_formats")] = fixtures
        solids = [source for source in self._work.sources if source.slow_formats and not source.in_child]
        for source in sorted(solids, key=lambda source: -source.effort):
            jobs[self._submit([source], "slow_formats")] = [source]
        return jobs

    def _submit(self, sources: Sequence[FileSource], formats_of: str) -> Future[Any]:
        orders = tuple((source.thing, getattr(source, formats_of)) for source in sources)
        return self._workers.submit(make_in_child, orders, self._out, self._full)

    def _finish(self, jobs: dict[Future[Any], list[FileSource]], formats_of: str) -> None:
        """Take the results of the children in the order of completion."""
        for job in as_completed(jobs):
            sources = jobs[job]
            try:
                results = job.result()
            except TacbenchError as error:
                if error.exit_code != 1:
                    raise
                lost = [source.files[name] for source in sources for name in getattr(source, formats_of)]
                self._take([Failure(file=name, faults=(str(error),)) for name in lost])
                continue
            for source, (outcomes, mesh) in zip(sources, results, strict=True):
                if mesh is not None:
                    self._fixture_meshes[source.part.name] = mesh
                self._take(outcomes)

    def _take(self, outcomes: Sequence[Outcome]) -> None:
        for outcome in outcomes:
            if isinstance(outcome, Failure):
                self._result.failures.append(outcome)
            else:
                self._result.rows.append(outcome)
            name = outcome.file if isinstance(outcome, Failure) else str(outcome["file"])
            done = len(self._result.rows) + len(self._result.failures)
            self._progress(name, done, self._work.file_count)

    def _preview(self) -> None:
        """Draw every part with a file that has not failed so far."""
        failed = {failure.file for failure in self._result.failures}
        items = []
        for source in self._work.sources:
            part = source.part
            thing = self._fixture_meshes.get(part.name) if source.in_child else part
            if thing is not None and set(source.files.values()) - failed:
                size = " x ".join(f"{side:.4g}" for side in part.size_mm)
                items.append((f"{part.stem('mesh')}\n{size} mm", thing))
        reason = why_missing("matplotlib")
        if reason and not any(left.what == PREVIEW_NAME for left in self._result.left_out):
            self._result.left_out.append(LeftOut(what=PREVIEW_NAME, reason=reason))
        if items and not reason:
            from tacbench_cad.render.pictures import preview_sheet

            preview_sheet(items, self._out / PREVIEW_NAME)
            self._result.preview = True
        elif self._result.preview:
            (self._out / PREVIEW_NAME).unlink()
            self._result.preview = False

    def _write_manifest(self) -> None:
        """Write the rows of this run, and the rows of earlier runs for files that have not changed."""
        rows = manifest.merge(self._old, self._result.rows)
        if rows:
            manifest.write_manifest(self._out, manifest.unchanged(self._out, rows))
        self._result.rows.sort(key=lambda row: str(row["file"]))
