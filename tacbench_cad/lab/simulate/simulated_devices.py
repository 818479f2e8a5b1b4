"""A simulated force gauge and a simulated sensor that follow the position that a stage reports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.colours import INSIDE
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.registry import Context, Driver
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.rig.stage import Closing, LimitedStage
from tacbench_cad.lab.simulate.appearances import CLEAN, look_named
from tacbench_cad.lab.simulate.contact import DomeContact, Drag, contact_for
from tacbench_cad.lab.simulate.tactip import SIMULATED, TacTip
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    Point,
    PrintedBlock,
    Seed,
    SensorSettings,
    WorkFrame,
)
from tacbench_cad.util.convert import from_plain
from tacbench_cad.util.errors import InputError

#: The sample rate of the simulated load cell in Hz. Rate and noise are those of an HX711 on a 10 N cell.
GAUGE_RATE_HZ = 80.0
#: The noise (standard deviation) of one sample, in N.
GAUGE_NOISE_N = 0.0005
#: The frame rate of the simulated camera in Hz.
FRAME_RATE_HZ = 30.0


class _Follower(Closing):
    """The common part of both devices: the block under the sensor, and the sensor's pose."""

    def __init__(self, position: Callable[[], Point], clock: Clock, seed: int | None) -> None:
        self._position = position
        self._clock = clock
        self._rng = np.random.Generator(np.random.SFC64(seed))
        self._contact: DomeContact | None = None
        self._frame: WorkFrame | None = None

    def put(self, printed: PrintedBlock, holder: HolderRim, frame: WorkFrame) -> None:
        """Replace the block under the sensor.

        Args:
            printed: The block, printed by its virtual printer.
            holder: The rim of the holder.
            frame: The work frame of the block on the stage.
        """
        self.lay(contact_for(printed, holder), frame)

    def lay(self, contact: DomeContact, frame: WorkFrame) -> None:
        """Replace the surface under the sensor."""
        self._contact, self._frame = contact, frame

    def _pose(self) -> Point:
        """Return the summit's reported position in the work frame."""
        return self._position() if self._frame is None else self._frame.to_work(self._position())


class SimulatedGauge(_Follower):
    """A force gauge; see :class:`tacbench_cad.lab.rig.gauge.Gauge`.

    Args:
        position: Returns the stage's reported position in its own frame.
        clock: The rig's time.
        seed: The seed of the noise; None for a random one.
        noise_n: The standard deviation of a sample.
    """

    def __init__(
        self,
        position: Callable[[], Point],
        clock: Clock,
        *,
        seed: int | None = None,
        noise_n: float = GAUGE_NOISE_N,
    ) -> None:
        super().__init__(position, clock, seed)
        self._noise_n = noise_n
        self.identity = "simulated load cell"
        self.simulated = "simulated load cell"
        self.calibration: dict[str, object] = {}
        self._zero_n = 0.0

    def read(self, window_s: float) -> Force:
        """Return the contact force at the reported position, averaged over the noisy samples of the window."""
        samples = max(1, round(window_s * GAUGE_RATE_HZ))
        self._clock.sleep(samples / GAUGE_RATE_HZ)
        true_n = 0.0 if self._contact is None else self._contact.force_n(*self._pose())
        values = true_n - self._zero_n + self._noise_n * self._rng.standard_normal(samples)
        return Force(mean_n=float(np.mean(values)), spread_n=float(np.std(values)), samples=samples)

    def tare(self) -> None:
        """Take the present force as zero."""
        self._zero_n += self.read(1.0).mean_n


@dataclass(frozen=True, kw_only=True)
class _SensorOptions:
    colour: bool = False
    look: str = CLEAN.name
    flicker: Annotated[float, Interval(ge=0.0, le=1.0)] | None = None
    seed: Seed | None = None


class SimulatedSensor(_Follower):
    """A TacTip; see :class:`tacbench_cad.lab.rig.sensor.Sensor`.

    Args:
        position: Returns the stage's reported position in its own frame.
        clock: The rig's time.
        in_motion: Returns whether the stage moves the sensor in contact. The friction then drags the pins along.
        options: ``colour`` (default false: grey images), ``look`` (a name of
            :data:`~tacbench_cad.lab.simulate.appearances.LOOKS`, default ``clean``), ``flicker`` (a fraction; default:
            the look's own) and ``seed`` of the noise (default: a random one).

    Raises:
        InputError: An option is unknown or not allowed.
    """

    def __init__(
        self,
        position: Callable[[], Point],
        clock: Clock,
        options: Mapping[str, Any] | None = None,
        *,
        in_motion: Callable[[], bool] = lambda: False,
    ) -> None:
        chosen = from_plain(_SensorOptions, dict(options or {}), "[sensor] ")
        super().__init__(position, clock, chosen.seed)
        self._tactip = TacTip(colour=chosen.colour, flicker=chosen.flicker, look=look_named(chosen.look))
        self._began_s = clock.now_s()
        self._in_motion, self._drag = in_motion, Drag()
        self._approached: tuple[DomeContact | None, Point] | None = None
        #: The state of the generator before the errors of the last approach were drawn.
        self._before_approach = self._rng.bit_generator.state
        #: See :class:`tacbench_cad.lab.rig.sensor.Sensor`.
        self.frame_age_s = 0.0
        self._pins = self._tactip.rest
        self.name = SIMULATED
        self.units, self.channels = "counts", INSIDE
        self.shape = self._tactip.shape
        self.simulated = SIMULATED
        self.settings: dict[str, Any] = {"requested": dict(options or {}), "actual": self._tactip.as_dict()}

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw all further noise from another random generator."""
        self._rng, self._before_approach = rng, rng.bit_generator.state

    def read(self) -> Frame:
        """Return an image at the reported position, one frame later."""
        return self.grab()()

    def grab(self) -> Callable[[], Frame]:
        """Take the pose for an image; see :class:`tacbench_cad.lab.rig.sensor.Sensor`."""
        self._clock.sleep(1.0 / FRAME_RATE_HZ)
        pose, is_moving = self._pose(), self._in_motion()
        frame_time_s = self._clock.now_s()
        if not is_moving:
            self._drag = Drag()
        contact = self._contact
        lag_mm = self._drag.move(pose, 0.0 if contact is None else contact.force_n(*pose))
        approach = contact, pose

        def frame() -> Frame:
            # The error of an approach stays the same until the stage moves to another place.
            if self._approached != approach:
                rng = self._rng
                if is_moving:
                    rng = np.random.Generator(np.random.SFC64())
                    rng.bit_generator.state = self._before_approach
                else:
                    self._before_approach = rng.bit_generator.state
                self._approached, self._pins = approach, self._tactip.approach(contact, pose, rng, lag_mm)
            return self._tactip.frame(self._pins, self._rng, frame_time_s - self._began_s)

        return frame


def _followed(context: Context, table: str) -> LimitedStage:
    """Return the stage that a device follows."""
    if not isinstance(context.stage, LimitedStage):
        raise InputError(f"[{table}] driver", "simulated", "follows the stage of a rig, and cannot be opened alone")
    return context.stage


def _open_gauge(settings: GaugeSettings, context: Context) -> SimulatedGauge:
    return SimulatedGauge(_followed(context, "gauge").followed_mm, context.clock)


def _open_sensor(settings: SensorSettings, context: Context) -> SimulatedSensor:
    stage = _followed(context, "sensor")
    return SimulatedSensor(
        stage.followed_mm, context.clock, settings.options, in_motion=lambda: stage.moving_mm is not None
    )


#: The drivers ``simulated`` of a gauge and of a sensor.
GAUGE = Driver(open=_open_gauge, summary="simulated load cell, which follows the stage", simulated=True)
SENSOR = Driver(open=_open_sensor, summary="simulated TacTip, which follows the stage", simulated=True)
