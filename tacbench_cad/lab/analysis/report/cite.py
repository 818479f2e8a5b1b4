"""The works to cite: the paper that introduced the textures, and this version of the program. See ``CITATION.cff``."""

from __future__ import annotations

from tacbench_cad import __version__
from tacbench_cad.util.errors import one_of

#: One line for each work. The paper's year, journal and DOI are not in CITATION.cff, so they are not here either.
TEXT = f"""\
D. R. Shepherd, N. Herzig, P. Husbands, A. Philippides, C. Johnson and W. Kimbell. \
A 3D-Printable Dataset for Fair Testing and Comparisons of Tactile Sensors.
The tacbench-cad authors. tacbench-cad, version {__version__}.
"""
#: One BibTeX entry for each work. Double braces keep the capitals of a title, and a group's name in one piece.
#: BibTeX ignores text outside of entries, so the first line is a comment.
BIBTEX = f"""\
% tacbench-cad does not know the paper's year, journal and DOI: please add them.
@misc{{shepherd_tactile_dataset,
  author = {{Shepherd, Dexter R. and Herzig, Nicolas and Husbands, Phil and Philippides, Andrew and Johnson, Chris \
and Kimbell, William}},
  title = {{{{A 3D-Printable Dataset for Fair Testing and Comparisons of Tactile Sensors}}}},
}}

@misc{{tacbench_cad,
  author = {{{{The tacbench-cad authors}}}},
  title = {{{{tacbench-cad}}}},
  note = {{Computer program, version {__version__}}},
}}
"""


def citations(form: str = "text") -> str:
    """Return the citations of both works.

    Args:
        form: ``text`` or ``bibtex``.

    Raises:
        InputError: The format is neither of the two.
    """
    one_of("format", form, ("text", "bibtex"))
    return TEXT if form == "text" else BIBTEX
