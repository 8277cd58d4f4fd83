"""The actuators of a robot: one torque actuator of ours at each joint, in place of whatever its model file has.

MuJoCo's files describe motors in many ways (``motor``, ``position``, ``general`` with any gain, bias and gear, several
at a joint). The commands of a log are torque, set points and gains of a joint PD, so each joint gets the one actuator
that takes them: MuJoCo's affine actuator, τ = control − kp q − kd q̇ within the limits of the torque, with the
control τ_feed-forward + kp q* + kd q̇*. Only this file holds MuJoCo's layout of actuator parameters.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.errors import InputError

KP_OF_BIAS, KD_OF_BIAS = 1, 2
"""Entries of ``biasprm`` of an affine actuator: −kp and −kd."""
DC_RESISTANCE, DC_CONSTANT, DC_KP, DC_KD, DC_VOLTAGE = 0, 1, 4, 6, 7
"""Entries of ``gainprm`` of MuJoCo's DC motor."""
DC_TIME_CONSTANT = 0
"""Entry of ``dynprm`` of MuJoCo's DC motor: its electrical time constant, s."""
DC_TEMPERATURE_COEFFICIENT = 2
"""Entry of ``gainprm`` of MuJoCo's DC motor; at 1, its temperature is the rise of its resistance as a share of it."""
DC_HEAT = slice(2, 4)
"""Entries of ``dynprm`` of MuJoCo's DC motor: thermal resistance, K/W, and heat capacity, J/K, of its windings."""
POSITION_INPUT, FEED_FORWARD_INPUT, NO_INPUT = 1, 4, 16
"""MuJoCo's input signatures of a DC motor whose one control is a set point or a torque, and of one without any control
(bits; velocity is 2)."""
LUGRE_BIAS = slice(3, 6)
"""Entries of ``biasprm`` of MuJoCo's DC motor: Coulomb and static friction, N·m, and Stribeck's speed, rad/s."""
LUGRE_DYNAMICS = slice(5, 7)
"""Entries of ``dynprm`` of MuJoCo's DC motor: stiffness and damping of its bristles, N·m/rad and N·m·s/rad."""
STABLE_SHARE = 0.25
"""Largest share of a joint's speed that a damper of ours may take in one explicit step.

The joint's inertia is that with all other joints held; with all others free it is smaller, and the step less stable.
"""
SINGLE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
AT_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
TRANSMISSIONS = {
    int(mujoco.mjtTrn.mjTRN_SLIDERCRANK): "a slider-crank",
    int(mujoco.mjtTrn.mjTRN_TENDON): "a tendon",
    int(mujoco.mjtTrn.mjTRN_SITE): "a site",
    int(mujoco.mjtTrn.mjTRN_BODY): "a body",
}
UNLIMITED = (-np.inf, np.inf)
PD_TOLERANCE = 1e-9
"""Largest error of the torque of a joint PD, N·m, in the check on load."""


@dataclass(frozen=True)
class JointActuator:
    """What a model file says of the motor of one hinge or slide joint, seen at the joint."""

    joint: str
    name: str
    driven: bool
    """False for a passive joint, which no actuator of the file drives."""
    limit: tuple[float, float] = UNLIMITED
    """Range of the torque, N·m (N for slides); infinite where the file states none."""
    armature: float = 0.0
    """Inertia that the file gives to actuators and not to the joint, kg·m²."""
    damping: tuple[float, ...] = (0.0, 0.0, 0.0)
    """Damping that the file gives to actuators: coefficients of q̇, |q̇| q̇ and q̇³."""
    has_bias: bool = False
    """Whether an actuator of the file depends on the joint's state, as servos do; a torque motor does not."""


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
        raise InputError(where, f"joints without a name, of the bodies {bodies}", "a name for each joint", "name them")
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
    raise InputError(
        where,
        found,
        "actuators at hinge or slide joints: the commands of a log are those of joints",
        "replace it by actuators at the joints it moves, or remove it",
    )


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


def replace_actuators(spec: mujoco.MjSpec, own: Sequence[JointActuator]) -> None:
    """Give a model one affine actuator at each joint, in the order of the joints, in place of those of its file."""
    joints = {joint.name: joint for joint in spec.joints}
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    taken: set[str] = set()
    for motor in own:
        added = spec.add_actuator()
        added.name = motor.name if motor.name not in taken else f"{motor.name} of {motor.joint}"
        taken.add(added.name)
        added.trntype, added.target, added.gear = mujoco.mjtTrn.mjTRN_JOINT, motor.joint, [1.0, 0, 0, 0, 0, 0]
        make_affine(added, gain=float(motor.driven))
        set_limit(added, motor.limit)
        joint = joints[motor.joint]
        joint.armature += motor.armature
        joint.damping = np.asarray(joint.damping) + np.array(motor.damping)
        if not joint.actgravcomp:
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # the limit is the actuator's, and scales with it
    for sensor in list(spec.sensors):
        if sensor.objtype == mujoco.mjtObj.mjOBJ_ACTUATOR and sensor.objname not in taken:
            spec.delete(sensor)
    for key in spec.keys:
        key.ctrl, key.act = [], []
    if not any(motor.has_bias for motor in own):
        take_pd_once_a_step(spec)


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
    """Scale control, joint PD and limit of affine actuators by (actuators,) factors."""
    model.actuator_gainprm[actuators, 0] *= gain
    model.actuator_biasprm[actuators, :3] *= gain[:, None]
    model.actuator_forcerange[actuators] *= gain[:, None]


def make_dc_motors(
    model: mujoco.MjModel, actuators: np.ndarray, resistance: np.ndarray, voltage_v: np.ndarray, lag_s: np.ndarray
) -> None:
    """Turn affine actuators into DC motors with the same joint PD; a voltage of 0 is no limit. (actuators,) each."""
    kp, kd = joint_pd(model, actuators)
    model.actuator_dyntype[actuators] = int(mujoco.mjtDyn.mjDYN_DCMOTOR)
    model.actuator_gaintype[actuators] = int(mujoco.mjtGain.mjGAIN_DCMOTOR)
    model.actuator_biastype[actuators] = int(mujoco.mjtBias.mjBIAS_DCMOTOR)
    model.actuator_ctrlspec[actuators] = FEED_FORWARD_INPUT
    model.actuator_actearly[actuators] = True
    model.actuator_gainprm[actuators], model.actuator_biasprm[actuators], model.actuator_dynprm[actuators] = 0, 0, 0
    model.actuator_gainprm[actuators, DC_RESISTANCE], model.actuator_gainprm[actuators, DC_CONSTANT] = resistance, 1.0
    model.actuator_gainprm[actuators, DC_VOLTAGE] = voltage_v
    model.actuator_dynprm[actuators, DC_TIME_CONSTANT] = lag_s
    set_dc_joint_pd(model, actuators, kp, kd)


def set_heating(model: mujoco.MjModel, actuators: np.ndarray, heating: np.ndarray, cooling_s: float) -> None:
    """Let the resistance of DC motors rise as they heat: (actuators,), a share of it by torque² and time, 1/(N²m²s).

    A motor has the temperature as a state only where ``add_dc_heat`` has been called.
    """
    for actuator, growth in zip(actuators, heating, strict=True):
        if growth > 0:
            resistance = float(model.actuator_gainprm[actuator, DC_RESISTANCE])
            model.actuator_gainprm[actuator, DC_TEMPERATURE_COEFFICIENT] = 1.0
            model.actuator_dynprm[actuator, DC_HEAT] = thermal_numbers(resistance, float(growth), cooling_s)


def thermal_numbers(resistance: float, heating: float, cooling_s: float) -> tuple[float, float]:
    """Thermal resistance and heat capacity of a DC motor whose temperature is the rise of its resistance, as a share.

    ``resistance`` in V/(N·m), ``heating`` in 1/(N²m²s).
    """
    capacity = resistance / heating
    return cooling_s / capacity, capacity


def set_dc_joint_pd(model: mujoco.MjModel, actuators: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
    """Set the gains (actuators,) of DC motors, N·m/rad and N·m·s/rad."""
    model.actuator_gainprm[actuators, DC_KP] = kp
    model.actuator_gainprm[actuators, DC_KD] = kd


def dc_joint_pd(model: mujoco.MjModel, actuators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gains kp and kd (actuators,) of DC motors."""
    return model.actuator_gainprm[actuators, DC_KP], model.actuator_gainprm[actuators, DC_KD]


def gains_of(model: mujoco.MjModel, actuators: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gains kp and kd (actuators,) of joint PDs, in affine actuators and DC motors."""
    of_affine, of_dc = joint_pd(model, actuators), dc_joint_pd(model, actuators)
    electric = is_dc_motor(model, actuators)
    return np.where(electric, of_dc[0], of_affine[0]), np.where(electric, of_dc[1], of_affine[1])


def set_gains(model: mujoco.MjModel, actuators: np.ndarray, kp: np.ndarray, kd: np.ndarray) -> None:
    """Set the gains (actuators,) of joint PDs, in affine actuators and DC motors."""
    electric = is_dc_motor(model, actuators)
    for chosen, put in ((~electric, set_joint_pd), (electric, set_dc_joint_pd)):
        put(model, actuators[chosen], kp[chosen], kd[chosen])


def is_dc_motor(model: mujoco.MjModel, actuators: np.ndarray) -> np.ndarray:
    """Which actuators are DC motors, bool, (actuators,)."""
    return np.asarray(model.actuator_gaintype[actuators] == int(mujoco.mjtGain.mjGAIN_DCMOTOR))


def add_passive_friction(spec: mujoco.MjSpec, joint: str, name: str) -> None:
    """Add an actuator without controls at a joint, for friction with a state; ``set_lugre_friction`` gives its size."""
    added = spec.add_actuator()
    added.name, added.trntype, added.target, added.gear = name, mujoco.mjtTrn.mjTRN_JOINT, joint, [1.0, 0, 0, 0, 0, 0]
    make_affine(added, gain=0.0)
    set_limit(added, UNLIMITED)
    added.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, lugre=[1.0, 0.0, 1.0, 1.0, 1.0], ctrlspec=NO_INPUT)


def set_lugre_friction(
    model: mujoco.MjModel, actuator: int, stiffness: float, damping: float, curve: tuple[float, float, float]
) -> None:
    """Set the LuGre friction of a DC motor.

    ``stiffness`` and ``damping`` are those of the bristles, N·m/rad and N·m·s/rad; ``curve`` is the friction at speed
    and at rest, N·m, and Stribeck's speed, rad/s.
    """
    model.actuator_dynprm[actuator, LUGRE_DYNAMICS] = stiffness, damping
    model.actuator_biasprm[actuator, LUGRE_BIAS] = curve


def bristles_in_motion(model: mujoco.MjModel, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Addresses among the activations, and deflections of the bristles of LuGre friction, at speeds of the dofs (nv,).

    A joint that moves has dragged its bristles along, z = g(q̇) sign(q̇) / σ₀ with Stribeck's curve g. For one that
    hardly moves nothing is known of them, so the sign is softened over a tenth of Stribeck's speed.
    """
    stiffness = model.actuator_dynprm[:, LUGRE_DYNAMICS.start]
    passive = np.flatnonzero(
        (model.actuator_actnum > 0) & is_dc_motor(model, np.arange(len(stiffness))) & (stiffness > 0)
    )
    sliding, holding, stribeck = model.actuator_biasprm[passive, LUGRE_BIAS].T
    speed = speeds[model.jnt_dofadr[model.actuator_trnid[passive, 0]]]
    curve = sliding + (holding - sliding) * np.exp(-((speed / stribeck) ** 2))
    return model.actuator_actadr[passive], curve * np.tanh(10 * speed / stribeck) / stiffness[passive]


def add_dc_state(spec: mujoco.MjSpec, motors: np.ndarray, resistance: float) -> None:
    """Make some actuators (indices) DC motors whose torque is a state; ``make_dc_motors`` then gives its size."""
    for motor in motors.tolist():
        dc_motor(spec.actuators[motor], resistance).dynprm[DC_TIME_CONSTANT] = 1.0


def add_dc_heat(spec: mujoco.MjSpec, motors: np.ndarray, resistance: float) -> None:
    """Make some actuators (indices) DC motors whose temperature is a state; ``set_heating`` then gives its size."""
    for motor in motors.tolist():
        dc_motor(spec.actuators[motor], resistance).dynprm[DC_HEAT] = 1.0, 1.0


def dc_motor(actuator: mujoco.MjsActuator, resistance: float) -> mujoco.MjsActuator:
    """The actuator as a DC motor without states, or with those that it has as one already."""
    if actuator.gaintype != mujoco.mjtGain.mjGAIN_DCMOTOR:
        put_winding(actuator, Winding(resistance, voltage_v=0.0, lag_s=0.0))
    return actuator


def has_current(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the torque of a motor is a state of its own."""
    return bool(model.actuator_actnum[actuator] and model.actuator_dynprm[actuator, DC_TIME_CONSTANT] > 0)


def has_temperature(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the temperature of a motor is a state of its own."""
    return bool(model.actuator_actnum[actuator] and model.actuator_dynprm[actuator, DC_HEAT.start] > 0)


def state_of_current(model: mujoco.MjModel, actuator: int) -> int:
    """Address of a motor's current among the activations: MuJoCo has it last."""
    return int(model.actuator_actadr[actuator] + model.actuator_actnum[actuator] - 1)


def state_of_temperature(model: mujoco.MjModel, actuator: int) -> int:
    """Address of a motor's temperature among the activations: MuJoCo has it first in a motor without an integrator."""
    return int(model.actuator_actadr[actuator])


def add_brake(spec: mujoco.MjSpec, joint: str, push: str, damper: str) -> None:
    """Add two actuators at a joint: ``push`` has a torque as its control, ``damper`` a coefficient of damping."""
    for name, gain in ((push, [1.0, 0.0, 0.0]), (damper, [0.0, 0.0, -1.0])):  # constant, by position, by velocity
        added = spec.add_actuator()
        added.name, added.trntype, added.target, added.gear = name, mujoco.mjtTrn.mjTRN_JOINT, joint, [1.0, *[0.0] * 5]
        make_affine(added, gain=1.0)
        set_limit(added, UNLIMITED)
        added.gaintype, added.gainprm = mujoco.mjtGain.mjGAIN_AFFINE, [*gain, *[0.0] * 7]


def largest_damping(model: mujoco.MjModel, dofs: np.ndarray, step_s: float) -> np.ndarray:
    """Largest damping by an actuator that steps of this length stand, N·m·s/rad, (dofs,); infinite if implicit."""
    implicit = (int(mujoco.mjtIntegrator.mjINT_IMPLICIT), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST))
    if int(model.opt.integrator) in implicit:
        return np.full(len(dofs), np.inf)
    return np.asarray(STABLE_SHARE * model.dof_M0[dofs] / step_s)


def filter_of(joint: str) -> str:
    """Name of the actuator that holds the damper of a joint PD apart, so that it can act late."""
    return f"filtered damper of {joint}"


def filtered_dampers(model: mujoco.MjModel, joints: Sequence[str]) -> list[tuple[int, int]]:
    """Index of each joint whose damper is an actuator of its own, with that actuator."""
    kind = int(mujoco.mjtObj.mjOBJ_ACTUATOR)
    found = ((i, mujoco.mj_name2id(model, kind, filter_of(joint))) for i, joint in enumerate(joints))
    return [(i, actuator) for i, actuator in found if actuator >= 0]


def add_filtered_dampers(spec: mujoco.MjSpec, joints: Sequence[str], resistance: float) -> None:
    """Add an actuator at each of these joints that ``split_joint_pd`` gives the damper of the joint PD."""
    for joint in joints:
        added = spec.add_actuator()
        added.name, added.target, added.trntype = filter_of(joint), joint, mujoco.mjtTrn.mjTRN_JOINT
        make_affine(added, gain=1.0)
        set_limit(added, UNLIMITED)
        added.gear = [1.0, 0, 0, 0, 0, 0]
        put_winding(added, Winding(resistance, voltage_v=0.0, lag_s=1.0))


def split_joint_pd(model: mujoco.MjModel, motors: np.ndarray, dampers: np.ndarray, lag_s: np.ndarray) -> None:
    """Move the damper of each motor's joint PD to the actuator that ``add_filtered_dampers`` gave its joint.

    It follows with the time constants ``lag_s`` (motors,). The motor's limit becomes that of the joint, of the sum.
    """
    is_dc = model.actuator_gaintype[motors] == int(mujoco.mjtGain.mjGAIN_DCMOTOR)
    for get, put, chosen in ((joint_pd, set_joint_pd, ~is_dc), (dc_joint_pd, set_dc_joint_pd, is_dc)):
        kp, kd = get(model, motors[chosen])
        put(model, motors[chosen], kp, np.zeros_like(kd))
        set_dc_joint_pd(model, dampers[chosen], np.zeros_like(kp), kd)
    model.actuator_dynprm[dampers, DC_TIME_CONSTANT] = lag_s
    joints = model.actuator_trnid[motors, 0]
    model.jnt_actfrclimited[joints] = model.actuator_forcelimited[motors]
    model.jnt_actfrcrange[joints] = model.actuator_forcerange[motors]
    model.actuator_forcelimited[motors] = False


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


@dataclass(frozen=True)
class Winding:
    """Electrical side of a motor, seen at its joint."""

    resistance: float
    """V/(N·m)."""
    voltage_v: float
    """Largest voltage; 0: no limit."""
    lag_s: float
    """Electrical time constant; 0: none."""
    heating: float = 0.0
    """Growth of the resistance by heat, as a share of it, 1/(N²m²s) of the joint; 0: none."""
    cooling_s: float = 1.0
    """Time constant of the heat."""


def move_to_joints(spec: mujoco.MjSpec, own: Sequence[JointActuator]) -> None:
    """Give inertia and damping that a specification has at its makers' actuators to the joints, as our models do."""
    for actuator in spec.actuators:
        actuator.armature, actuator.damping = 0.0, [0.0] * 3
    joints = {joint.name: joint for joint in spec.joints}
    for motor in own:
        joint = joints[motor.joint]
        joint.armature += motor.armature
        joint.damping = np.asarray(joint.damping) + np.array(motor.damping)


def scale_joint(spec: mujoco.MjSpec, joint: str, gain: float) -> None:
    """Scale what the makers' actuators of a joint deliver, by gain, bias and limits."""
    for actuator in spec.actuators:
        if actuator.target == joint:
            actuator.gainprm[:3], actuator.biasprm[:3] = gain * actuator.gainprm[:3], gain * actuator.biasprm[:3]
            actuator.forcerange = gain * actuator.forcerange
    limited = next(one for one in spec.joints if one.name == joint)
    limited.actfrcrange = gain * limited.actfrcrange


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


def put_winding(actuator: mujoco.MjsActuator, winding: Winding) -> None:
    """Make an actuator of a specification a DC motor whose control is a torque."""
    actuator.dyntype = mujoco.mjtDyn.mjDYN_DCMOTOR
    actuator.gaintype = mujoco.mjtGain.mjGAIN_DCMOTOR
    actuator.biastype = mujoco.mjtBias.mjBIAS_DCMOTOR
    actuator.ctrlspec, actuator.actearly = FEED_FORWARD_INPUT, True
    actuator.gainprm, actuator.biasprm, actuator.dynprm = [0.0] * 10, [0.0] * 10, [0.0] * 10
    actuator.gainprm[DC_RESISTANCE], actuator.gainprm[DC_CONSTANT] = winding.resistance, 1.0
    actuator.gainprm[DC_VOLTAGE] = winding.voltage_v
    actuator.dynprm[DC_TIME_CONSTANT] = winding.lag_s
    if winding.heating:
        actuator.gainprm[DC_TEMPERATURE_COEFFICIENT] = 1.0
        actuator.dynprm[DC_HEAT] = thermal_numbers(winding.resistance, winding.heating, winding.cooling_s)
