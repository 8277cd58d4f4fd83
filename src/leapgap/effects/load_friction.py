"""Load-dependent friction."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import ForceContext, Load, MotorEffect, parameter
from leapgap.robot import actuators
from leapgap.robot.model import Robot

STILL_RAD_S = 0.05
"""Speed below which the friction is viscous; a joint under load that should stand creeps at less than that."""


@dataclass(frozen=True)
class LoadFriction(MotorEffect):
    """Friction −share · |τ| · tanh(q̇ / 0.05 rad/s) of a joint whose motor gives τ, beside the model's own friction.

    A gear of efficiency 1 − share: the motor's torque comes through weaker where it drives the joint and stronger where
    it brakes it. MuJoCo has no friction that follows a load. So a replay takes the torque τ (joint PD and limits
    included) and the velocity from its log, and its own velocity where it matters: about each row's velocity the law
    is a straight line, a torque and a damping that change from row to row. A replay that follows its log is exact; one
    that turns round at other times than the log has the friction of the log's direction there. Logs that are made in
    open loop take both from their plan; a closed loop takes its own at every tick. A joint at rest creeps, as the
    friction fades out with its speed; with explicit integrators it creeps faster where steps are long for the joint.
    """

    name = "load_friction"
    by_default = False

    share: float = parameter(0.0, "1", 0.0, 0.6, 0.1, limits=(0.0, 1.0))

    def _parts(self, robot: Robot) -> Iterator[tuple[int, str, str]]:
        """Joint, and names of its two actuators: a torque and a damper."""
        for i in robot.joints_at(self.location):
            if robot.driven[i]:
                where = f"at {self.location} of {robot.joints[i]}"
                yield int(i), f"{self.name} {where}", f"damping of {self.name} {where}"

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the motion, by the torque."""
        return at.at_motors(location, -np.abs(at.torque) * np.tanh(at.velocity / STILL_RAD_S))

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the torque and the damper of each joint that a motor drives."""
        for joint, push, damper in self._parts(robot):
            actuators.add_brake(spec, robot.joints[joint], push, damper)

    def put_controls(self, control: np.ndarray, load: Load, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the torque and the damping of each joint by its load."""
        if self.is_nominal:
            return
        joints, *names = zip(*self._parts(robot), strict=True)
        at = list(joints)
        push, damper = (actuators.controls_of(model, of) for of in names)
        most = actuators.largest_damping(model, robot.joint_dofs[at], load.step_s)
        friction, speed = self.share * np.abs(load.torque[:, at]), load.velocity[:, at]
        faded = np.tanh(speed / STILL_RAD_S)
        slope = np.minimum(friction / STILL_RAD_S * (1 - faded**2), most)
        control[:, push], control[:, damper] = slope * speed - friction * faded, slope
