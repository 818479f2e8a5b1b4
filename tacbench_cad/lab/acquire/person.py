"""The person at the rig, who puts blocks in, confirms their labels and teaches heights."""

from __future__ import annotations

from collections.abc import Callable

from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import InputError

#: The number of attempts to type a label.
TRIES = 5


class Person:
    """The person who puts the blocks in. This class is nobody: the block lies in the rig already.

    Attributes:
        is_asked_always: Whether the person is also asked to put blocks into a simulated rig.
    """

    is_asked_always = False

    def put_in(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """Ask the person to put a block in.

        Args:
            printed: The block.
            label: The text on its underside.
            slot: The slot of the tray, from 1; None if there is only one.

        Raises:
            InputError: The person did not confirm the block.
        """

    def first_touch(self, printed: PrintedBlock, positions: int) -> tuple[float, ...]:
        """Ask for the heights of first touch in mm of the work frame: one for all positions, or one for each.

        Args:
            printed: The block in the holder.
            positions: The number of positions.

        Raises:
            InputError: The person entered no valid height.
        """
        raise InputError("touch", "taught", 'needs a person who types the heights; use touch = "sensor" or "gauge"')

    def press_anyway(self, problem: str) -> bool:
        """Ask whether a block is pressed in spite of a problem. Without an answer it is not.

        Args:
            problem: The problem, as a sentence without its full stop.
        """
        return False


class Typing(Person):
    """A person at a terminal, or a script on the standard input.

    Args:
        ask: Shows a text and returns the typed line. It raises an ``InputError`` at the end of the input.
        say: Shows a text.
    """

    def __init__(self, ask: Callable[[str], str], say: Callable[[str], None]) -> None:
        self.ask = ask
        self.say = say

    def put_in(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """See :class:`Person` and :func:`is_label`."""
        where = "the holder" if slot is None else f"slot {slot}"
        self.say(
            f"Put into {where}: {printed.texture}, preset {printed.block.preset}, scale {printed.block.scale:g}, "
            f"{printed.printer}, {printed.filament}, copy {printed.copy}"
        )
        for _ in range(TRIES):
            typed = self.ask(f"Its label ({label}): ")
            if is_label(typed, label, printed.name):
                return
            self.say(f"{typed!r} is the label of another block; this block must have {label}")
        raise InputError("label", typed, f"must be {label}; nothing was pressed")

    def first_touch(self, printed: PrintedBlock, positions: int) -> tuple[float, ...]:
        """See :class:`Person`."""
        typed = self.ask(
            f"First touch on {printed.name}, z in mm of the work frame, one number or {positions} separated by commas: "
        )
        try:
            return tuple(float(word) for word in typed.split(","))
        except ValueError:
            raise InputError("first touch", typed, "must be numbers separated by commas") from None

    def press_anyway(self, problem: str) -> bool:
        """See :class:`Person`."""
        try:
            return self.ask(f"{problem}. Type yes to press it as it is: ").strip().casefold() == "yes"
        except InputError:
            return False


def is_label(typed: str, label: str, run: str) -> bool:
    """Return whether a typed text is the label of a block, or the name of its run. Case and blanks are ignored."""
    plain, *allowed = ("".join(text.split()).casefold() for text in (typed, label, run))
    return plain in allowed
