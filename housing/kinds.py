"""The kinds of fixtures. A new one is a subclass of :class:`housing.fixture.Fixture` and a name in this tuple."""

from __future__ import annotations

from housing.coupon import Coupon
from housing.fixture import Fixture
from housing.holder import Holder
from housing.jig import Jig

#: The fixtures by their kinds, in the order in which they are listed.
FIXTURES: dict[str, type[Fixture]] = {kind.kind: kind for kind in (Holder, Jig, Coupon)}
