"""Test that formats come from other packages, and that the import says so if an extension is missing."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab import ImportOptions, Run, import_samples
from tacbench_cad.lab.runs import ImportFormat, Paths, Sample, Source
from tacbench_cad.lab.runs.importing import import_formats
from tacbench_cad.util.errors import InputError, MissingToolError


def _read(path: Path, paths: Paths, options: ImportOptions) -> Source:
    numbers = np.loadtxt(path)
    sample = Sample(name=path.name, fields={"label": path.stem}, load=lambda: numbers, file=path)
    return Source(kind="a file of numbers", path=path, samples=[sample])


#: A format as another package would have it.
THEIRS = ImportFormat(recognises=lambda path, *_: path.suffix == ".dat", read=_read, suffixes=(".dat",))


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that replaces the formats of other packages, by name and object."""

    def offer(**objects: str) -> None:
        entries = {name: EntryPoint(name, value, import_formats.GROUP) for name, value in objects.items()}
        monkeypatch.setattr(import_formats, "entries", lambda group: entries)

    return offer


@pytest.mark.parametrize("kind", [None, "numbers"])
def test_another_package_adds_a_format(kind: str | None, offered: Any, tmp_path: Path) -> None:
    offered(numbers=f"{__name__}:THEIRS")
    numbers = np.arange(6.0).reshape(2, 3)
    np.savetxt(tmp_path / "cork.dat", numbers)
    report = import_samples([tmp_path], tmp_path / "out", ImportOptions(kind=kind))
    assert report.ok
    run = Run.open(tmp_path / "out" / "cork")
    assert np.array_equal(run.frame(run.rows[0]), numbers)


def test_the_reason_names_the_formats_of_an_extension_that_is_missing(offered: Any, tmp_path: Path) -> None:
    offered(authors="tacbench_cad.extensions.nowhere.authors:FORMAT", films="tacbench_cad.extensions.nowhere.films:F")
    (tmp_path / "press.mp4").write_bytes(b"")
    (left_out,) = import_samples([tmp_path / "press.mp4"], tmp_path / "out").left_out
    assert left_out.reason.endswith(
        "; the formats authors, films need tacbench_cad.extensions.nowhere, which is not installed"
    )
    with pytest.raises(MissingToolError, match=r"films needs tacbench_cad\.extensions\.nowhere"):
        import_samples([tmp_path / "press.mp4"], tmp_path / "out", ImportOptions(kind="films"))


def test_options_of_a_format_need_its_kind(tmp_path: Path) -> None:
    for kind, message in ((None, "--kind is missing"), ("arrays", "--kind arrays has no such options")):
        with pytest.raises(InputError, match=message):
            import_samples([tmp_path], tmp_path / "out", ImportOptions(kind=kind, of_format={"a": "b"}))
