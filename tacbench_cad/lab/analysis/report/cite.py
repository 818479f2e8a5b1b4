"""What to cite: the paper whose textures these are, and the version of this program. As ``CITATION.cff`` has it."""

from __future__ import annotations

from tacbench_cad import __version__
from tacbench_cad.util.errors import one_of

#: Both works as lines of a list of references. The paper's year and journal are not in CITATION.cff, so not here.
TEXT = f"""\
D. R. Shepherd, N. Herzig, P. Husbands, A. Philippides, C. Johnson and W. Kimbell. \
A 3D-Printable Dataset for Fair Testing and Comparisons of Tactile Sensors.
The tacbench-cad authors. tacbench-cad, version {__version__}.
"""
#: Both as BibTeX entries. Braces keep the capitals of a title and the name of a group whole.
BIBTEX = f"""\
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
    """Both citations.

    Args:
        form: ``text`` or ``bibtex``.

    Raises:
        InputError: It is another format.
    """
    one_of("format", form, ("text", "bibtex"))
    return TEXT if form == "text" else BIBTEX
