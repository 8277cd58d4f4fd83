"""A corrected robot as one MuJoCo model with the actuators of its makers, for simulators that know no effects of ours.

Masses, joints, contacts, geometry and motors are written into the model. What acts on the commands before they reach
the model, on measurements or on the clock cannot be: of those effects it is said why.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from leapgap.effects import describe
from leapgap.effects.base import Effect, overrides
from leapgap.effects.commands import CommandDelay
from leapgap.effects.drive import COOLING_S, Drive
from leapgap.effects.measurements import EncoderBias
from leapgap.robot import dc_motors
from leapgap.robot.model import Robot
from leapgap.robot.model_file import keep_inertia_changeable
from leapgap.robot.topology import name_contacts

OUTSIDE = {
    **dict.fromkeys(("change_period", "change_rows", "change_step"), "it is of the clock, not of the robot"),
    **dict.fromkeys(("change_measured", "true_start"), "it is of the measurements, not of the motion"),
    **dict.fromkeys(("change_commands", "torque_by_velocity"), "it changes commands before they reach the model"),
    "put_controls": "it needs an actuator whose torque is set at each step",
}
"""Methods of an effect through which it acts outside the model, and why no model has that."""
IN_CONTROLLER = "it is in the joint PD, which is of the program that sends commands"
ACTUATORS = ("actuator_gainprm", "actuator_biasprm", "actuator_dynprm", "actuator_forcerange", "actuator_ctrlrange")
"""Fields of a model that motors are changed by, which effects do through their drive."""


@dataclass(frozen=True)
class Placement:
    """Where an effect of a correction is: in the corrected model, or in the file of effects alone."""

    effect: Effect
    in_model: bool  # whether the model has some of it
    lacks: str = ""  # why the model lacks it, or a part of it; empty where it has all of it


def corrected_spec(robot: Robot, correction: Sequence[Effect]) -> tuple[mujoco.MjSpec, tuple[Placement, ...]]:
    """The robot's model with the effects in it, and where each effect is."""
    spec = robot.published_spec() if robot.states_actuators else robot.spec()
    dc_motors.move_to_joints(spec, robot.actuators)
    name_contacts(spec, robot.names.feet if robot.names else ())
    inside = [effect for effect in correction if changes_model(effect) and not overrides(type(effect), "put_controls")]
    changed = with_effects(inside, spec, robot)
    refused: dict[int, str] = {}
    if isinstance(changed, str):  # then one by one, to name those that a model cannot hold
        changed = spec
        for effect in inside:
            more = with_effects([effect], changed, robot)
            if isinstance(more, str):
                refused[id(effect)] = more
            else:
                changed = more
    spec = changed
    drive = Drive.ideal(len(robot.joints))
    for effect in correction:
        drive = effect.change_drive(drive, robot)
    # Put motors into the specification: a gain scales its actuators, a limit of voltage or a lag needs DC motors
    resistance = drive.resistances(robot)
    voltage = np.where(np.isfinite(drive.voltage_v), drive.voltage_v, 0.0)
    for i, motor in enumerate(robot.actuators):
        if not motor.driven:
            continue
        gain = float(drive.gain[i])
        if gain != 1:
            dc_motors.scale_joint(spec, motor.joint, gain)
        if (limit := float(drive.limit_scale[i])) != 1:
            dc_motors.scale_limit(spec, motor.joint, limit)
            motor = replace(motor, limit=(limit * motor.limit[0], limit * motor.limit[1]))
        if drive.electric[i]:
            electric = (resistance[i], voltage[i], drive.lag_s[i], drive.heating[i], COOLING_S)
            winding = dc_motors.Winding(*(float(number) for number in electric))
            dc_motors.replace_by_dc_motor(spec, motor, gain, winding)
    if spec.option.density > 0:
        spec.option.integrator = mujoco.mjtIntegrator(robot.model.opt.integrator)  # they integrate drag differently
    return spec, tuple(placement(effect, robot, refused.get(id(effect), "")) for effect in correction)


def placement(effect: Effect, robot: Robot, refused: str) -> Placement:
    """Where an effect is, by why a model cannot hold what it changes there; empty where it can."""
    inside = changes_model(effect) and not overrides(type(effect), "put_controls") and not refused
    motors = effect.change_drive(Drive.ideal(len(robot.joints)), robot)
    motors_change = bool((motors.electric | (motors.gain != 1) | (motors.limit_scale != 1)).any())
    return Placement(effect, not effect.in_controller and (inside or motors_change), refused or outside(effect))


def outside(effect: Effect) -> str:
    """Why some of what an effect does is outside of any model; empty where nothing is."""
    if effect.in_controller:
        return IN_CONTROLLER
    return next((why for method, why in OUTSIDE.items() if overrides(type(effect), method)), "")


def changes_model(effect: Effect) -> bool:
    """Whether an effect changes the model otherwise than by its motors."""
    return overrides(type(effect), "change_model") or overrides(type(effect), "change_spec")


def with_effects(inside: Sequence[Effect], spec: mujoco.MjSpec, robot: Robot) -> mujoco.MjSpec | str:
    """The specification with what effects change of the model, motors aside; why, where it cannot hold that.

    The effects change a compiled model as in a replay, and MuJoCo writes the changed values back.
    """
    if not inside:
        return spec
    changed = spec.copy()
    for effect in inside:
        if effect.structure is not None and type(effect).change_drive is Effect.change_drive:
            effect.change_spec(changed, robot)
    own = {body.name: body.simple for body in changed.bodies}
    keep_inertia_changeable(changed)
    model = changed.compile()
    for body in changed.bodies:  # compilation joins bodies without joints
        body.simple = own[body.name]
    if any(effect.structure is not None for effect in inside) and model.nq != spec.copy().compile().nq:
        return "it needs a joint that the model of the makers does not have"
    makers = [getattr(model, name).copy() for name in ACTUATORS]
    for effect in inside:
        effect.change_model(model, robot)
    if any(not np.array_equal(own, getattr(model, name)) for own, name in zip(makers, ACTUATORS, strict=True)):
        return "it changes actuators as leapgap has them, and these are the makers'"
    try:
        changed.copy_back(model)
        changed.copy().compile()
    except ValueError as error:
        return f"MuJoCo does not compile a model with it: {' '.join(str(error).split())}"
    for body in changed.bodies:  # MuJoCo does not write these back
        body.gravcomp = float(model.body_gravcomp[body.id])
    for geom in changed.geoms:
        geom.priority, geom.condim = int(model.geom_priority[geom.id]), int(model.geom_condim[geom.id])
        if geom.fluid_ellipsoid:
            geom.fluid_coefs = model.geom_fluid[geom.id, 1:6]
    return changed


def parameters(robot: Robot, placed: Sequence[Placement]) -> dict[str, Any]:
    """What ``parameters.json`` holds: effects with their values, joints, changed bodies and feet, SI units."""
    correction = [one.effect for one in placed]
    nominal = robot.model
    corrected = changed_model(nominal, robot, correction)
    before, after = joint_numbers(robot, (), nominal), joint_numbers(robot, correction, corrected)
    # Mass, centre of mass and inertia of the bodies whose numbers differ
    fields = {"mass_kg": "body_mass", "com_m": "body_ipos", "inertia_kgm2": "body_inertia"}
    names = [nominal.body(body).name or f"body_{body}" for body in robot.bodies]
    # Contact parameters of the feet whose numbers differ: friction, and MuJoCo's solref and solimp
    of_feet = {"friction": "geom_friction", "solref": "geom_solref", "solimp": "geom_solimp"}
    feet = dict(zip(robot.feet, robot.foot_geoms.tolist(), strict=True))
    return {
        "robot": robot.name,
        "robot_sha256": robot.sha256,
        "units": "SI: N·m, rad, kg, m, s, V; joints that slide: N, m",
        "effects": [effect_entry(one, robot) for one in placed],
        "joints": {
            joint: {key: pair(before[key][i], after[key][i]) for key in before} for i, joint in enumerate(robot.joints)
        },
        "bodies": changed_rows(nominal, corrected, dict(zip(names, robot.bodies, strict=True)), fields),
        "feet": changed_rows(nominal, corrected, feet, of_feet),
    }


def changed_model(nominal: mujoco.MjModel, robot: Robot, correction: Sequence[Effect]) -> mujoco.MjModel:
    """A copy of a model with the effects that add no parts to it."""
    changed = copy.copy(nominal)
    for effect in correction:
        if effect.structure is None:
            effect.change_model(changed, robot)
    return changed


def effect_entry(placed: Placement, robot: Robot) -> dict[str, Any]:
    """One effect: where it acts, its values and nominal values, and whether the model holds all of it."""
    effect = placed.effect
    values = {
        one.name: {"value": effect.values.get(one.name, one.nominal), "nominal": one.nominal, "unit": one.unit}
        for one in effect.parameters(robot, effect.location)
    }
    at = {"joints": robot.topology.joints_at, "feet": robot.topology.feet_at}.get(effect.places)
    return {
        "name": effect.called(robot),
        "what": describe(type(effect)),
        "location": effect.location,
        "at": list(at(effect.location)) if at else [],
        "parameters": values,
        "in_model": placed.in_model and not placed.lacks,
        "in_model_in_part": placed.in_model and bool(placed.lacks),
        "lacks": placed.lacks,
    }


def joint_numbers(robot: Robot, correction: Sequence[Effect], model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Numbers of the joints of a robot with some effects, (joints,) each; ``model`` has the effects already."""
    count, dofs = len(robot.joints), robot.joint_dofs
    drive = Drive.ideal(count)
    delay, bias = np.zeros(count), np.zeros(count)
    for effect in correction:
        drive = effect.change_drive(drive, robot)
        if type(effect) is CommandDelay:
            delay[robot.joints_at(effect.location)] += effect.delay_s
        if isinstance(effect, EncoderBias):
            bias[robot.joints_at(effect.location)] += effect.bias_rad
    return {
        "damping": model.dof_damping[dofs],
        "friction": model.dof_frictionloss[dofs],
        "armature": model.dof_armature[dofs],
        "torque_limit": robot.torque_limits * drive.limit_scale * drive.gain,
        "torque_gain": drive.gain,
        "position_gain": drive.kp_scale,
        "velocity_gain": drive.kd_scale,
        "motor_lag_s": drive.lag_s,
        "motor_voltage_v": drive.voltage_v,
        "motor_heating_per_n2m2s": drive.heating,
        "command_delay_s": delay,
        "encoder_bias_rad": bias,
    }


def changed_rows(
    nominal: mujoco.MjModel, corrected: mujoco.MjModel, rows: Mapping[str, int], fields: Mapping[str, str]
) -> dict[str, Any]:
    """Values of some fields of two models (our name → MuJoCo's) at the rows, by name, where any of them differs."""
    entries = {}
    for name, row in rows.items():
        both = {key: (getattr(nominal, field)[row], getattr(corrected, field)[row]) for key, field in fields.items()}
        if any(not np.array_equal(*values) for values in both.values()):
            entries[name] = {key: pair(*values) for key, values in both.items()}
    return entries


def pair(nominal: Any, corrected: Any) -> dict[str, Any]:
    """A number or vector of the nominal and of the corrected robot; what is infinite is None."""
    return {"nominal": plain(nominal), "corrected": plain(corrected)}


def plain(value: Any) -> Any:
    """A NumPy number or vector as JSON has it."""
    values = [float(one) if np.isfinite(one) else None for one in np.ravel(value)]
    return values if np.ndim(value) else values[0]
