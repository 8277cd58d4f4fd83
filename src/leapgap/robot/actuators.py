"""The actuators of a robot: one torque actuator of ours at each joint, in place of whatever its model file has.

MuJoCo's files describe motors in many ways (``motor``, ``position``, ``general`` with any gain, bias and gear, several
at a joint). The commands of a log are torque, set points and gains of a joint PD, so each joint gets the one actuator
that takes them: MuJoCo's affine actuator, τ = control − kp q − kd q̇ within the limits of the torque, with the
control τ_feed-forward + kp q* + kd q̇*. Only this file and ``dc_motors`` hold the layout of the parameters of MuJoCo's
actuators.
"""

import copy
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.robot.stated_actuators import UNLIMITED, JointActuator

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
        added = spec.add_actuator()
        added.name = motor.name if motor.name not in taken else f"{motor.name} of {motor.joint}"
        taken.add(added.name)
        added.trntype, added.target, added.gear = mujoco.mjtTrn.mjTRN_JOINT, motor.joint, [1.0, 0, 0, 0, 0, 0]
        make_affine(added, gain=float(motor.driven))
        set_limit(added, motor.limit)
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


def add_push(spec: mujoco.MjSpec, joint: str, name: str) -> mujoco.MjsActuator:
    """Add an actuator at a joint whose control is a torque, without any limit."""
    added = spec.add_actuator()
    added.name, added.trntype, added.target, added.gear = name, mujoco.mjtTrn.mjTRN_JOINT, joint, [1.0, *[0.0] * 5]
    make_affine(added, gain=1.0)
    set_limit(added, UNLIMITED)
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
