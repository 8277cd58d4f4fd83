"""Changes of the actuators that a model file has from its makers, for a corrected robot that any MuJoCo loads."""

from collections.abc import Sequence

import mujoco
import numpy as np

from leapgap.robot.actuators import KD_OF_BIAS, KP_OF_BIAS, give_to_joint, make_affine, set_limit
from leapgap.robot.dc_motors import DC_CONSTANT, DC_KD, DC_KP, POSITION_INPUT, Winding, put_winding
from leapgap.robot.stated_actuators import JointActuator


def move_to_joints(spec: mujoco.MjSpec, own: Sequence[JointActuator]) -> None:
    """Give inertia and damping that a specification has at its makers' actuators to the joints, as our models do."""
    for actuator in spec.actuators:
        actuator.armature, actuator.damping = 0.0, [0.0] * 3
    joints = {joint.name: joint for joint in spec.joints}
    for motor in own:
        give_to_joint(joints[motor.joint], motor)


def scale_joint(spec: mujoco.MjSpec, joint: str, gain: float) -> None:
    """Scale what the makers' actuators of a joint deliver, by gain, bias and limits."""
    for actuator in spec.actuators:
        if actuator.target == joint:
            actuator.gainprm[:3], actuator.biasprm[:3] = gain * actuator.gainprm[:3], gain * actuator.biasprm[:3]
            actuator.forcerange = gain * actuator.forcerange
    limited = next(one for one in spec.joints if one.name == joint)
    limited.actfrcrange = gain * limited.actfrcrange


def scale_limit(spec: mujoco.MjSpec, joint: str, scale: float) -> None:
    """Scale the largest torque of the makers' actuators of a joint, whether their force or their control limits it."""
    for actuator in spec.actuators:
        if actuator.target == joint:
            actuator.forcerange = scale * actuator.forcerange
            if actuator.biastype == mujoco.mjtBias.mjBIAS_NONE:
                actuator.ctrlrange = scale * actuator.ctrlrange
    limited = next(one for one in spec.joints if one.name == joint)
    limited.actfrcrange = scale * limited.actfrcrange


def replace_by_dc_motor(spec: mujoco.MjSpec, motor: JointActuator, gain: float, winding: Winding) -> None:
    """Put one DC motor at a joint in place of its makers' actuators, whose controls it takes.

    A position servo keeps its gains; every other motor takes a torque, through the same gear and gain as before.
    ``gain`` is how much of the torque is delivered; ``scale_joint`` has been called.
    """
    first, *others = [actuator for actuator in spec.actuators if actuator.target == motor.joint]
    remove(spec, others)
    kp, kd = (-first.biasprm[entry] * first.gear[0] ** 2 for entry in (KP_OF_BIAS, KD_OF_BIAS))
    ratio = gain if others else first.gainprm[0] * first.gear[0]  # torque at the joint by control
    is_servo = first.biastype == mujoco.mjtBias.mjBIAS_AFFINE and kp > 0 and not others
    ratio = 1.0 if is_servo else ratio
    limited, control_range = first.ctrllimited, np.array(first.ctrlrange)
    make_affine(first, gain=1.0)
    first.ctrllimited, first.ctrlrange = limited, control_range
    first.gear = [ratio, 0, 0, 0, 0, 0]
    lower, upper = sorted(gain * end / ratio for end in motor.limit)
    set_limit(first, (lower, upper))
    put_winding(first, winding)
    first.gainprm[DC_CONSTANT] = 1 / ratio  # so that the current is the torque at the joint
    if is_servo:
        first.ctrlspec = POSITION_INPUT
        first.gainprm[DC_KP], first.gainprm[DC_KD] = kp, kd


def remove(spec: mujoco.MjSpec, unwanted: Sequence[mujoco.MjsActuator]) -> None:
    """Remove actuators from a specification, with the sensors that read them and the controls of its keyframes."""
    if not unwanted:
        return
    names = {actuator.name for actuator in unwanted}
    for actuator in unwanted:
        spec.delete(actuator)
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname in names:
            spec.delete(sensor)
    for key in spec.keys:
        key.ctrl, key.act = [], []
