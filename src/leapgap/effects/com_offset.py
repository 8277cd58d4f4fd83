"""Centre-of-mass offset of the trunk."""

from dataclasses import dataclass

import mujoco

from leapgap.effects.base import parameter, recompute_constants
from leapgap.effects.inertial_effect import InertialEffect
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class ComOffset(InertialEffect):
    """Shift of the base body's centre of mass along its own axes: forward and up."""

    name = "com_offset"
    needs_base = True

    x_m: float = parameter(0.0, "m", -0.1, 0.1, 0.03)
    z_m: float = parameter(0.0, "m", -0.1, 0.1, 0.03)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the inertial frame of the base body, its geoms staying where they are."""
        if self.is_nominal:
            return
        body = robot.base_body
        # MuJoCo takes a short cut where frames coincide; they no longer do.
        model.body_sameframe[body] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        on_base = model.geom_bodyid == body
        model.geom_sameframe[on_base] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        model.body_ipos[body] += (self.x_m, 0.0, self.z_m)
        recompute_constants(model)
