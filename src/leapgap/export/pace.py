"""Actuators for PACE, by the keys of its configuration and the order of its parameters."""

import re

from leapgap.export.actuators import PythonExport, actuator_settings, missing_gains
from leapgap.export.base import CorrectedRobot, literal

SOURCE = '''\
"""A corrected robot for PACE 0.2 (`pace_sim2real`, on Isaac Lab 2.3).

`actuator(order, dt, velocity_limit)` is the actuator of all joints in the `order` of the articulation, by which PACE
reads encoder biases; `parameters(order, dt)` are the numbers in the order in which PACE fits them: armature, viscous
friction, friction and encoder bias of each joint, then one delay in steps.
"""

from pace_sim2real.utils import PaceDCMotorCfg

{settings}

def delay_steps(physics_dt):
    """The delay of all joints in physics steps: the mean, for PACE has one delay."""
    return round(sum(low + high for low, high in DELAY_S.values()) / (2 * len(DELAY_S) * physics_dt))


def actuator(joint_order, physics_dt, velocity_limit, saturation_effort=None):
    """The actuator of all joints; the limit of speed is the maker's, which logs do not tell."""
    limit = max(EFFORT_LIMIT.values())
    return PaceDCMotorCfg(
        joint_names_expr=list(STIFFNESS),
        saturation_effort=limit if saturation_effort is None else saturation_effort,
        effort_limit=EFFORT_LIMIT,
        velocity_limit=velocity_limit,
        stiffness=STIFFNESS,
        damping=DAMPING,
        armature=ARMATURE,
        friction=FRICTION,
        dynamic_friction=FRICTION,
        viscous_friction=VISCOUS_FRICTION,
        encoder_bias=[ENCODER_BIAS[NAMES[joint]] for joint in joint_order],
        max_delay=delay_steps(physics_dt),
    )


def parameters(joint_order, physics_dt):
    """All numbers as PACE's vector has them, for joints in the order of its configuration."""
    names = [NAMES[joint] for joint in joint_order]
    each = [of[name] for of in (ARMATURE, VISCOUS_FRICTION, FRICTION, ENCODER_BIAS) for name in names]
    return [*each, delay_steps(physics_dt)]


NAMES = {names}
'''


class Pace(PythonExport):
    """Actuator and vector of parameters for PACE, as Python."""

    name = "for_pace.py"
    says = "the actuator (`PaceDCMotorCfg`) and the vector of parameters of PACE 0.2"
    source = SOURCE

    def lacks(self, corrected: CorrectedRobot) -> str | None:
        """The gains of the joint PD, or limits of the motors."""
        if None in actuator_settings(corrected)["effort_limit"].values():
            return "the model states no limits of its torques, which PACE asks for"
        return missing_gains(corrected)

    def further(self, corrected: CorrectedRobot) -> dict[str, str]:
        """The names of the joints, and as they stand in expressions."""
        return {"names": literal({joint: re.escape(joint) for joint in corrected.robot.driven_joints})}
