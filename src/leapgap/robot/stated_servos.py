"""Gains of the position servos that a model file states, for logs that hold set points and no gains."""

import mujoco

from leapgap.robot.model import Robot


def servo_gains(robot: Robot) -> dict[str, tuple[float, float]] | None:
    """N·m/rad and N·m·s/rad of the servo at each driven joint; None where one has another actuator, or a gear."""
    model = robot.published_spec().compile()
    found: dict[str, tuple[float, float]] = {}
    for number in range(model.nu):
        joint = model.joint(int(model.actuator_trnid[number, 0])).name
        gain, (bias, kp, kd) = model.actuator_gainprm[number, 0], model.actuator_biasprm[number, :3]
        is_servo = (
            model.actuator_gaintype[number] == int(mujoco.mjtGain.mjGAIN_FIXED)
            and model.actuator_biastype[number] == int(mujoco.mjtBias.mjBIAS_AFFINE)
            and model.actuator_dyntype[number] == int(mujoco.mjtDyn.mjDYN_NONE)
            and gain > 0
            and (bias, kp) == (0, -gain)
            and model.actuator_gear[number, 0] == 1
        )
        if not is_servo or joint in found:
            return None
        found[joint] = (float(gain), abs(float(kd)))
    return found if found and set(found) == set(robot.driven_joints) else None
