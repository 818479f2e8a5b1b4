"""One press: down in limited steps until the target is reached, and up again.

On the way down to the height from which the search starts, the force is read at short intervals, since a motor may have
slipped and the block may be nearer than the stage reports.

In contact, a step is longer than an approach step only if earlier approaches on the block have shown how the force
grows with depth. The start of such a step is the measured force, so an unexpected height of the block does not matter.

The search always approaches from above. Printed plastic and a gel-filled dome show hysteresis and creep, and a stage
has backlash, so the force at a height depends on the direction of the last motion. After a press that is too hard, the
sensor is therefore lifted half an approach step above the new height and lowered to it again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from tacbench_cad.lab.acquire.force_search import GROWTH, ContactForce, KnownGrowth, Slope
from tacbench_cad.lab.acquire.safety import Carriage
from tacbench_cad.lab.acquire.touch import Touch
from tacbench_cad.lab.rig.errors import ContactError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import Point, Protocol

#: The start of the next approach at the same place, in approach steps above the lowest free height.
MARGIN_STEPS = 2.0
#: The largest change of the height at which the sensor is free that comes from the length of the steps, in approach
#: steps.
FREE_STEPS = 1.5
#: The distance from the target, in half widths of the band, beyond which a shorter step is taken, since predictions
#: lag, and after which the force is read without waiting until the step has settled.
FAR_BANDS = 4.0
#: The fraction of the predicted step that is taken there.
FAR_FRACTION = 0.8
#: The longest way up after a force that is too large, in approach steps. After a slip, the contact can seem very soft.
MAX_UP_STEPS = 5.0
#: The distance above the highest expected contact at which the stepwise approach starts at a new position, in mm.
NEW_MARGIN_MM = 0.5
#: The distance above the start of the stepwise approach down to which the sensor moves at the travel speed, in mm.
SLOW_MM = 1.0
#: The largest force, as a fraction of the hard limit, that a move through free air could reach if the block were there.
BLIND_FRACTION = 0.5
#: The assumed growth of the force with the depth, ``F ~ depth^3``, beyond the depth of an earlier press.
BLIND_POWER = 3.0


@dataclass(frozen=True, kw_only=True)
class SettledPress:
    """The sensor in contact, ready to be read.

    Args:
        pose_mm: The position that the stage reports, in mm of the work frame.
        measured: The settled force, or None without a gauge.
        in_band: Whether the force is in the target's band; None in depth mode.
        touch_mm: The height of first touch in depth mode, in mm of the work frame; None in force mode.
    """

    pose_mm: Point
    measured: Force | None
    in_band: bool | None
    touch_mm: float | None = None


class Presser:
    """Presses one block, position by position, and remembers the heights at which the sensor was free.

    Args:
        protocol: The protocol.
        carriage: Moves the sensor.
        force: Reads the force; None on a rig without a gauge.
        touch: Finds the height of first touch in depth mode; None in force mode.
        nominal_mm: Returns the height of first touch at a position that the formula of the texture gives, except for
            an unknown constant; None if every position is approached in steps from the travel height.
        known_mm: Returns the height at which a press reaches its target, on a rig that knows it; None on all others.
        touched: Called once, at the first touch of the block, with the height of this touch minus the nominal one. It
            may lift the sensor, and raise an error to leave the block.
    """

    def __init__(
        self,
        protocol: Protocol,
        carriage: Carriage,
        force: ContactForce | None,
        touch: Touch | None,
        nominal_mm: Callable[[float, float], float] | None = None,
        known_mm: Callable[[Press], float] | None = None,
        touched: Callable[[float], None] = lambda above_mm: None,
    ) -> None:
        self.protocol = protocol
        self.nominal_mm, self.known_mm = nominal_mm, known_mm
        self._touched, self._was_touched = touched, False
        self.carriage = carriage
        self.force = force
        self.touch = touch
        self._growth = KnownGrowth(step_mm=protocol.steps.approach_step_mm)
        #: The longest move after which the force is still safe, if the sensor was free at its start.
        self._blind_mm = protocol.steps.approach_step_mm
        self._free_mm: dict[int, float] = {}
        #: The largest difference between the heights at which the sensor was free and the formula's heights.
        self._above_nominal_mm = -math.inf
        self._touch_mm: dict[int, float] = {}
        #: The height at which the sensor was free in the last approach, minus that of the approach before at the same
        #: position, in mm; None if there is none.
        self.free_change_mm: float | None = None

    def press(self, press: Press) -> SettledPress:
        """Move over the position, read the free force, and press.

        Args:
            press: The position and the target.

        Returns:
            The contact at the best force, or at the given depth. The sensor stays there.

        Raises:
            RigError: A limit was exceeded or a device failed. The caller lifts the sensor.
        """
        self.carriage.over(press.x_mm, press.y_mm)
        if self.force is not None:
            self.force.follow_zero()
        if self.known_mm is not None:
            known_mm = self.known_mm(press)
            self.carriage.to_height(known_mm)
            return self._settled(press, None if press.depth_mm is None else known_mm + press.depth_mm)
        if press.depth_mm is None:
            return self._to_force(press)
        return self._to_depth(press, press.depth_mm)

    def touch_change_mm(self, press: Press) -> float | None:
        """Find the height of first touch at a position of depth mode again, and return it minus the first one.

        Returns:
            The change in mm; None if the first one was taught by a person, or was found in another session.

        Raises:
            RigError: A limit was exceeded or a device failed. The caller lifts the sensor.
        """
        known_mm = self._touch_mm.get(press.position)
        if self.touch is None or self.protocol.targets.touch == "taught" or known_mm is None:
            return None
        self.carriage.over(press.x_mm, press.y_mm)
        if self.force is not None:
            self.force.follow_zero()
        return self.touch(press.position, self._down) - known_mm

    @property
    def has_moved(self) -> bool:
        """Whether the sensor met the block at another height than in the approach before at the same position.

        The height is known in approach steps only.
        """
        allowed_mm = max(self.protocol.checks.slip_mm, FREE_STEPS * self.protocol.steps.approach_step_mm)
        return self.free_change_mm is not None and abs(self.free_change_mm) > allowed_mm

    def _to_force(self, press: Press) -> SettledPress:
        force, step = self._gauge, self.protocol.steps.approach_step_mm
        assert press.target_n is not None
        assert press.band_n is not None
        low_n = press.target_n - press.band_n
        slope = Slope(reach_mm=step, min_mm=2.0 * self.protocol.steps.fine_step_mm)
        known_mm = self._free_mm.get(press.position)
        self._start(press)
        free_mm = self.carriage.at[2]
        before, now = 0.0, force.here_n()
        is_known = True
        learned: list[tuple[float, float]] = []
        while now + GROWTH * max(now - before, 0.0) < low_n:
            count, growth_n = 0, 0.0
            if is_known and now >= force.touch_n:
                depth_mm, left_mm = free_mm - self.carriage.at[2], self.carriage.aim_mm - self.carriage.lowest_mm
                count, growth_n = self._growth.safe_steps(now, depth_mm, low_n, max_steps=int(left_mm / step))
            z = self.carriage.to_height(self.carriage.aim_mm - max(count, 1) * step)
            start, now = now, force.glance().mean_n
            before = now - (now - start) / max(count, 1)
            slope.add(z, now)
            if now >= force.touch_n and self._first_touch(press, free_mm - step / 2.0):
                return self._to_force(press)
            if now < force.touch_n:
                self._free_mm[press.position] = free_mm = z
            elif count <= 1:
                learned.append((free_mm - z, now))
            else:
                is_known = growth_n / GROWTH < now - start < GROWTH * growth_n
        self.free_change_mm = None if known_mm is None else free_mm - known_mm
        if self.nominal_mm is not None:
            above = free_mm - self.nominal_mm(press.x_mm, press.y_mm)
            self._above_nominal_mm = max(self._above_nominal_mm, above)
        contact = self._search(press.target_n, press.band_n, slope, now)
        self._learn_safe_depth(free_mm - contact.pose_mm[2], contact.measured)
        for depth_mm, force_n in learned:
            self._growth.add(depth_mm, force_n)
        return contact

    def _search(self, target_n: float, band_n: float, slope: Slope, now_n: float) -> SettledPress:
        """Approach the target in small steps from the end of the coarse approach, and keep the best step.

        Args:
            target_n: The target.
            band_n: Half the width of its band.
            slope: The forces near the present height.
            now_n: The present force, before the last step has settled.
        """
        protocol, carriage, force = self.protocol, self.carriage, self._gauge
        stiffness: float | None = None
        min_step_mm = protocol.steps.fine_step_mm
        best: tuple[float, float] | None = None
        # Far from the band, the force is read without waiting. Only a force that was read after a wait counts.
        is_near = now_n >= target_n - band_n
        for _ in range(protocol.steps.search_steps):
            z = carriage.at[2]
            if is_near:
                read = force.settled()
                if abs(target_n - read.mean_n) <= band_n:
                    return SettledPress(pose_mm=carriage.at, measured=read, in_band=True)
                now_n = read.mean_n
            miss = target_n - now_n
            if best is None or abs(miss) < best[0]:
                best = (abs(miss), z)
            slope.add(z, now_n)
            stiffness = slope.at(z) or stiffness
            needed_mm = abs(miss) / stiffness if stiffness else protocol.steps.approach_step_mm
            is_far = miss > FAR_BANDS * band_n
            if miss > 0.0:
                fraction = FAR_FRACTION if is_far else 1.0
                self._lower(min(max(fraction * needed_mm, min_step_mm), protocol.steps.approach_step_mm))
                # A stage whose own steps are coarser does not move at all. The next step is then longer.
                stands = abs(carriage.at[2] - z) < protocol.steps.fine_step_mm / 2.0
                min_step_mm = 2.0 * min_step_mm if stands else protocol.steps.fine_step_mm
            else:
                self._from_above(z + min(max(needed_mm, min_step_mm), MAX_UP_STEPS * protocol.steps.approach_step_mm))
            if is_far:
                now_n = force.glance().mean_n
            is_near = not is_far or now_n >= target_n - band_n
        assert best is not None
        self._from_above(best[1])
        read = force.settled()
        return SettledPress(pose_mm=carriage.at, measured=read, in_band=abs(target_n - read.mean_n) <= band_n)

    def _to_depth(self, press: Press, depth_mm: float) -> SettledPress:
        assert self.touch is not None
        step = self.protocol.steps.approach_step_mm
        if press.position not in self._touch_mm:
            self._touch_mm[press.position] = self.touch(press.position, self._down)
            self._free_mm[press.position] = self._touch_mm[press.position]
            if self.protocol.targets.touch != "taught":
                self._first_touch(press, self._touch_mm[press.position])
            self.carriage.lift()
        self._start(press)
        end = self._touch_mm[press.position] - depth_mm
        while self.carriage.aim_mm > end:
            self._down(min(step, self.carriage.aim_mm - end))
        contact = self._settled(press, self._touch_mm[press.position])
        self._learn_safe_depth(depth_mm, contact.measured)
        return contact

    def _settled(self, press: Press, touch_mm: float | None) -> SettledPress:
        """Read the force at the present height."""
        read = None if self.force is None else self.force.settled()
        in_band = None
        if read is not None and press.target_n is not None and press.band_n is not None:
            in_band = abs(press.target_n - read.mean_n) <= press.band_n
        return SettledPress(pose_mm=self.carriage.at, measured=read, in_band=in_band, touch_mm=touch_mm)

    def _first_touch(self, press: Press, touch_mm: float) -> bool:
        """Report the first touch of the block; return whether the sensor was lifted meanwhile."""
        if self._was_touched or self.nominal_mm is None:
            return False
        self._was_touched, z = True, self.carriage.at[2]
        self._touched(touch_mm - self.nominal_mm(press.x_mm, press.y_mm))
        return self.carriage.at[2] != z

    def _start(self, press: Press) -> None:
        """Move to the start of the stepwise approach: just above the known or expected height of contact.

        At the first position of a block, nothing is known, so the approach starts at the travel height.

        Raises:
            ContactError: The sensor touches something although it was free at this height before.
        """
        known = self._free_mm.get(press.position)
        if known is not None:
            touched = self._descend(known + MARGIN_STEPS * self.protocol.steps.approach_step_mm)
        elif self.force is not None and self.nominal_mm is not None and self._above_nominal_mm > -math.inf:
            touched = self._descend(self.nominal_mm(press.x_mm, press.y_mm) + self._above_nominal_mm + NEW_MARGIN_MM)
        else:
            return
        if touched is not None and known is not None:
            raise ContactError(
                f"the sensor touches something at z = {touched:.3f} mm, but at this position it was free down to "
                f"{known:.3f} mm before: a motor has slipped or the block has moved; find the cause, then run the "
                "command again"
            )
        if touched is not None:
            # The block differs from its formula. The approach is made in steps from the last free height.
            self.carriage.to_height(touched + self._blind_mm)

    def _descend(self, start_mm: float) -> float | None:
        """Move down through free air, and read the force after each move.

        Returns:
            The height at which the sensor touched something; None if it is free at ``start_mm``.
        """
        carriage = self.carriage
        longest_mm = self._blind_mm if self.force else math.inf
        while start_mm < carriage.aim_mm:
            target = max(start_mm, carriage.aim_mm - longest_mm)
            z = carriage.to_height(target, fast=self.force is not None and target > start_mm + SLOW_MM)
            if self.force is not None and self.force.touches():
                return z
        return None

    def _learn_safe_depth(self, depth_mm: float, measured: Force | None) -> None:
        """Learn from a press how far the sensor may move blindly from a free height."""
        if measured is not None and depth_mm > 0.0 and measured.mean_n > 0.0:
            limit_n = BLIND_FRACTION * self.protocol.limits.hard_limit_n
            further = max(1.0, (limit_n / measured.mean_n) ** (1.0 / BLIND_POWER))
            self._blind_mm = max(self._blind_mm, depth_mm * further)

    def _down(self, by_mm: float) -> float:
        """Move down by at most an approach step, and read the gauge if there is one."""
        z = self.carriage.to_height(self.carriage.aim_mm - min(by_mm, self.protocol.steps.approach_step_mm))
        if self.force is not None:
            self.force.glance()
        return z

    def _lower(self, by_mm: float) -> None:
        self.carriage.to_height(self.carriage.at[2] - by_mm)

    def _from_above(self, z_mm: float) -> None:
        """Lift half an approach step above a height and move down to it."""
        extra = self.protocol.steps.approach_step_mm / 2.0
        self.carriage.to_height(max(z_mm, self.carriage.at[2]) + extra)
        while self.carriage.aim_mm - z_mm > self.protocol.steps.approach_step_mm:
            self._down(self.protocol.steps.approach_step_mm)
        self.carriage.to_height(z_mm)

    @property
    def _gauge(self) -> ContactForce:
        assert self.force is not None, "the study reader refuses force mode without a gauge"
        return self.force
