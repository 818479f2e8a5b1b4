"""The names of printers and filaments: those of the paper with their known spellings, and the user's own names."""

from __future__ import annotations

import re
from collections.abc import Mapping

from tacbench_cad.util.errors import InputError

#: The printers by their names in run folders, with the spellings (in lower case) in the authors' files.
PRINTERS: Mapping[str, tuple[str, ...]] = {
    "ender-3": ("ender", "ender3"),
    "ender-3-v3-se": ("creality", "crealty", "ender-3-v3", "ender3v3", "ender3v3se"),
    "bambu-p1p": ("bambu", "p1p", "bambulab"),
    "form-3": ("resin", "formlabs", "form3"),
}
#: The filaments, in the same way.
FILAMENTS: Mapping[str, tuple[str, ...]] = {
    "pla-plus": ("plaplus", "pla+"),
    "pla-minus": ("plaminus", "pla-", "pla-lite", "plalite"),
    "petg": ("rapidpetg", "rapid-petg"),
    "grey-v4": ("resin", "grey", "greyv4"),
}
#: The nine combinations of the paper's 8,100 images. The paper says that there are nine, but does not list them. Three
#: printers with three filaments each, and the resin printer, would be ten. This list leaves out PETG on the Ender-3
#: V3 SE.
COMBINATIONS: tuple[tuple[str, str], ...] = (
    ("ender-3", "pla-plus"),
    ("ender-3", "pla-minus"),
    ("ender-3", "petg"),
    ("ender-3-v3-se", "pla-plus"),
    ("ender-3-v3-se", "pla-minus"),
    ("bambu-p1p", "pla-plus"),
    ("bambu-p1p", "pla-minus"),
    ("bambu-p1p", "petg"),
    ("form-3", "grey-v4"),
)
#: The three combinations for which the paper has six prints of each texture.
SELECTED: tuple[tuple[str, str], ...] = (
    ("ender-3-v3-se", "pla-plus"),
    ("bambu-p1p", "pla-minus"),
    ("form-3", "grey-v4"),
)


_TABLES = {"printer": PRINTERS, "filament": FILAMENTS}


def own_name(field: str, word: str) -> str:
    """Return the name of a printer or a filament: a known name, or any other word that file names allow.

    Raises:
        InputError: The word has characters other than a-z, 0-9 and inner hyphens.
    """
    lowered = word.strip().lower()
    known = (name for name, words in _TABLES[field].items() if lowered == name or lowered in words)
    name = next(known, lowered)
    if not re.fullmatch(r"[a-z0-9]([a-z0-9-]{0,30}[a-z0-9])?", name):
        raise InputError(field, word, "must have 1 to 32 characters; use a-z, 0-9 and inner hyphens")
    return name
