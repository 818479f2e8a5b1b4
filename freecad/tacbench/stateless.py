"""What proxies of FreeCAD objects share: a document stores no state of them, only their class."""

from __future__ import annotations

from typing import Any


class Stateless:
    """An object without a state of its own. FreeCAD 0.20 calls the first two methods, and 0.21 the others."""

    def __getstate__(self) -> None:
        return None

    def __setstate__(self, state: Any) -> None:
        pass

    def dumps(self) -> None:
        """Return the state that a document stores: none."""

    def loads(self, state: Any) -> None:
        """Restore the state from a document."""
