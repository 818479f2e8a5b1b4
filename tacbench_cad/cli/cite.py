"""``tacbench cite``: what to cite."""

from __future__ import annotations

from typing import Annotated

import typer

NAME = "cite"


def command(
    form: Annotated[str, typer.Option("--format", metavar="text|bibtex", help="Lines of text, or BibTeX.")] = "text",
) -> None:
    """What to cite: the paper whose textures these are, and this version of the program.

    Examples:
      tacbench cite
      tacbench cite --format bibtex >> references.bib
    """
    from tacbench_cad.lab.analysis.report.cite import citations

    typer.echo(citations(form), nl=False)
