"""Ground slope."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, parameter, recompute_constants
from leapgap.effects.contact import ground_under
from leapgap.effects.frame_tilt import FrameTilt
from leapgap.effects.gravity_direction import GravityDirection
from leapgap.robot.model import Robot
from leapgap.robot.terrain import ground_bodies


@dataclass(frozen=True)
class GroundSlope(Effect):
    """The ground, with what stands on it, turned about the world's y axis through its origin; gravity stays vertical.

    Positive as a nose-down pitch: the ground falls away forward, x > 0.
    """

    name = "ground_slope"

    pitch_rad: float = parameter(0.0, "rad", -0.15, 0.15, 0.03)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A robot that is held needs ground in its model; one that floats may stand on the boxes of a log alone."""
        model = robot.model
        bodies = model.geom_bodyid.tolist()
        grounded = any(ground_under(model, geom) is not None for geom, body in enumerate(bodies) if body)
        return super().lacks(robot) or (None if robot.has_free_base or grounded else "ground")

    def on_model_ground(self) -> tuple[Effect, ...]:
        """A measuring frame that is turned as the ground is, and gravity that is turned back."""
        return FrameTilt(pitch_rad=self.pitch_rad), GravityDirection(pitch_rad=-self.pitch_rad)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Turn all geoms of the world, and the other bodies of the ground as a whole."""
        if self.is_nominal:
            return
        turn = np.array([np.cos(self.pitch_rad / 2), 0.0, np.sin(self.pitch_rad / 2), 0.0])
        roots = [body for body in ground_bodies(model)[1:] if model.body_parentid[body] == 0]
        of_world = np.flatnonzero(model.geom_bodyid == 0)
        for positions, turns, at in (
            *((model.geom_pos, model.geom_quat, geom) for geom in of_world),
            *((model.body_pos, model.body_quat, body) for body in roots),
        ):
            position, quaternion = np.empty(3), np.empty(4)
            mujoco.mju_rotVecQuat(position, positions[at], turn)
            mujoco.mju_mulQuat(quaternion, turn, turns[at])
            positions[at], turns[at] = position, quaternion
        model.geom_sameframe[of_world] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        recompute_constants(model)
