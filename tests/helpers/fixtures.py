"""Fixtures that several tests share, because each keeps its solid, which takes half a second to build."""

from __future__ import annotations

from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.spec.block import Block

HOLDER = Holder(block=Block.of(1))
JIG = Jig(holder=HOLDER)
ALL_HOLES = Jig(holder=HOLDER, marks="all")
KEYED = Holder(block=Block.of(1, key_mm=3.0))
KEYED_JIG = Jig(holder=KEYED)
PAIR = Holder(block=Block.of(1, key_mm=3.0), slots=2, quarter_turns=1)
PAIR_JIG = Jig(holder=PAIR)
