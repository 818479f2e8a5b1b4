"""A simulated force gauge and a simulated sensor that follow the position which a stage reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.simulate.contact import DomeContact, contact_for
from tacbench_cad.lab.simulate.looks import CLEAN, look_named
from tacbench_cad.lab.simulate.tactip import SIMULATED, TacTip
from tacbench_cad.lab.study.spec import HolderRim, Point, PrintedBlock, WorkFrame
from tacbench_cad.util.convert import Bounds, from_plain

#: Samples a second of the simulated load cell, and the noise of one of them in newtons: an HX711 on a 10 N cell.
GAUGE_RATE_HZ = 80.0
#: Noise of one of its samples, in newtons.
GAUGE_NOISE_N = 0.0005
#: Frames a second of the simulated camera.
FRAME_RATE_HZ = 30.0


class _Follower(Closing):
    """What both devices share: the ground under the sensor, and where the sensor is."""

    def __init__(self, position: Callable[[], Point], clock: Clock, seed: int | None) -> None:
        self._position = position
        self._clock = clock
        self._rng = np.random.Generator(np.random.SFC64(seed))
        self._contact: DomeContact | None = None
        self._frame: WorkFrame | None = None

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Another block lies under the sensor now.

        Args:
            printed: The block, which its virtual printer makes.
            holder: What surrounds it.
            frame: Where it lies on the stage.
        """
        self._contact, self._frame = contact_for(printed, holder), frame

    def _pose(self) -> Point:
        """Where the stage says the summit is, in the work frame."""
        point = self._position()
        return point if self._frame is None else self._frame.to_work(point)


class SimulatedGauge(_Follower):
    """A force gauge; see :class:`tacbench_cad.lab.rig.gauge.Gauge`.

    Args:
        position: Where the stage says it is, in its own frame.
        clock: The rig's time.
        seed: Seed of the noise; None for another one each time.
    """

    def __init__(self, position: Callable[[], Point], clock: Clock, *, seed: int | None = None) -> None:
        super().__init__(position, clock, seed)
        self.identity = "simulated load cell"
        self.simulated = "simulated load cell"
        self.calibration: dict[str, object] = {}
        self._zero_n = 0.0

    def read(self, window_s: float) -> Force:
        """The contact force at the reported position, with the noise of as many samples as the window holds."""
        samples = max(1, round(window_s * GAUGE_RATE_HZ))
        self._clock.sleep(samples / GAUGE_RATE_HZ)
        true_n = 0.0 if self._contact is None else self._contact.force_n(*self._pose())
        values = true_n - self._zero_n + GAUGE_NOISE_N * self._rng.standard_normal(samples)
        return Force(mean_n=float(np.mean(values)), spread_n=float(np.std(values)), samples=samples)

    def tare(self) -> None:
        """Take the present force as zero."""
        self._zero_n += self.read(1.0).mean_n


@dataclass(frozen=True, kw_only=True)
class _SensorOptions:
    colour: bool = False
    look: str = CLEAN.name
    flicker: Annotated[float, Bounds(0.0, 1.0)] | None = None
    seed: Annotated[int, Bounds(0, 2**32 - 1)] | None = None


class SimulatedSensor(_Follower):
    """A TacTip; see :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        position: Where the stage says it is, in its own frame.
        clock: The rig's time.
        options: ``colour`` (false by default: grey images), ``look`` (a name of
            :data:`~tacbench_cad.lab.simulate.looks.LOOKS`, ``clean`` by default), ``flicker`` (fraction; the look's own
            by default) and ``seed`` of the noise (another one each time by default).

    Raises:
        InputError: An option is unknown or not allowed.
    """

    def __init__(self, position: Callable[[], Point], clock: Clock, options: Mapping[str, Any] | None = None) -> None:
        chosen = from_plain(_SensorOptions, dict(options or {}), "[sensor] ")
        super().__init__(position, clock, chosen.seed)
        self._tactip = TacTip(colour=chosen.colour, flicker=chosen.flicker, look=look_named(chosen.look))
        self._began_s = clock.now_s()
        self._approached: tuple[DomeContact | None, Point] | None = None
        self._pins = self._tactip.rest
        self.name = SIMULATED
        self.units = "counts"
        self.shape = self._tactip.shape
        self.simulated = SIMULATED
        self.settings: dict[str, Any] = {"requested": dict(options or {}), "actual": self._tactip.as_dict()}

    def read(self) -> Frame:
        """An image at the reported position, one frame later."""
        self._clock.sleep(1.0 / FRAME_RATE_HZ)
        pose = self._pose()
        # The errors of an approach last until the stage has moved.
        if self._approached != (self._contact, pose):
            self._approached = self._contact, pose
            self._pins = self._tactip.approach(self._contact, pose, self._rng)
        return self._tactip.frame(self._pins, self._rng, self._clock.now_s() - self._began_s)
