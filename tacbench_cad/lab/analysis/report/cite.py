"""What to cite: the paper whose textures these are, and the version of this program. As ``CITATION.cff`` has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tacbench_cad import __version__
from tacbench_cad.util.errors import one_of

Format = Literal["text", "bibtex"]
#: The formats of a citation.
FORMATS = ("text", "bibtex")


@dataclass(frozen=True, kw_only=True)
class Citation:
    """A work to cite.

    Args:
        key: Its key in BibTeX.
        kind: ``article`` or ``software``.
        title: Title.
        authors: Given names and family names; an author without a given name is a group.
        version: Version of a program, else empty.
    """

    key: str
    kind: str
    title: str
    authors: tuple[tuple[str, str], ...]
    version: str = ""

    @property
    def text(self) -> str:
        """The citation as a line of a list of references."""
        names = [f"{_initials(given)} {family}" if given else family for given, family in self.authors]
        people = " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
        version = f", version {self.version}" if self.version else ""
        return f"{people}. {self.title}{version}."

    @property
    def bibtex(self) -> str:
        """The citation as a BibTeX entry. Braces keep the title's capitals and a group's name whole."""
        people = " and ".join(f"{family}, {given}" if given else f"{{{family}}}" for given, family in self.authors)
        fields = {"author": people, "title": f"{{{self.title}}}"}
        if self.version:
            fields["note"] = f"Computer program, version {self.version}"
        body = "".join(f"  {name} = {{{value}}},\n" for name, value in fields.items())
        return f"@misc{{{self.key},\n{body}}}\n"


#: The paper. Its year and journal are not in CITATION.cff, so they are not here.
PAPER = Citation(
    key="shepherd_tactile_dataset",
    kind="article",
    title="A 3D-Printable Dataset for Fair Testing and Comparisons of Tactile Sensors",
    authors=(
        ("Dexter R.", "Shepherd"),
        ("Nicolas", "Herzig"),
        ("Phil", "Husbands"),
        ("Andrew", "Philippides"),
        ("Chris", "Johnson"),
        ("William", "Kimbell"),
    ),
)
#: This program.
PROGRAM = Citation(
    key="tacbench_cad",
    kind="software",
    title="tacbench-cad",
    authors=(("", "The tacbench-cad authors"),),
    version=__version__,
)


def citations(form: str = "text") -> str:
    """Both citations.

    Args:
        form: ``text`` or ``bibtex``.

    Raises:
        InputError: It is another format.
    """
    one_of("format", form, FORMATS)
    both = (PAPER, PROGRAM)
    return "\n".join(work.bibtex for work in both) if form == "bibtex" else "".join(f"{work.text}\n" for work in both)


def _initials(given: str) -> str:
    return " ".join(f"{name[0]}." for name in given.split())
