"""What effects on masses, their places and the weight they have share: the force that inverse dynamics says."""

import copy
from abc import abstractmethod
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, recompute_constants
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class InertialEffect(Effect):
    """An effect that changes numbers of the rigid bodies, or of gravity, in the compiled model."""

    @abstractmethod
    def change_bodies(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Change the numbers; at nominal parameters it is not asked for."""

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Change the numbers, and what MuJoCo derives from them."""
        if not self.is_nominal:
            self.change_bodies(model, robot)
            recompute_constants(model)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Less what the same motion needs of the changed bodies than of the nominal ones."""
        nominal, found = needed(at.model, at), []
        for effect, by in cls.small_departures(at.robot, location):
            model = copy.copy(at.model)
            effect.change_model(model, at.robot)
            found.append((nominal - needed(model, at)) / by)
        return np.array(found)


def needed(model: mujoco.MjModel, at: ForceContext) -> np.ndarray:
    """Generalised force that the motion needs of rigid bodies in gravity, (steps, nv), by inverse dynamics."""
    data, found = mujoco.MjData(model), np.empty(at.qvel.shape)
    for step in range(len(found)):
        data.qpos[:], data.qvel[:], data.qacc[:] = at.qpos[step], at.qvel[step], at.qacc[step]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 1, found[step])
    return found
