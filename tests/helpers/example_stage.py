"""A stage of your own in 20 lines. This example only remembers its position; yours calls your robot arm's library."""

from tacbench_cad.lab.rig.errors import PositionLostError
from tacbench_cad.lab.rig.stage import Closing


class ExampleStage(Closing):
    def __init__(self, port: str = "", start_mm: tuple[float, float, float] = (0.0, 0.0, 50.0)) -> None:
        self.identity = f"example arm 1.0 at {port}"
        self.simulated = "stage (example)"  # an empty text for a real stage
        self._at = tuple(start_mm)
        self._stopped = False

    def home(self) -> None:
        self._at, self._stopped = (0.0, 0.0, 50.0), False

    def move(self, target_mm, speed_mm_s):
        if self._stopped:
            raise PositionLostError("example arm: was stopped; home first")
        self._at = tuple(target_mm)  # arm.move_to(*target_mm, speed_mm_s); arm.wait(timeout=10.0)
        return self.position()

    def position(self):
        return self._at

    def stop(self) -> None:
        self._stopped = True  # arm.stop(): may be called in the middle of move, and never raises
