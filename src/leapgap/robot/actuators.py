"""The actuators of a robot: what its file says of its motors, and one torque actuator of ours at each joint instead.

MuJoCo's files describe motors in many ways (``motor``, ``position``, ``general`` with any gain, bias and gear, several
at a joint). The commands of a log are torque, set points and gains of a joint PD, so each joint gets the one actuator
that takes them: MuJoCo's affine actuator, τ = control − kp q − kd q̇ within the limits of the torque, with the
control τ_feed-forward + kp q* + kd q̇*. Only this file and ``dc_motors`` hold the layout of the parameters of MuJoCo's
actuators.
"""

import copy
from collections.abc import Iterable, Sequence
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


KP_OF_BIAS, KD_OF_BIAS = 1, 2  # entries of ``biasprm`` of an affine actuator: −kp and −kd
STABLE_SHARE = 0.25
"""Largest share of a joint's speed that a damper of ours may take in one explicit step.

The joint's inertia is that with all other joints held; with all others free it is smaller, and the step less stable.
"""
PD_TOLERANCE = 1e-9  # largest error of the torque of a joint PD, N·m, in the check on load


def replace_actuators(spec: mujoco.MjSpec, own: Sequence[JointActuator]) -> None:
    """Give a model one affine actuator at each joint, in the order of the joints, in place of those of its file."""
    joints = {joint.name: joint for joint in spec.joints}
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    taken: set[str] = set()
    for motor in own:
        name = motor.name if motor.name not in taken else f"{motor.name} of {motor.joint}"
        taken.add(name)
        add_push(spec, motor.joint, name, float(motor.driven), motor.limit)
        joint = joints[motor.joint]
        give_to_joint(joint, motor)
        if not joint.actgravcomp:
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # the limit is the actuator's, and scales with it
    forget_removed(spec)
    if not any(motor.has_bias for motor in own):
        take_pd_once_a_step(spec)


def forget_removed(spec: mujoco.MjSpec) -> None:
    """Remove the sensors that read actuators which are no longer there, and the controls of keyframes."""
    present = {actuator.name for actuator in spec.actuators}
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname not in present:
            spec.delete(sensor)
    for key in spec.keys:
        key.ctrl, key.act = [], []


def give_to_joint(joint: mujoco.MjsJoint, motor: JointActuator) -> None:
    """Add inertia and damping that a model file has at the actuators of a joint to the joint."""
    joint.armature += motor.armature
    joint.damping = np.asarray(joint.damping) + np.array(motor.damping)


def take_pd_once_a_step(spec: mujoco.MjSpec) -> None:
    """Integrate a model so that a joint PD in its actuators acts as one that a controller computes at each step.

    The makers' torque motors leave the PD to a controller, whose torque holds for a step. ``implicitfast`` would
    integrate the damper of our actuators implicitly. Euler's method differs from it in nothing else that these models
    have: it integrates the damping of joints implicitly too.
    """
    damped_tendons = any(np.any(tendon.damping) for tendon in spec.tendons)
    explicit_damping = spec.option.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    in_fluid = spec.option.density > 0 or spec.option.viscosity > 0
    if damped_tendons or explicit_damping or in_fluid:
        return
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER


def make_affine(actuator: mujoco.MjsActuator, gain: float) -> None:
    """Make an actuator of a specification a torque motor with room for a joint PD, without limits or dynamics.

    A new actuator has the defaults of its model file, so everything is set.
    """
    actuator.dyntype, actuator.dynprm = mujoco.mjtDyn.mjDYN_NONE, [1.0, *[0.0] * 9]
    actuator.gaintype, actuator.gainprm = mujoco.mjtGain.mjGAIN_FIXED, [gain, *[0.0] * 9]
    actuator.biastype, actuator.biasprm = mujoco.mjtBias.mjBIAS_AFFINE, [0.0] * 10
    actuator.ctrllimited = actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
    actuator.actdim, actuator.actearly = -1, False
    actuator.delay, actuator.nsample, actuator.interp = 0.0, 0, 0
    actuator.armature, actuator.damping, actuator.inheritrange = 0.0, [0.0] * 3, 0.0


def set_limit(actuator: mujoco.MjsActuator, limit: tuple[float, float]) -> None:
    """Set the range of torque, N·m, of an actuator of a specification; an infinite end is a very large one."""
    limited = bool(np.isfinite(limit).any()) and limit[0] < limit[1]
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE if limited else mujoco.mjtLimited.mjLIMITED_FALSE
    actuator.forcerange = np.clip(limit, -mujoco.mjMAXVAL, mujoco.mjMAXVAL) if limited else [0.0, 0.0]


def set_joint_pd(model: mujoco.MjModel, actuators: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
    """Set the gains (actuators,) of affine actuators, N·m/rad and N·m·s/rad."""
    model.actuator_biasprm[actuators, KP_OF_BIAS] = -kp
    model.actuator_biasprm[actuators, KD_OF_BIAS] = -kd


def joint_pd(model: mujoco.MjModel, actuators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gains kp and kd (actuators,) of affine actuators."""
    return -model.actuator_biasprm[actuators, KP_OF_BIAS], -model.actuator_biasprm[actuators, KD_OF_BIAS]


def scale_torque(model: mujoco.MjModel, actuators: np.ndarray, gain: np.ndarray) -> None:
    """Scale control and joint PD of affine actuators by (actuators,) factors."""
    model.actuator_gainprm[actuators, 0] *= gain
    model.actuator_biasprm[actuators, :3] *= gain[:, None]


def scale_limit(model: mujoco.MjModel, actuators: np.ndarray, scale: np.ndarray) -> None:
    """Scale the range of torque of affine actuators by (actuators,) factors, and of their joints where those have one.

    Joints have one where a compensation of gravity counts as torque of their motors.
    """
    model.actuator_forcerange[actuators] *= scale[:, None]
    model.jnt_actfrcrange[model.actuator_trnid[actuators, 0]] *= scale[:, None]


def add_brake(spec: mujoco.MjSpec, joint: str, push: str, damper: str) -> None:
    """Add two actuators at a joint: ``push`` has a torque as its control, ``damper`` a coefficient of damping."""
    add_push(spec, joint, push)
    added = add_push(spec, joint, damper)
    by_velocity = [0.0, 0.0, -1.0]  # after a constant, and by position
    added.gaintype, added.gainprm = mujoco.mjtGain.mjGAIN_AFFINE, [*by_velocity, *[0.0] * 7]


def add_push(
    spec: mujoco.MjSpec, joint: str, name: str, gain: float = 1.0, limit: tuple[float, float] = UNLIMITED
) -> mujoco.MjsActuator:
    """Add an actuator at a joint whose control is a torque, with room for a joint PD."""
    added = spec.add_actuator()
    added.name, added.trntype, added.target, added.gear = name, mujoco.mjtTrn.mjTRN_JOINT, joint, [1.0, *[0.0] * 5]
    make_affine(added, gain)
    set_limit(added, limit)
    return added


def controls_of(model: mujoco.MjModel, names: Iterable[str]) -> list[int]:
    """Where the controls of some actuators stand among all."""
    return [int(model.actuator_ctrladr[model.actuator(name).id]) for name in names]


def largest_damping(model: mujoco.MjModel, dofs: np.ndarray, step_s: float) -> np.ndarray:
    """Largest damping by an actuator that steps of this length stand, N·m·s/rad, (dofs,); infinite if implicit."""
    implicit = (int(mujoco.mjtIntegrator.mjINT_IMPLICIT), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))
    if int(model.opt.integrator) in implicit:
        return np.full(len(dofs), np.inf)
    return np.asarray(STABLE_SHARE * model.dof_M0[dofs] / step_s)


def check_joint_pd(model: mujoco.MjModel, actuators: np.ndarray, own: Sequence[JointActuator], where: object) -> None:
    """Raise ``InputError`` unless a joint PD acts: at a displaced state each driven joint feels kp e + kd ė more.

    ``actuators`` are those of the joints ``own``; the displacement is so small that no limit of the torque is met.
    """
    rng, number = np.random.default_rng(0), len(own)
    driven = np.array([motor.driven for motor in own])
    small = np.array([0.1 * min(1.0, *np.abs(motor.limit)) for motor in own]) * driven
    kp, kd = rng.uniform(1, 2, (2, number)) * driven
    error, rate = small * rng.uniform(-1, 1, (2, number))
    speed = rng.uniform(-1, 1, number)
    joints = [model.joint(motor.joint) for motor in own]
    position = model.qpos0[[int(joint.qposadr[0]) for joint in joints]]
    dofs = np.array([int(joint.dofadr[0]) for joint in joints])
    with_pd = copy.copy(model)
    set_joint_pd(with_pd, actuators, kp, kd)
    asked = np.zeros(model.nu)
    asked[actuators] = kp * (position + error) + kd * (speed + rate)
    felt = torque_at(with_pd, dofs, speed, asked) - torque_at(model, dofs, speed, np.zeros(model.nu))
    expected = kp * error + kd * rate
    wrong = np.flatnonzero(np.abs(felt - expected) > PD_TOLERANCE)
    if len(wrong):
        found = f"a joint PD at {own[wrong[0]].joint} gives {felt[wrong[0]]:g} instead of {expected[wrong[0]]:g} N·m"
        raise InputError(where, found, "joints that feel their PD", "enable actuation in the model's options")


def torque_at(model: mujoco.MjModel, dofs: np.ndarray, speed: np.ndarray, control: np.ndarray) -> np.ndarray:
    """Torques of all actuators, N·m, (dofs,), in the pose of the model file at the joint speeds (dofs,), rad/s."""
    data = mujoco.MjData(model)
    data.qvel[dofs], data.ctrl[:] = speed, control
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_fwdActuation(model, data)
    return data.qfrc_actuator[dofs].copy()
