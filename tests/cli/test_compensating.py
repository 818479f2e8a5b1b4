"""What ``tacbench make --compensate`` says about a correction that does not reduce every error."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import pytest
from helpers.printers import PRINTER, points

from tacbench_cad.cli.compensating import show_effects
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.compensation import corrected_for, effect_of


@pytest.mark.parametrize(
    ("rule", "texture", "needle"),
    [
        ("formula", "6", "With a free relief they are "),
        ("free", "4", "the correction does not reduce both errors"),
        ("formula", "2", ""),
    ],
)
def test_a_larger_error_is_named_with_the_rule_that_helps(
    rule: Literal["formula", "free"], texture: str, needle: str, capsys: pytest.CaptureFixture[str]
) -> None:
    curve = points(*((length, 0.7 ** ((0.8 / length) ** 2)) for length in (0.2, 0.4, 0.6, 0.8, 1.2, 2.0, 4.0, 8.0)))
    model = replace(PRINTER, transfer_x=curve, transfer_y=curve, relief_rule=rule)
    show_effects([effect_of(corrected_for(Block.of(texture), model))])
    printed = capsys.readouterr().out
    assert needle in printed and ("both errors" in printed) == bool(needle)
