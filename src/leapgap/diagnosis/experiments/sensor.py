"""The same motions with a further sensor."""

from dataclasses import dataclass

from leapgap.diagnosis.experiments.base import Experiment, Repetition
from leapgap.diagnosis.experiments.given import Given
from leapgap.logs.log import Log
from leapgap.robot.model_sensors import FOOT_FORCE, IMU_ACCELERATION, sensor_columns


@dataclass(frozen=True)
class FurtherSensor(Experiment):
    """The same motions with a further sensor."""

    name = "sensor"
    cost = 4

    columns: tuple[str, ...]

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """An accelerometer and foot forces, where the model has them and the logs do not."""
        can = sensor_columns(given.robot) if given.robot.has_free_base else ()
        groups = (IMU_ACCELERATION, tuple(FOOT_FORCE + foot for foot in given.robot.feet))
        lacking = [g for g in groups if g and set(g) <= set(can) and not all(c in log for c in g for log in given.logs)]
        return [cls(group) for group in lacking]

    def plans(self, given: Given) -> list[Log]:
        """The logs' own commands from their own starts."""
        return Repetition().plans(given)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns of the sensor that is read besides."""
        return self.columns

    def words(self, given: Given) -> str:
        """What to log, by the name of the sensor."""
        return f"record {self.short.removeprefix('with ')} too"

    @property
    def short(self) -> str:
        """The sensor, in a few words."""
        return "with the accelerometer" if self.columns == IMU_ACCELERATION else "with the forces at the feet"
