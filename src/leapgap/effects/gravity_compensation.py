"""Gravity compensation missing from the log."""

from dataclasses import dataclass
from math import inf

import mujoco
import numpy as np

from leapgap.effects.base import ForceContext, MotorEffect, Parameter, addition, parameter
from leapgap.effects.links import jacobians, links_at
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of

LEAST = 1e-12
"""MuJoCo compiles a compensation only where some body has one."""


@dataclass(frozen=True)
class GravityCompensation(MotorEffect):
    """Share of the weight of the links that the located joints move that the drive compensates, at all joints.

    MuJoCo's ``gravcomp``: the drive adds the torque that holds these weights, by the model, to what it is told, and its
    limit is that of the sum. It is added to what the model states, and may take that away. Links beyond a passive
    joint are not compensated.
    """

    name = "gravity_compensation"
    by_default = False

    share: float = parameter(0.0, "1", 0.0, 1.2, 0.2, limits=(-inf, inf))

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """Drives know the direction of gravity where the base is held."""
        if robot.has_free_base:
            return "a base that is held"
        if not np.any(gravity_of(robot.model)):
            return "gravity"
        return super().lacks(robot) or (None if len(carried(robot, "all")) else "links that motors alone hold")

    @classmethod
    def parameters(cls, robot: Robot, location: str = "all") -> tuple[Parameter, ...]:
        """From no compensation at all upwards."""
        (declared,) = super().parameters(robot, location)
        return (addition(declared, robot.model.body_gravcomp[carried(robot, location)]),)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """What holds the weight of the links, where the motors are within their limits with it."""
        bodies = carried(at.robot, location).tolist()
        weights = at.model.body_mass[bodies, None] * gravity_of(at.model)
        held = -np.einsum("bi,sbij->sj", weights, jacobians(at, bodies))
        return at.at_motors("all", held[:, at.robot.joint_dofs] * at.within)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Let the links have a compensation, and the motors' limits hold for what they carry besides."""
        for body in carried(robot, self.location).tolist():
            spec.bodies[body].gravcomp = spec.bodies[body].gravcomp or LEAST
        motors = {motor.joint: motor for motor in robot.actuators if motor.driven}
        for joint in spec.joints:
            if joint.name in motors and not joint.actgravcomp:
                joint.actgravcomp = True
                if np.isfinite(limit := motors[joint.name].limit).any():
                    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
                    joint.actfrcrange = np.clip(limit, -mujoco.mjMAXVAL, mujoco.mjMAXVAL)
        for actuator in spec.actuators:
            if actuator.target in motors:
                actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Add to the shares that the model has."""
        if not self.is_nominal:
            model.body_gravcomp[carried(robot, self.location)] += self.share


def carried(robot: Robot, location: str) -> np.ndarray:
    """Bodies of the links at a location that motors alone move, and what is fixed to them."""
    passive = set(robot.joint_bodies[~robot.driven].tolist())
    held: list[bool] = []
    for body, parent in enumerate(robot.model.body_parentid.tolist()):
        held.append(body not in passive and (body == 0 or held[parent]))
    moved = np.isin(robot.model.body_weldid, links_at(robot, location))
    return np.flatnonzero(moved & held)
