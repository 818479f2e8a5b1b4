"""Tab completion of the names of printers and filaments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import Items, of_words
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.extensions.slicing.printers import Printer


def of_printers(ctx: click.Context, incomplete: str) -> Items:
    """Offer the known printers and the printers in the file of ``--printers``."""
    return of_words(*_printers(ctx))(ctx, incomplete)


def of_filaments(ctx: click.Context, incomplete: str) -> Items:
    """Offer the filaments of the printer in ``--printer``, or of all printers."""
    printers = [printer for name, printer in _printers(ctx).items() if ctx.params.get("printer") in (None, name)]
    return of_words(*dict.fromkeys(name for printer in printers for name in printer.filaments))(ctx, incomplete)


def _printers(ctx: click.Context) -> dict[str, Printer]:
    """The known printers. A file with a mistake is ignored: the command itself reports the mistake."""
    from tacbench_cad.extensions.slicing.printers import printers

    try:
        return printers(ctx.params.get("printers"))
    except InputError:
        return printers()
