"""Supply voltage sag under load."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, Load, parameter
from leapgap.effects.drive import lacks_torque_limits
from leapgap.robot import actuators
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class SupplySag(Effect):
    """Share of each motor's torque that is lost when all of them give their largest: τ (1 − sag · mean |τ| / τ_max).

    The voltage falls by the sum of the currents, which are as the shares of the model's limits that are asked for, and
    drives that set a duty cycle do not make up for it; those that control a current do until their voltage ends
    (``torque_speed_limit``). A model may state limits far above what the motors ever give together, so that the sag at
    its limits can be above 1; no torque turns round by it. A replay takes the torques from its log's commands and
    motion, a closed loop its own.
    """

    name = "supply_sag"
    by_default = False
    needs_motor = True

    sag: float = parameter(0.0, "1", 0.0, 6.0, 0.2, limits=(0.0, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """The load is a share of the largest torques, which the model states."""
        return super().lacks(robot) or lacks_torque_limits(robot)

    def _parts(self, robot: Robot) -> Iterator[tuple[int, str]]:
        """Joint that a motor drives, and name of the actuator that takes torque away."""
        for i in np.flatnonzero(robot.driven):
            yield int(i), f"{self.name} at {robot.joints[i]}"

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """By what all motors give."""
        driven = at.robot.driven
        load = np.abs(at.torque[:, driven]) / at.robot.torque_limits[driven]
        return at.at_motors(location, -at.torque * load.mean(axis=1, keepdims=True))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add an actuator beside each motor."""
        for joint, part in self._parts(robot):
            actuators.add_push(spec, robot.joints[joint], part)

    def put_controls(self, control: np.ndarray, load: Load, model: mujoco.MjModel, robot: Robot) -> None:
        """Take the share away."""
        if self.is_nominal:
            return
        joints, names = zip(*self._parts(robot), strict=True)
        torque = load.torque[:, list(joints)]
        work = np.mean(np.abs(torque) / robot.torque_limits[list(joints)], axis=1, keepdims=True)
        control[:, actuators.controls_of(model, names)] = -np.minimum(1.0, self.sag * work) * torque
