"""The motion after a press: a slide, a roll or a tilt, while other threads read frames and forces.

The frames come as fast as the sensor delivers them. Of these, the frames nearest to equally spaced places on the line,
or nearest to equally spaced angles, are kept. The force guard is active until the sensor stands still: a force above
the hard limit stops the stage.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from types import TracebackType
from typing import Generic, Self, TypeVar

import numpy as np

from tacbench_cad.lab.acquire import Carriage, ContactForce
from tacbench_cad.lab.rig import Clock, Frame, RigError, Sensor, StageTrack, TooFewFramesError, TurnTrack, tracked
from tacbench_cad.lab.runs import MovingFrame
from tacbench_cad.lab.study import Press, Protocol, in_stage, in_work_frame, turn_of

#: The largest number of frames in memory, as a multiple of the number of frames to keep. Beyond it, every second frame
#: is dropped.
SPARE_FRAMES = 4
#: The time after which a stage that a thread has stopped is stopped again, in s of real time, in case it had not begun
#: to move at the first time.
STOP_AGAIN_S = 2.0

T = TypeVar("T")


class Recorder(Generic[T]):
    """Reads a device again and again in a thread, from before the body of the ``with`` statement until after it.

    Args:
        read: Reads the device, and returns the value and the time of its measurement on the rig's clock.
        failed: Called when reading fails, and then at intervals until the body is left.
        max_values: The largest number of values in memory.
        is_early: Returns whether the motion has not begun yet. Until then, only the two newest values are kept.

    Attributes:
        times_s: The times of the values.
        values: The values.
    """

    def __init__(
        self,
        read: Callable[[], tuple[float, T]],
        failed: Callable[[], None],
        max_values: int,
        is_early: Callable[[], bool] = lambda: False,
    ) -> None:
        self._read, self._failed, self._max_values, self._is_early = read, failed, max_values, is_early
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._begun, self._ending = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._stride = 1
        self.times_s: list[float] = []
        self.values: list[T] = []

    def __enter__(self) -> Self:
        self._thread.start()
        self._begun.wait()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ending.set()
        self._thread.join()

    def check(self) -> None:
        """Raise the error of the thread, if there was one."""
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        count = 0
        try:
            while True:
                is_last, is_early = self._ending.is_set(), self._is_early()
                time_s, value = self._read()
                if is_early:
                    count = 0
                    # The motion may begin during this reading, so the one before it is kept as well.
                    del self.times_s[:-1], self.values[:-1]
                # The last value was measured after the body, so it is always kept.
                if count % self._stride == 0 or is_last:
                    self.times_s.append(time_s)
                    self.values.append(value)
                count += 1
                if len(self.values) > self._max_values:
                    del self.times_s[1::2], self.values[1::2]
                    self._stride *= 2
                self._begun.set()
                if is_last:
                    return
        except BaseException as error:
            self._error = error
            self._begun.set()
            self._failed()
            while not self._ending.wait(STOP_AGAIN_S):
                self._failed()


class ContactMotion:
    """Makes the motion of a protocol after each press. See :func:`tacbench_cad.lab.acquire.after_touch.motion_of`.

    Args:
        protocol: The protocol.
        carriage: Moves the sensor.
        force: Reads the force; None on a rig without a gauge.
        sensor: The sensor.
        read: Reads a frame of the sensor and checks it.
        clock: The rig's time.
    """

    def __init__(
        self,
        protocol: Protocol,
        carriage: Carriage,
        force: ContactForce | None,
        sensor: Sensor,
        read: Callable[[], Frame],
        clock: Clock,
    ) -> None:
        self.protocol, self.carriage, self.force, self.clock = protocol, carriage, force, clock
        self._sensor, self._read = sensor, read

    def after_touch(self, press: Press) -> list[MovingFrame]:
        """Make the motion from the place of a press, where the sensor is in contact. The sensor stays at the end.

        Returns:
            The frames of the series.

        Raises:
            ForceLimitError: The force was above the hard limit. The stage was stopped.
            TooFewFramesError: Two places of the motion have the same nearest frame.
            RigError: A device failed.
            RunInterruptedError: A signal came.
        """
        protocol, carriage, count = self.protocol, self.carriage, self.protocol.series_frames
        track, start = self._turn() if protocol.is_turning else self._slide(press)
        most = SPARE_FRAMES * count
        frames = Recorder(self._frame, carriage.halt, most, track.is_early)
        recorders: list[Recorder[Callable[[], Frame]] | Recorder[float]] = [frames]
        forces = None if self.force is None else Recorder(self._net_force, carriage.halt, most, track.is_early)
        if forces is not None:
            recorders.append(forces)

        def check() -> None:
            for recorder in recorders:
                recorder.check()

        with tracked(carriage.stage, track), ExitStack() as recording:
            for recorder in recorders:
                recording.enter_context(recorder)
            try:
                start(check)
            except RigError:
                # If a thread has stopped the stage, its error is the cause.
                check()
                raise
        check()
        chosen = nearest_frames(track, np.array(frames.times_s), count)
        times = np.array([frames.times_s[index] for index in chosen])
        net = [None] * count if forces is None else np.interp(times, forces.times_s, forces.values).tolist()
        return [
            MovingFrame(
                frame=frames.values[index](),
                time_s=time_s,
                pose_mm=carriage.frame.to_work(point),
                pose_from="reports" if track.is_reported else "time",
                rotation_deg=in_work_frame(carriage.frame, angles),
                force_n=force_n,
            )
            for index, time_s, (point, angles), force_n in zip(
                chosen, times.tolist(), track.poses(times), net, strict=True
            )
        ]

    def _slide(self, press: Press) -> tuple[StageTrack, Callable[[Callable[[], None]], None]]:
        """Return the track of a slide, and the function that slides."""
        carriage, (dx, dy), speed_mm_s = self.carriage, self.protocol.slide_mm, self.protocol.slide_speed_mm_s
        end, work = (press.x_mm + dx, press.y_mm + dy, carriage.aim_mm), carriage.frame
        track = StageTrack(work.to_stage(carriage.at), work.to_stage(end), speed_mm_s, self.clock)
        return track, partial(carriage.slide, end, speed_mm_s, track)

    def _turn(self) -> tuple[StageTrack, Callable[[Callable[[], None]], None]]:
        """Return the track of a roll or a tilt, and the function that turns."""
        carriage, protocol = self.carriage, self.protocol
        turn = turn_of(protocol, carriage.at, carriage.angles_deg)
        track = TurnTrack(in_stage(carriage.frame, turn), protocol.turn_speed_deg_s, self.clock)
        return track, partial(carriage.turn, turn, track)

    def _frame(self) -> tuple[float, Callable[[], Frame]]:
        begun_s = self.clock.now_s()
        self.carriage.check()
        grab = getattr(self._sensor, "grab", None)
        later: Callable[[], Frame] = partial(_same, self._read()) if grab is None else grab()
        ended_s, age_s = self.clock.now_s(), getattr(self._sensor, "frame_age_s", None)
        # A driver that does not know the time of exposure has waited for it in the meantime.
        return ((begun_s + ended_s) / 2.0 if age_s is None else ended_s - age_s * self.clock.speed, later)

    def _net_force(self) -> tuple[float, float]:
        assert self.force is not None
        begun_s = self.clock.now_s()
        force_n = self.force.moving_n()
        return (begun_s + self.clock.now_s()) / 2.0, force_n


def _same(frame: Frame) -> Frame:
    return frame


def nearest_frames(track: StageTrack, times_s: np.ndarray, count: int) -> Sequence[int]:
    """Return the numbers of the frames nearest to equally spaced places of a motion, from its start to its end.

    Of frames at the same place, where the sensor stands before and after the motion, the one nearest to the motion is
    taken.

    Args:
        track: The motion.
        times_s: The increasing times of the frames.
        count: The number of places.

    Raises:
        TooFewFramesError: Two places have the same nearest frame.
    """
    distances = np.linalg.norm(track.at_mm(times_s) - np.array(track.start_mm), axis=1)
    chosen: list[int] = []
    for place in np.linspace(0.0, track.length_mm, count):
        errors = np.abs(distances - place)
        near = np.flatnonzero(errors <= errors.min() + 1e-9)
        chosen.append(int(near[-1] if place == 0.0 else near[0]))
    if any(b <= a for a, b in itertools.pairwise(chosen)):
        moving = int(np.count_nonzero((distances > 0.0) & (distances < track.length_mm)))
        if isinstance(track, TurnTrack):
            motion, speed = f"a turn by {track.length_mm:g} degrees", "turn_speed_deg_s"
        else:
            motion, speed = f"a slide of {track.length_mm:g} mm", "slide_speed_mm_s"
        raise TooFewFramesError(
            f"the sensor delivered {moving} frames during {motion}, too few for motion_frames = {count} at equal "
            f"distances; lower {speed} or motion_frames"
        )
    return chosen
