"""``tacbench cite``: print what to cite."""

from __future__ import annotations

import rich_click as click

from tacbench_cad.cli import options


@options.command("cite", "Share")
@options.option(
    "--format",
    options.choice("text", "bibtex"),
    "Lines of text, or BibTeX.",
    options.OUTPUT,
    dest="form",
    default="text",
)
def command(form: str) -> None:
    """Print what to cite.

    Please cite the paper that introduced the textures, and this version of the program.

    Examples:
      tacbench cite
      tacbench cite --format bibtex >> references.bib
    """
    from tacbench_cad.lab.analysis.report.cite import citations

    click.echo(citations(form), nl=False)
