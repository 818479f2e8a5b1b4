"""The kinds of fixtures. To add a kind, write a subclass of ``housing.fixture.Fixture`` and add it here."""

from __future__ import annotations

from housing.coupon import Coupon
from housing.fixture import Fixture
from housing.holder import Holder
from housing.jig import Jig

#: The fixtures by their kinds, in the order in which they are listed.
FIXTURES: dict[str, type[Fixture]] = {kind.kind: kind for kind in (Holder, Jig, Coupon)}
