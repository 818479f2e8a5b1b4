"""What only the user knows of a data set that is published, from a TOML file whose empty form is written first."""

from __future__ import annotations

import re
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

from tacbench_cad.util.convert import Bounds, Checked, read_toml
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
        orcid: The ORCID, as ``0000-0002-1825-0097``.
    """

    family_name: str
    given_names: str
    affiliation: str
    orcid: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _require_filled(self, "[authors] ")
        if self.orcid is not None and not (_ORCID.fullmatch(self.orcid) and _check_digit(self.orcid) == self.orcid[-1]):
            raise InputError("[authors] orcid", self.orcid, "must be an ORCID, as 0000-0002-1825-0097")

    @property
    def name(self) -> str:
        """Family name first."""
        return f"{self.family_name}, {self.given_names}"


@dataclass(frozen=True, kw_only=True)
class Publication(Checked):
    """What the user says of a data set.

    Args:
        title: Its title.
        year: The year of publication.
        publisher: Who publishes it.
        licence: SPDX identifier of the licence.
        authors: The authors.
        licence_file: The licence's text, from the TOML file's folder.
        description: What was done and why.
        keywords: Keywords.
        doi: A reserved DOI.
        related: DOIs and addresses of what the data belong to.
    """

    title: str
    year: Annotated[int, Bounds(0, 2200)]
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
            raise InputError("year", self.year, "must be the year of publication, from 1900")
        if not _SPDX.fullmatch(self.licence):
            raise InputError("licence", self.licence, "must be an SPDX identifier, as CC-BY-4.0")
        if self.doi is not None and not _DOI.fullmatch(self.doi):
            raise InputError("doi", self.doi, "must be a DOI, as 10.5281/zenodo.1234567")
        other = next((text for text in self.related if not (_DOI.fullmatch(text) or text.startswith("https://"))), None)
        if other is not None:
            raise InputError("related", other, "must be a DOI, as 10.1000/182, or an address that begins with https://")

    @property
    def licence_url(self) -> str:
        """Where the licence's text is."""
        return f"https://spdx.org/licenses/{self.licence}.html"


def is_doi(text: str) -> bool:
    """Whether a text is a DOI; else it is an address."""
    return _DOI.fullmatch(text) is not None


def read_publication(path: Path) -> Publication:
    """Read the file.

    Raises:
        InputError: It cannot be read, or a key that only the user knows is missing or empty.
    """
    publication = read_toml(path, Publication, "publication")
    if publication.licence_file is None:
        return publication
    return replace(publication, licence_file=str(path.parent / publication.licence_file))


def write_form(path: Path) -> None:
    """Write the empty form to a new file.

    Raises:
        InputError: There is something at that path already, or it cannot be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError("init", str(path), "is there already; name a new file")
    write_text(path, FORM_FILE.read_text("utf-8"))


def _require_filled(value: Any, where: str = "") -> None:
    for attribute in fields(value):
        content = getattr(value, attribute.name)
        if attribute.default is not MISSING:  # it may be left out
            continue
        if not content or (isinstance(content, str) and not content.strip()):
            raise InputError(f"{where}{attribute.name}", None, "is empty; only you know it, so fill it in")


def _check_digit(orcid: str) -> str:
    """The last digit of an ORCID by ISO 7064 MOD 11-2."""
    total = 0
    for digit in orcid.replace("-", "")[:-1]:
        total = (total + int(digit)) * 2 % 11
    rest = (12 - total) % 11
    return "X" if rest == 10 else str(rest)
