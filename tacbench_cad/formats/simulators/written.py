"""What a target's writer hands back."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TargetFiles:
    """The files of one target in one folder.

    Args:
        files: Their paths from the folder, with ``/``.
        note: Markdown for the folder's README: files, units, axes, error, contact settings, what was tested.
    """

    files: tuple[str, ...]
    note: str
