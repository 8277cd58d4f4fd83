"""What a model file says of joints that logs may lack: gains of position servos, and ties to other joints."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

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


@dataclass(frozen=True)
class Tie:
    """One joint's position as a linear function of another's: rad, or m of a slide."""

    of: str  # the other joint
    slope: float
    offset: float

    def position(self, of_other: np.ndarray) -> np.ndarray:
        """Position from that of the other joint."""
        return self.slope * of_other + self.offset

    def velocity(self, of_other: np.ndarray) -> np.ndarray:
        """Velocity from that of the other joint."""
        return self.slope * of_other


def tied_joints(robot: Robot, without: Collection[str]) -> Mapping[str, Tie]:
    """Ties of those joints ``without`` a column that no motor drives and that follow a joint with one.

    A joint that follows one which is tied itself is none of them, nor is one whose constraint is curved.
    """
    found: dict[str, Tie] = {}
    for joint, tie in ties(robot.model):
        passive = joint in without and joint not in robot.driven_joints
        if passive and tie.of in robot.joints and tie.of not in without:
            found.setdefault(joint, tie)
    return found


def ties(model: mujoco.MjModel) -> list[tuple[str, Tie]]:
    """Active linear equality constraints between two joints, each in both directions, as joint and tie.

    MuJoCo: q1 − r1 = c0 + c1 (q2 − r2) + …, with the joints' positions r in the reference configuration.
    """
    found = []
    for number in np.flatnonzero(model.eq_type == int(mujoco.mjtEq.mjEQ_JOINT)):
        first, second = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        constant, slope, *curved = (float(value) for value in model.eq_data[number][:5])
        if second < 0 or slope == 0 or any(curved) or not model.eq_active0[number]:
            continue
        at = [float(model.qpos0[model.jnt_qposadr[joint]]) for joint in (first, second)]
        offset = at[0] + constant - slope * at[1]
        names = [model.joint(joint).name for joint in (first, second)]
        found += [(names[0], Tie(names[1], slope, offset)), (names[1], Tie(names[0], 1 / slope, -offset / slope))]
    return found
