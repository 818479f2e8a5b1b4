"""The metadata of a data set: in DataCite's schema, for Zenodo, and as an RO-Crate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.extensions.exchange.publishing.publication import Author, Publication, is_doi

#: The media types of files, by suffix.
MEDIA_TYPES = {
    ".stl": "model/stl",
    ".3mf": "model/3mf",
    ".step": "model/step",
    ".html": "text/html",
    ".md": "text/markdown",
    ".csv": "text/csv",
    ".json": "application/json",
    ".txt": "text/plain",
}
#: The title of the project's paper. Its address is unknown.
TEXTURES_FROM = "A 3D-Printable Dataset for Fair Testing and Comparisons of Tactile Sensors"


@dataclass(frozen=True, kw_only=True)
class DataSetPart:
    """A file or folder of the data set.

    Args:
        path: The path, relative to the data set's folder. The path of a folder ends with a slash.
        name: The name.
        description: The description.
        sha256: The SHA-256 of a file.
        size: The size of a file, in bytes.
    """

    path: str
    name: str
    description: str = ""
    sha256: str | None = None
    size: int | None = None


def datacite(publication: Publication, description: str, keywords: Sequence[str]) -> dict[str, Any]:
    """Return the metadata in DataCite's schema 4."""
    related = [
        {
            "relatedIdentifier": text,
            "relatedIdentifierType": "DOI" if is_doi(text) else "URL",
            "relationType": "IsSupplementTo",
        }
        for text in publication.related
    ]
    document = {
        "schemaVersion": "http://datacite.org/schema/kernel-4",
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Tactile sensor data"},
        "creators": [_creator(author) for author in publication.authors],
        "titles": [{"title": publication.title}],
        "publisher": {"name": publication.publisher},
        "publicationYear": str(publication.year),
        "subjects": [{"subject": keyword} for keyword in keywords],
        "rightsList": [
            {
                "rights": publication.licence,
                "rightsUri": publication.licence_url,
                "rightsIdentifier": publication.licence,
                "rightsIdentifierScheme": "SPDX",
                "schemeUri": "https://spdx.org/licenses/",
            }
        ],
        "descriptions": [{"description": description, "descriptionType": "Abstract"}],
        **({"relatedIdentifiers": related} if related else {}),
    }
    return document | ({"doi": publication.doi} if publication.doi else {})


def _creator(author: Author) -> dict[str, Any]:
    identifier = {
        "nameIdentifier": f"https://orcid.org/{author.orcid}",
        "nameIdentifierScheme": "ORCID",
        "schemeUri": "https://orcid.org",
    }
    return {
        "name": author.name,
        "nameType": "Personal",
        "givenName": author.given_names,
        "familyName": author.family_name,
        "affiliation": [{"name": author.affiliation}],
        **({"nameIdentifiers": [identifier]} if author.orcid else {}),
    }


def zenodo(publication: Publication, description: str, keywords: Sequence[str]) -> dict[str, Any]:
    """Return the metadata for Zenodo's upload form."""
    creators = [
        {
            "name": author.name,
            "affiliation": author.affiliation,
            **({"orcid": author.orcid} if author.orcid else {}),
        }
        for author in publication.authors
    ]
    related = [{"identifier": text, "relation": "isSupplementTo"} for text in publication.related]
    return {
        "upload_type": "dataset",
        "title": publication.title,
        "creators": creators,
        "description": description,
        "keywords": list(keywords),
        "access_right": "open",
        "license": publication.licence,
        **({"related_identifiers": related} if related else {}),
        **({"doi": publication.doi} if publication.doi else {}),
    }


def write_crate(
    folder: Path,
    publication: Publication,
    description: str,
    keywords: Sequence[str],
    parts: Sequence[DataSetPart],
    *,
    textures: bool,
) -> None:
    """Write ``ro-crate-metadata.json``, which lists the contents of the folder.

    Args:
        folder: The data set's folder.
        publication: The user's description of the data set.
        description: The description of the data.
        keywords: The keywords.
        parts: The files and folders of the data set.
        textures: Whether the blocks have this project's textures. The paper is then cited.
    """
    from rocrate.model import ContextEntity, Person
    from rocrate.rocrate import ROCrate

    crate = ROCrate()
    licence = ContextEntity(
        crate, publication.licence_url, properties={"@type": "CreativeWork", "name": publication.licence}
    )
    software = {"@type": "SoftwareApplication", "name": "tacbench-cad", "softwareVersion": __version__}
    authors = [
        Person(
            crate,
            f"https://orcid.org/{author.orcid}" if author.orcid else f"#author-{number}",
            properties={
                "name": f"{author.given_names} {author.family_name}",
                "givenName": author.given_names,
                "familyName": author.family_name,
                "affiliation": author.affiliation,
            },
        )
        for number, author in enumerate(publication.authors, start=1)
    ]
    publisher = ContextEntity(crate, "#publisher", properties={"@type": "Organization", "name": publication.publisher})
    root = crate.root_dataset
    root["name"], root["description"] = publication.title, description
    root["datePublished"], root["keywords"] = str(publication.year), ", ".join(keywords)
    root["license"], root["publisher"] = crate.add(licence), crate.add(publisher)
    root["author"] = [crate.add(author) for author in authors]
    if textures:
        about = {"@type": "ScholarlyArticle", "name": TEXTURES_FROM}
        root["citation"] = crate.add(ContextEntity(crate, "#textures", properties=about))
    root["mentions"] = crate.add(ContextEntity(crate, "#tacbench-cad", properties=software))
    if publication.doi:
        root["identifier"] = f"https://doi.org/{publication.doi}"
    for part in parts:
        properties: dict[str, Any] = {
            "name": part.name,
            **({"description": part.description} if part.description else {}),
        }
        if part.path.endswith("/"):
            crate.add_dataset(dest_path=part.path, properties=properties)
            continue
        suffix = Path(part.path).suffix.lower()
        properties |= {"encodingFormat": MEDIA_TYPES[suffix]} if suffix in MEDIA_TYPES else {}
        properties |= {"contentSize": str(part.size), "sha256": part.sha256}
        crate.add_file(dest_path=part.path, properties=properties)
    crate.metadata.write(folder)
