"""A robot's own numbers: the units in which the sizes of effects are drawn for robots of any size."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Parameter
from leapgap.errors import InputError
from leapgap.robot.model import Robot

GRAVITY = 9.81


@dataclass(frozen=True)
class OwnNumbers:
    """Numbers of one robot in the pose that its motions start from."""

    torque: np.ndarray
    """Largest torque of the motor of each joint, N·m, (joints,)."""
    inertia: np.ndarray
    """Inertia that each motor turns where no other joint moves, its armature included, kg·m², (joints,)."""
    mass: float
    """Of the whole robot, kg."""
    length: float
    """Height of a free base above the ground, or how far the links of a held robot are from its base, m."""
    period: float
    """Time between two commands of its motions, s."""

    @staticmethod
    def of(robot: Robot, state: np.ndarray, period_s: float) -> "OwnNumbers":
        """Those of a robot in a state (nq + nv,); ``InputError`` where its model states no limit of a motor."""
        if not np.isfinite(robot.torque_limits).all():
            without = [j for j, t in zip(robot.joints, robot.torque_limits, strict=True) if not np.isfinite(t)]
            expected = "a limit of the torque of every motor, of which sizes are shares"
            raise InputError(robot.path, f"no limit at {', '.join(without)}", expected, "state them in the model file")
        model, data = robot.model, mujoco.MjData(robot.model)
        data.qpos[:] = state[: model.nq]
        mujoco.mj_forward(model, data)
        whole = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, whole)
        arms = data.xipos[list(robot.bodies)] - data.xpos[robot.bodies[0]]
        height = float(data.xpos[robot.base_body, 2]) - robot.ground_height
        length = height if robot.has_free_base else float(np.linalg.norm(arms, axis=1).max())
        inertia = whole.diagonal()[robot.joint_dofs]
        return OwnNumbers(robot.torque_limits, inertia, robot.total_mass, length, period_s)

    def unit(self, p: Parameter, joints: np.ndarray) -> float:
        """The own number that a parameter of an effect at these joints is a share of, in the unit of the parameter.

        The weakest motor and the least inertia count, so that one value suits all joints. Where the model has a value
        of its own of a mass, a time or a factor, it is that; 1 for angles and factors.
        """
        torque, own = float(self.torque[joints].min()), None if p.scale in (0.0, 1.0) else p.scale
        by_unit = {
            "N·m": torque,
            "N·m/rad": torque,
            "N·m·s/rad": torque,
            "kg·m²": float(self.inertia[joints].min()),
            "kg": own or self.mass,
            "m": self.length,
            "s": own or self.period,
            "N": self.mass * GRAVITY,
            "N/m": self.mass * GRAVITY / self.length,
        }
        return by_unit.get(p.unit, own or 1.0)
