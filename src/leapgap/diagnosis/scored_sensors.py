"""Which sensors beside the state are compared: those that every log has, the model can simulate, and physics allows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.channels import is_logged
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.model_sensors import FOOT_FORCE, IMU_ACCELERATION, sensor_columns

LEAST_SHARE, MOST_SHARE = 0.5, 2.0
"""Over a log an accelerometer measures gravity on average, and feet bear the weight; within these factors."""


@dataclass(frozen=True)
class ScoredSensors:
    """Columns of sensors that are compared, and why others are not."""

    columns: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot) -> "ScoredSensors":
        """The sensors of some logs."""
        can = sensor_columns(robot)
        columns: list[str] = []
        notes: list[str] = []
        for group, quantity, lack in (
            (IMU_ACCELERATION, "imu_acc", "the model has neither an accelerometer nor a site of an IMU"),
            (tuple(FOOT_FORCE + foot for foot in robot.feet), "foot_force", "the model has no such feet"),
        ):
            if not any(name.startswith(quantity) and is_logged(log, name) for log in logs for name in log.columns):
                continue
            if not group or any(name not in can for name in group):
                notes.append(f"{quantity} ({lack})")
            elif not all(is_logged(log, name) for log in logs for name in group):
                notes.append(f"{quantity} (some log lacks some of {', '.join(group)})")
            else:
                doubt = acceleration_doubt(logs, robot) if group == IMU_ACCELERATION else force_doubt(logs, robot)
                notes += [f"{quantity} ({doubt})"] if doubt else []
                columns += [] if doubt else group
        return ScoredSensors(tuple(columns), tuple(notes))


def acceleration_doubt(logs: Sequence[Log], robot: Robot) -> str | None:
    """Why an accelerometer is none, in words; None where it measures gravity."""
    gravity = float(np.linalg.norm(robot.model.opt.gravity))
    mean = float(np.mean([np.linalg.norm(log.stack(IMU_ACCELERATION), axis=1).mean() for log in logs]))
    if LEAST_SHARE * gravity < mean < MOST_SHARE * gravity:
        return None
    return (
        f"its mean is {mean:.2g} m/s² where gravity alone gives {gravity:.2f}: gravity was removed, or the unit differs"
    )


def force_doubt(logs: Sequence[Log], robot: Robot) -> str | None:
    """Why forces of the feet are none, in words; None where they bear the weight of the robot."""
    weight = robot.total_mass * float(np.linalg.norm(robot.model.opt.gravity))
    names = [FOOT_FORCE + foot for foot in robot.feet]
    borne = float(np.mean([log.stack(names).sum(axis=1).mean() for log in logs])) / weight
    if LEAST_SHARE < borne < MOST_SHARE:
        return None
    return f"the feet bear {borne:.2g} of the robot's weight: the unit is not N, or something else bears it"
