"""The places of the program whose messages say what is allowed, found in its source, and what a message offers."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from helpers.checkout import ROOT
from tacbench_cad.util.errors import InputError, MissingToolError

#: Texts of messages that offer words, a range, an ending or an example.
_OFFERING = re.compile(r"allowed:|must be (one of|from|[^…]* or |…|$)|must end|such as|for example|also allowed")
#: What the placeholders in messages stand for.
STAND_INS: Mapping[str, Any] = {
    "module:name": "helpers.wrong_drivers:GoodStage",
    "a TOML file": "mine.toml",
    "1 to 6": [str(number) for number in range(1, 7)],
    "texture-1 to texture-6": [f"texture-{number}" for number in range(1, 7)],
    "A to Z": list("ABCDEFGHIJKLMNOPQRSTUVWXYZ"),
    "0 to 9": list("0123456789"),
}
#: The functions whose calls make such messages.
_MAKERS = {"load_named", "one_of", "nearest", "require_between"}


@dataclass(frozen=True, kw_only=True)
class Offer:
    """A place whose message says what is allowed.

    Args:
        attempt: Calls the program with a value.
        wrong: A value that the place refuses.
        things: What the message offers: values whose texts are in the message, or texts of the message with the values
            that they stand for. None: the words after ``allowed:``.
        later: A pattern for messages of later checks, which a value may meet when it is past this one.
    """

    attempt: Callable[[Any], object]
    wrong: Any
    things: Sequence[Any] | Mapping[str, Any] | None = None
    later: str = ""

    def check(self) -> int:
        """Check that the wrong value is refused and that everything that the message offers is accepted.

        Returns:
            The number of things that the message offers.
        """
        with pytest.raises(InputError) as refused:
            self.attempt(self.wrong)
        message = str(refused.value)
        things = _things(message) if self.things is None else self.things
        for shown in things:
            assert _text(shown) in message, f"{_text(shown)!r} is not in {message!r}"
        values = [_meant(thing) for thing in (things.values() if isinstance(things, Mapping) else things)]
        for value in [each for group in values for each in (group if isinstance(group, list) else [group])]:
            try:
                self.attempt(value)
            except MissingToolError:
                pass  # the value is allowed, and needs a package that is not installed here
            except InputError as error:
                again = f"{value!r} is offered by {message!r} and refused by {str(error)!r}"
                assert self.later and re.search(self.later, str(error)), again
        return len(values)


def past(call: Callable[[Any], object]) -> Callable[[Any], object]:
    """Return the call without the errors that follow if a check is passed with None in the place of other arguments."""

    def attempt(value: Any) -> object:
        try:
            return call(value)
        except (AttributeError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            return None

    return attempt


def _things(message: str) -> list[Any]:
    """Return the words after ``allowed:`` in a message, or both ends of its range."""
    ends = re.search(r"\b(?:be|number|or) from (-?[\d.e+-]+) to ([\d.e+-]+)", message)
    if ends is not None:
        kind = float if re.search(r"[.e]", ends[1] + ends[2]) else int
        return [kind(ends[1].rstrip(".")), kind(ends[2].rstrip("."))]
    _, found, words = message.partition("llowed: ")
    assert found, f"{message!r} says neither what is allowed nor a range"
    return re.split(r", (?:or )?| or ", words.partition(";")[0])


def _meant(thing: Any) -> Any:
    return STAND_INS.get(thing, thing) if isinstance(thing, str) else thing


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def sites() -> Counter[str]:
    """Return how many messages that offer something each function has, as ``module:Class.function``."""
    found: Counter[str] = Counter()
    for path in sorted((ROOT / "tacbench_cad").rglob("*.py")):
        if path.name == "identify.py":  # its function "nearest" finds shapes
            continue
        module = path.relative_to(ROOT / "tacbench_cad").with_suffix("").as_posix().replace("/", ".")
        found.update(f"{module}:{name}" for name in _in(ast.parse(path.read_text(encoding="utf-8"))))
    return found


def _in(tree: ast.AST) -> list[str]:
    """Return the name of the function of each message in a module."""
    found, waiting = [], [(tree, "")]
    while waiting:
        node, name = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            name = f"{name}.{node.name}".lstrip(".")
        elif isinstance(node, ast.Call):
            function = getattr(node.func, "id", getattr(node.func, "attr", ""))
            is_maker = function in _MAKERS and isinstance(node.func, ast.Name)
            texts = [*node.args[1:], *(word.value for word in node.keywords)]
            if is_maker or (function in ("InputError", "_FaultError") and _offers(*texts)):
                found.append(name)
        elif isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "allowed" and _offers(node.value):
            found.append(name)
        waiting += [(child, name) for child in ast.iter_child_nodes(node)]
    return found


def _offers(*nodes: ast.AST) -> bool:
    """Return whether the texts of an expression offer something; what is inserted into them is left out."""
    parts = [part for node in nodes for part in ast.walk(node) if isinstance(part, ast.Constant)]
    return bool(_OFFERING.search("…".join(part.value for part in parts if isinstance(part.value, str))))


def texture_file(folder: Path) -> Path:
    """Write a texture file, which messages call "a TOML file"."""
    path = folder / "mine.toml"
    path.write_text('[texture]\nname = "mine"\nfamily = "series"\nlaw = "square"\nN = 5\n', encoding="utf-8")
    return path
