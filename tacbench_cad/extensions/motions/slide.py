"""A slide after a press: the sensor moves in contact along a straight line, while other threads read frames and forces.

The frames come as fast as the sensor delivers them. Of these, the frames nearest to equally spaced places on the line
are kept. The force guard is active until the sensor stands still: a force above the hard limit stops the stage.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Annotated, Any, Generic, Self, TypeVar

import numpy as np
from annotated_types import Interval

from tacbench_cad.extensions.motions.track import StageTrack, tracked
from tacbench_cad.lab.acquire import Carriage, ContactForce
from tacbench_cad.lab.rig import Clock, Frame, LimitedStage, RigError, Sensor
from tacbench_cad.lab.runs import MovingFrame
from tacbench_cad.util.convert import Checked

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


@dataclass(frozen=True, kw_only=True)
class Slide(Checked):
    """The keys of a slide in ``[protocol.motion]``. See :class:`tacbench_cad.lab.study.motion.Motion`.

    Args:
        length_mm: The length of the line.
        direction_deg: Its direction in the block frame, counter-clockwise from the x axis.
        speed_mm_s: The speed.
    """

    length_mm: Annotated[float, Interval(ge=0.01, le=1000.0)] = 5.0
    direction_deg: Annotated[float, Interval(ge=-360.0, le=360.0)] = 90.0
    speed_mm_s: Annotated[float, Interval(ge=0.001, le=1000.0)] = 5.0

    @property
    def seconds(self) -> float:
        """The duration."""
        return self.length_mm / self.speed_mm_s

    def shift_mm(self, fraction: float) -> tuple[float, float]:
        """Return x and y of the sensor relative to the start, after a fraction of the slide."""
        angle, length_mm = math.radians(self.direction_deg), fraction * self.length_mm
        return (length_mm * math.cos(angle), length_mm * math.sin(angle))

    def recorder(self, frames: int, **devices: Any) -> SlideRecorder:
        """Return what slides on a rig."""
        return SlideRecorder(self, frames, **devices)


class SlideRecorder:
    """Slides after each press. See :class:`tacbench_cad.lab.study.motion.Motion`.

    Args:
        slide: The slide.
        frames: The number of frames of a series.
        carriage: Moves the sensor.
        force: Reads the force; None on a rig without a gauge.
        sensor: The sensor.
        read: Reads a frame of the sensor and checks it.
        clock: The rig's time.
    """

    def __init__(
        self,
        slide: Slide,
        frames: int,
        *,
        carriage: Carriage,
        force: ContactForce | None,
        sensor: Sensor,
        read: Callable[[], Frame],
        clock: Clock,
    ) -> None:
        self.slide, self.carriage, self.force, self.clock = slide, carriage, force, clock
        self._frames, self._sensor, self._read = frames, sensor, read

    def __call__(self) -> list[MovingFrame] | str:
        """Slide from the place of a press, where the sensor is in contact. The sensor stays at the end.

        Returns:
            The frames of the series, or the reason why the press must be made again.

        Raises:
            ForceLimitError: The force was above the hard limit. The stage was stopped.
            RigError: A device failed.
            RunInterruptedError: A signal came.
        """
        carriage, work, count = self.carriage, self.carriage.frame, self._frames
        if not self.clock.waits:
            return self._step_by_step()
        (x, y, _), (dx, dy), speed_mm_s = carriage.at, self.slide.shift_mm(1.0), self.slide.speed_mm_s
        end = (x + dx, y + dy, carriage.aim_mm)
        track = StageTrack(work.to_stage(carriage.at), work.to_stage(end), speed_mm_s, self.clock)
        most = SPARE_FRAMES * count
        frames = Recorder(self._frame, carriage.halt, most, track.is_early)
        recorders: list[Recorder[Callable[[], Frame]] | Recorder[float]] = [frames]
        forces = None if self.force is None else Recorder(self._net_force, carriage.halt, most, track.is_early)
        if forces is not None:
            recorders.append(forces)

        def check() -> None:
            for recorder in recorders:
                recorder.check()

        def begin() -> None:
            check()
            track.begin()

        with tracked(carriage.stage, track), ExitStack() as recording:
            for recorder in recorders:
                recording.enter_context(recorder)
            try:
                carriage.slide(end, speed_mm_s, begin)
                track.end()
            except RigError:
                # If a thread has stopped the stage, its error is the cause.
                check()
                raise
        check()
        chosen = nearest_frames(track, np.array(frames.times_s), count)
        if isinstance(chosen, str):
            return chosen
        times = np.array([frames.times_s[index] for index in chosen])
        net = [None] * count if forces is None else np.interp(times, forces.times_s, forces.values).tolist()
        return [
            MovingFrame(
                frame=frames.values[index](),
                time_s=time_s,
                pose_mm=work.to_work((x, y, z)),
                pose_from="reports" if track.is_reported else "time",
                force_n=force_n,
            )
            for index, time_s, (x, y, z), force_n in zip(
                chosen, times.tolist(), track.at_mm(times).tolist(), net, strict=True
            )
        ]

    def _step_by_step(self) -> list[MovingFrame]:
        """Stop at the place of each frame. On a clock that never waits, nothing happens during a motion."""
        carriage, stage, force = self.carriage, self.carriage.stage, self.force
        (x, y, _), z = carriage.at, carriage.aim_mm
        frames = []
        assert isinstance(stage, LimitedStage)
        stage.moving_mm = stage.position
        try:
            for fraction in np.linspace(0.0, 1.0, self._frames).tolist():
                dx, dy = self.slide.shift_mm(fraction)
                carriage.slide((x + dx, y + dy, z), self.slide.speed_mm_s, lambda: None)
                frames.append(
                    MovingFrame(
                        frame=self._read(),
                        time_s=fraction * self.slide.seconds,
                        pose_mm=carriage.at,
                        pose_from="time",
                        force_n=None if force is None else force.moving_n(),
                    )
                )
        finally:
            stage.moving_mm = None
        return frames

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


def nearest_frames(track: StageTrack, times_s: np.ndarray, count: int) -> Sequence[int] | str:
    """Return the numbers of the frames nearest to equally spaced places of a slide, from its start to its end.

    Of frames at the same place, where the sensor stands before and after the slide, the one nearest to the slide is
    taken.

    Args:
        track: The slide.
        times_s: The increasing times of the frames.
        count: The number of places.

    Returns:
        The numbers, or a message if two places have the same nearest frame.
    """
    distances = np.linalg.norm(track.at_mm(times_s) - np.array(track.start_mm), axis=1)
    chosen: list[int] = []
    for place in np.linspace(0.0, track.length_mm, count):
        errors = np.abs(distances - place)
        near = np.flatnonzero(errors <= errors.min() + 1e-9)
        chosen.append(int(near[-1] if place == 0.0 else near[0]))
    if all(b > a for a, b in itertools.pairwise(chosen)):
        return chosen
    moving = int(np.count_nonzero((distances > 0.0) & (distances < track.length_mm)))
    return (
        f"the sensor delivered {moving} frames during a slide of {track.length_mm:g} mm, too few for frames = {count} "
        "at equal distances; lower speed_mm_s or frames of [protocol.motion]"
    )
