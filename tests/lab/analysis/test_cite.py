"""Compare the citations with CITATION.cff."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.report.cite import citations
from tacbench_cad.util.errors import InputError

CFF = Path(__file__).parents[3] / "CITATION.cff"


def test_the_citations_equal_the_cff_file() -> None:
    text, bibtex = CFF.read_text(encoding="utf-8"), citations("bibtex")
    program, paper = text.split("preferred-citation:")
    assert re.findall(r"^version: (.+)$", program, re.M) == re.findall(r"version (.+)}", bibtex) == [__version__]
    titles = re.findall(r'title: "(.+)"$', paper, re.M) + re.findall(r"^title: (.+)$", program, re.M)
    assert titles == re.findall(r"title = {{(.+)}}", bibtex) and all(title in citations() for title in titles)
    first_names, last_names = (re.findall(rf"{name}-names: (.+)$", paper, re.M) for name in ("given", "family"))
    authors = [" and ".join(f"{last}, {first}" for first, last in zip(first_names, last_names, strict=True))]
    authors += [f"{{{name}}}" for name in re.findall(r"- name: (.+)$", program, re.M)]
    assert authors == re.findall(r"author = {(.+)}", bibtex)


def test_text_has_all_authors_the_title_and_the_version() -> None:
    first, second = citations().splitlines()
    assert first.startswith("D. R. Shepherd, N. Herzig, P. Husbands, A. Philippides, C. Johnson and W. Kimbell. A 3D-")
    assert second == f"The tacbench-cad authors. tacbench-cad, version {__version__}."


def test_an_unknown_format_is_refused_with_a_suggestion() -> None:
    with pytest.raises(InputError, match="format = 'bibtx': did you mean \"bibtex\""):
        citations("bibtx")


def test_the_readme_quotes_the_bibtex_entries() -> None:
    assert citations("bibtex") in CFF.with_name("README.md").read_text(encoding="utf-8")
