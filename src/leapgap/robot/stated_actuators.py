"""What a model file says of the motors of its joints: actuators, and constants as custom numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError

RESISTANCE, TOP_SPEED = "motor_resistance", "motor_top_speed"
"""Names of the custom numbers: ``<custom><numeric name="motor_resistance" data="…"/> …</custom>``."""


@dataclass(frozen=True)
class MotorConstants:
    """Of every joint's motor, seen at the joint through its gear: the motor constant is 1 there, and 1 V is 1 rad/s."""

    resistance: float  # V/(N·m): R i with the current i as torque at the joint, hence the winding's R over (gear · Kt)²
    top_speed_rad_s: float  # largest speed that a joint is designed for, rad/s


def motors_of(model: mujoco.MjModel) -> MotorConstants | None:
    """Motor constants that a model file states; None unless it states both numbers."""
    stated = {model.numeric(i).name: float(model.numeric(i).data[0]) for i in range(model.nnumeric)}
    if not {RESISTANCE, TOP_SPEED} <= stated.keys():
        return None
    return MotorConstants(stated[RESISTANCE], stated[TOP_SPEED])


SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
TRANSMISSIONS = {
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): "a slider-crank",
    int(mujoco.mjtTrn.mjTRN_TENDON): "a tendon",
    int(mujoco.mjtTrn.mjTRN_SITE): "a site",
    int(mujoco.mjtTrn.mjTRN_BODY): "a body",
}
UNLIMITED = (-np.inf, np.inf)


@dataclass(frozen=True)
class JointActuator:
    """What a model file says of the motor of one hinge or slide joint, seen at the joint."""

    joint: str
    name: str
    driven: bool  # false for a passive joint, which no actuator of the file drives
    limit: tuple[float, float] = UNLIMITED  # range of the torque, N·m (N for slides); infinite where not stated
    armature: float = 0.0  # inertia that the file gives to actuators and not to the joint, kg·m²
    damping: tuple[float, ...] = (0.0, 0.0, 0.0)  # that the file gives to actuators: coefficients of q̇, |q̇| q̇, q̇³
    has_bias: bool = False  # whether an actuator of the file depends on the joint's state, as servos do


def actuators_of(
    model: mujoco.MjModel, where: object, all_driven: bool = False
) -> tuple[tuple[JointActuator, ...], tuple[str, ...]]:
    """Motors of the joints by a compiled model file, in the order of its joints, and notes on what is left out.

    Several actuators at one joint act as one, whose limit is the sum of theirs. A URDF has no actuators: ``all_driven``
    then gives every joint a motor. ``InputError`` names joints without a name and actuators that are not at a hinge or
    slide joint.
    """
    joints = [joint for joint in range(model.njnt) if model.jnt_type[joint] in SINGLE]
    unnamed = [joint for joint in joints if not model.joint(joint).name]
    if unnamed:
        bodies = ", ".join(model.body(model.jnt_bodyid[joint]).name or "(no name)" for joint in unnamed)
        raise InputError(where, f"unnamed joints of the bodies {bodies}", "a name for each joint", "name them")
    at_joint: dict[int, list[int]] = {joint: [] for joint in joints}
    for actuator in range(model.nu):
        at_joint[joint_of(model, actuator, where)].append(actuator)
    found, notes = [], []
    for joint, actuators in at_joint.items():
        found.append(joint_actuator(model, joint, actuators, driven=all_driven or bool(actuators)))
        notes += notes_on(model, joint, actuators)
    return tuple(found), tuple(notes)


def joint_of(model: mujoco.MjModel, actuator: int, where: object) -> int:
    """The hinge or slide joint that an actuator drives; ``InputError`` where it drives something else."""
    kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    name = model.actuator(actuator).name or f"number {actuator}"
    if int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_MUSCLE):
        found = f"the actuator {name} is a muscle"
    elif kind in AT_JOINT and model.jnt_type[target] in SINGLE:
        return target
    elif kind in AT_JOINT:
        found = f"the actuator {name} drives a free or ball joint"
    else:
        found = f"the actuator {name} drives {TRANSMISSIONS.get(kind, 'no joint')}"
    expected = "actuators at hinge or slide joints: the commands of a log are those of joints"
    raise InputError(where, found, expected, "replace it by actuators at the joints it moves, or remove it")


def joint_actuator(model: mujoco.MjModel, joint: int, actuators: Sequence[int], driven: bool) -> JointActuator:
    """The motor of one joint from the actuators that drive it."""
    name = model.joint(joint).name
    limits = np.sum([torque_limit(model, actuator) for actuator in actuators] or [np.array(UNLIMITED)], axis=0)
    if model.jnt_actfrclimited[joint]:
        limits = np.clip(limits, *model.jnt_actfrcrange[joint])
    chosen = list(actuators)
    squared_gear = model.actuator_gear[chosen, 0] ** 2  # MuJoCo scales all three coefficients of damping by it
    damping = squared_gear @ np.column_stack([model.actuator_damping[chosen], model.actuator_dampingpoly[chosen]])
    return JointActuator(
        name,
        (model.actuator(actuators[0]).name if actuators else "") or name,
        driven,
        limit=(float(limits[0]), float(limits[1])),
        armature=float(squared_gear @ model.actuator_armature[chosen]),
        damping=tuple(float(value) for value in damping),
        has_bias=bool((model.actuator_biastype[chosen] != int(mujoco.mjtBias.mjBIAS_NONE)).any()),
    )


def torque_limit(model: mujoco.MjModel, actuator: int) -> np.ndarray:
    """Range of an actuator's torque at its joint, N·m, (2,): by its force, and by the control of a torque motor."""
    gear = model.actuator_gear[actuator, 0]
    limit = np.array(UNLIMITED)
    if model.actuator_forcelimited[actuator]:
        limit = np.sort(model.actuator_forcerange[actuator] * gear)
    if model.actuator_ctrllimited[actuator] and is_torque_motor(model, actuator):
        asked = np.sort(model.actuator_ctrlrange[actuator] * model.actuator_gainprm[actuator, 0] * gear)
        limit = np.clip(asked, *limit)
    return limit


def is_torque_motor(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the control of an actuator is a torque: a fixed gain, no bias, and no integration of the control."""
    fixed = model.actuator_gaintype[actuator] == int(mujoco.mjtGain.mjGAIN_FIXED)
    biased = model.actuator_biastype[actuator] != int(mujoco.mjtBias.mjBIAS_NONE)
    integrates = model.actuator_dyntype[actuator] == int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
    return bool(fixed and not integrates and not (biased and model.actuator_biasprm[actuator].any()))


def notes_on(model: mujoco.MjModel, joint: int, actuators: Sequence[int]) -> list[str]:
    """Sentences on what the file says of a joint's actuators and the replay does not simulate."""
    name, notes = model.joint(joint).name, []
    if len(actuators) > 1:
        notes.append(f"{len(actuators)} actuators at the joint {name} act as one; their torque limits add")
    dynamic = [i for i in actuators if model.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE)]
    if dynamic:
        notes.append(f"the dynamics of the actuator at the joint {name} (filter or winding) are left out")
    if any(model.actuator_delay[i] > 0 for i in actuators):
        notes.append(f"the delay of the actuator at the joint {name} is left out")
    return notes
