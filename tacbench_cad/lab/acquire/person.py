"""The person at the rig: puts blocks in, reads their labels back, teaches heights."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import InputError

#: A wrong label is asked for again so many times.
TRIES = 5


class Person(Protocol):
    """Who puts the blocks in."""

    def put_in(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """Have a block put in.

        Args:
            printed: The block.
            label: What stands on its underside.
            slot: Slot of the tray from 1, or None where there is one only.

        Raises:
            InputError: It was not confirmed.
        """

    def first_touch(self, printed: PrintedBlock, positions: int) -> tuple[float, ...]:
        """Heights of first touch in mm of the work frame: one for all positions, or one for each.

        Args:
            printed: The block that lies there.
            positions: How many positions are pressed.

        Raises:
            InputError: None was given.
        """


class Typing:
    """A person at a terminal, or a script on the standard input.

    Args:
        ask: Shows a text and returns the line that is typed; raises an ``InputError`` at the input's end.
        say: Shows a text.
    """

    def __init__(self, ask: Callable[[str], str], say: Callable[[str], None]) -> None:
        self.ask = ask
        self.say = say

    def put_in(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """See :class:`Person`. The label is compared without case and blanks; the run's name will do as well."""
        where = "the holder" if slot is None else f"slot {slot}"
        self.say(
            f"Put into {where}: {printed.texture}, preset {printed.block.preset}, scale {printed.block.scale:g}, "
            f"{printed.printer}, {printed.filament}, copy {printed.copy}"
        )
        for _ in range(TRIES):
            typed = self.ask(f"Its label ({label}): ")
            if _plain(typed) in (_plain(label), _plain(printed.name)):
                return
            self.say(f"{typed!r} is another block; this one says {label}")
        raise InputError("label", typed, f"must be {label}; nothing was pressed")

    def first_touch(self, printed: PrintedBlock, positions: int) -> tuple[float, ...]:
        """See :class:`Person`."""
        typed = self.ask(
            f"First touch on {printed.name}, z in mm of the work frame, one number or {positions} with commas: "
        )
        try:
            return tuple(float(word) for word in typed.split(","))
        except ValueError:
            raise InputError("first touch", typed, "must be numbers with commas between them") from None


def _plain(text: str) -> str:
    return "".join(text.split()).casefold()
