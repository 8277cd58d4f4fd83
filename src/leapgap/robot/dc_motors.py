"""MuJoCo's DC motor in place of an affine actuator, where voltage, current, heat or a friction with a memory matter."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.robot.actuators import (
    KD_OF_BIAS,
    KP_OF_BIAS,
    JointActuator,
    add_push,
    forget_removed,
    give_to_joint,
    joint_pd,
    make_affine,
    set_joint_pd,
    set_limit,
)

DC_RESISTANCE, DC_CONSTANT, DC_KP, DC_KD, DC_VOLTAGE = 0, 1, 4, 6, 7  # entries of ``gainprm`` of MuJoCo's DC motor
DC_TIME_CONSTANT = 0  # entry of ``dynprm`` of MuJoCo's DC motor: its electrical time constant, s
DC_TEMPERATURE_COEFFICIENT = 2
"""Entry of ``gainprm`` of MuJoCo's DC motor; at 1, its temperature is the rise of its resistance as a share of it."""
DC_HEAT = slice(2, 4)  # of ``dynprm`` of MuJoCo's DC motor: thermal resistance, K/W, and heat capacity, J/K
POSITION_INPUT, FEED_FORWARD_INPUT, NO_INPUT = 1, 4, 16
"""MuJoCo's input signatures of a DC motor whose one control is a set point or a torque, and of one without any control
(bits; velocity is 2)."""
LUGRE_BIAS = slice(3, 6)  # of ``biasprm`` of MuJoCo's DC motor: friction at speed and at rest, N·m, Stribeck's speed
LUGRE_DYNAMICS = slice(5, 7)  # of ``dynprm``: stiffness and damping of its bristles, N·m/rad and N·m·s/rad


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
    added = add_push(spec, joint, name)
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
    """Addresses of the bristles of LuGre friction among the activations, and their deflections (…, bristles).

    ``speeds`` are those of the dofs, (…, nv). A joint that moves has dragged its bristles along,
    z = g(q̇) sign(q̇) / σ₀ with Stribeck's curve g. For one that hardly moves nothing is known of them, so the sign is
    softened over a tenth of Stribeck's speed.
    """
    stiffness = model.actuator_dynprm[:, LUGRE_DYNAMICS.start]
    passive = np.flatnonzero(
        (model.actuator_actnum > 0) & is_dc_motor(model, np.arange(len(stiffness))) & (stiffness > 0)
    )
    sliding, holding, stribeck = model.actuator_biasprm[passive, LUGRE_BIAS].T
    speed = speeds[..., model.jnt_dofadr[model.actuator_trnid[passive, 0]]]
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


def has_current(model: mujoco.MjModel, actuators: np.ndarray) -> np.ndarray:
    """Of which motors the torque is a state of its own, bool, (actuators,)."""
    return (model.actuator_actnum[actuators] > 0) & (model.actuator_dynprm[actuators, DC_TIME_CONSTANT] > 0)


def has_temperature(model: mujoco.MjModel, actuators: np.ndarray) -> np.ndarray:
    """Of which motors the temperature is a state of its own, bool, (actuators,)."""
    return (model.actuator_actnum[actuators] > 0) & (model.actuator_dynprm[actuators, DC_HEAT.start] > 0)


def state_of_current(model: mujoco.MjModel, actuators: np.ndarray) -> np.ndarray:
    """Addresses of the currents of motors among the activations: MuJoCo has them last, (actuators,)."""
    return model.actuator_actadr[actuators] + model.actuator_actnum[actuators] - 1


def state_of_temperature(model: mujoco.MjModel, actuators: np.ndarray) -> np.ndarray:
    """Addresses of the temperatures of motors among the activations: first in a motor without an integrator."""
    return model.actuator_actadr[actuators]


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
        put_winding(add_push(spec, joint, filter_of(joint)), Winding(resistance, voltage_v=0.0, lag_s=1.0))


def split_joint_pd(model: mujoco.MjModel, motors: np.ndarray, dampers: np.ndarray, lag_s: np.ndarray) -> None:
    """Move the damper of each motor's joint PD to the actuator that ``add_filtered_dampers`` gave its joint.

    It follows with the time constants ``lag_s`` (motors,). The motor's limit becomes that of the joint, of the sum.
    """
    kp, kd = gains_of(model, motors)
    set_gains(model, motors, kp, np.zeros_like(kd))
    set_dc_joint_pd(model, dampers, np.zeros_like(kp), kd)
    model.actuator_dynprm[dampers, DC_TIME_CONSTANT] = lag_s
    limited = motors[model.actuator_forcelimited[motors].astype(bool)]
    joints = model.actuator_trnid[limited, 0]
    model.jnt_actfrclimited[joints] = True
    model.jnt_actfrcrange[joints] = model.actuator_forcerange[limited]
    model.actuator_forcelimited[limited] = False


@dataclass(frozen=True)
class Winding:
    """Electrical side of a motor, seen at its joint."""

    resistance: float  # V/(N·m)
    voltage_v: float  # largest voltage; 0: no limit
    lag_s: float  # electrical time constant; 0: none
    heating: float = 0.0  # growth of the resistance by heat, as a share of it, 1/(N²m²s) of the joint; 0: none
    cooling_s: float = 1.0  # time constant of the heat


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
    for actuator in others:
        spec.delete(actuator)
    if others:
        forget_removed(spec)
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
