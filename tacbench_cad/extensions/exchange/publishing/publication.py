"""The user's description of a data set, which is read from a TOML file. The program writes the empty form."""

from __future__ import annotations

import re
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from tacbench_cad.util.convert import Checked, read_toml
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_text

#: The empty form.
FORM_FILE = Path(__file__).with_name("publication.toml")
_ORCID = re.compile(r"\d{4}-\d{4}-\d{4}-\d{3}[\dX]")
_DOI = re.compile(r"10\.\d{4,9}/\S+")
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")


@dataclass(frozen=True, kw_only=True)
class Author(Checked):
    """An author.

    Args:
        family_name: The family name.
        given_names: The given names.
        affiliation: The institution.
        orcid: The ORCID, for example ``0000-0002-1825-0097``.
    """

    family_name: str
    given_names: str
    affiliation: str
    orcid: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_filled(self)
        if self.orcid is not None and not (_ORCID.fullmatch(self.orcid) and _check_digit(self.orcid) == self.orcid[-1]):
            raise InputError("orcid", self.orcid, "must be an ORCID, for example 0000-0002-1825-0097")

    @property
    def name(self) -> str:
        """The name, with the family name first."""
        return f"{self.family_name}, {self.given_names}"


@dataclass(frozen=True, kw_only=True)
class Publication(Checked):
    """The user's description of a data set.

    Args:
        title: The title.
        year: The year of publication.
        publisher: The publisher.
        licence: The SPDX identifier of the licence.
        authors: The authors.
        licence_file: The file of the licence's text, relative to the TOML file's folder.
        description: What was done and why.
        keywords: The keywords.
        doi: A reserved DOI.
        related: The DOIs and addresses of related publications.
    """

    title: str
    year: Annotated[int, Interval(ge=0, le=2200)]
    publisher: str
    licence: str
    authors: tuple[Author, ...]
    licence_file: str | None = None
    description: str = ""
    keywords: tuple[str, ...] = ()
    doi: str | None = None
    related: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_filled(self)
        if self.year < 1900:
            raise InputError("year", self.year, "must be the year of publication, 1900 or later")
        if not _SPDX.fullmatch(self.licence):
            raise InputError("licence", self.licence, "must be an SPDX identifier, for example CC-BY-4.0")
        if self.doi is not None and not _DOI.fullmatch(self.doi):
            raise InputError("doi", self.doi, "must be a DOI, for example 10.5281/zenodo.1234567")
        other = next((text for text in self.related if not (_DOI.fullmatch(text) or text.startswith("https://"))), None)
        if other is not None:
            raise InputError("related", other, "must be a DOI, for example 10.1000/182, or begin with https://")

    @property
    def licence_url(self) -> str:
        """The address of the licence's text."""
        return f"https://spdx.org/licenses/{self.licence}.html"


def is_doi(text: str) -> bool:
    """Return whether a text is a DOI."""
    return _DOI.fullmatch(text) is not None


def read_publication(path: Path) -> Publication:
    """Read a description of a data set.

    Raises:
        InputError: The file cannot be read, or a required key is missing or empty.
    """
    publication = read_toml(path, Publication, "publication")
    if publication.licence_file is None:
        return publication
    return replace(publication, licence_file=str(path.parent / publication.licence_file))


def write_form(path: Path) -> None:
    """Write the empty form to a new file.

    Raises:
        InputError: The path already exists, or cannot be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError("init", str(path), "already exists; choose a new file")
    write_text(path, FORM_FILE.read_text("utf-8"))


def _require_filled(value: Any) -> None:
    for attribute in fields(value):
        content = getattr(value, attribute.name)
        if attribute.default is not MISSING:  # an optional key
            continue
        if not content or (isinstance(content, str) and not content.strip()):
            raise InputError(attribute.name, None, "is empty; fill it in, because only you know its value")


def _check_digit(orcid: str) -> str:
    """Return the last digit of an ORCID, which is a check digit by ISO 7064 MOD 11-2."""
    total = 0
    for digit in orcid.replace("-", "")[:-1]:
        total = (total + int(digit)) * 2 % 11
    rest = (12 - total) % 11
    return "X" if rest == 10 else str(rest)
