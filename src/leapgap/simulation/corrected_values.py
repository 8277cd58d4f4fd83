"""The numbers of a corrected robot, as JSON."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from leapgap.effects import describe
from leapgap.effects.base import Effect
from leapgap.effects.commands import CommandDelay
from leapgap.effects.drive import Drive
from leapgap.effects.measurements import EncoderBias
from leapgap.robot.model import Robot
from leapgap.simulation.corrected_model import Placement


def parameters(robot: Robot, placed: Sequence[Placement]) -> dict[str, Any]:
    """What ``parameters.json`` holds: effects with their values, joints, changed bodies and feet, SI units."""
    correction = [one.effect for one in placed]
    nominal = robot.model
    corrected = changed_model(nominal, robot, correction)
    return {
        "robot": robot.name,
        "robot_sha256": robot.sha256,
        "units": "SI: N·m, rad, kg, m, s, V; joints that slide: N, m",
        "effects": [effect_entry(one, robot) for one in placed],
        "joints": joint_entries(robot, correction, nominal, corrected),
        "bodies": body_entries(robot, nominal, corrected),
        "feet": foot_entries(robot, nominal, corrected),
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


def joint_entries(
    robot: Robot, correction: Sequence[Effect], nominal: mujoco.MjModel, corrected: mujoco.MjModel
) -> dict[str, Any]:
    """Numbers of each joint: its friction, inertia and motor, and what acts between command and joint."""
    before, after = joint_numbers(robot, (), nominal), joint_numbers(robot, correction, corrected)
    return {joint: {key: pair(before[key][i], after[key][i]) for key in before} for i, joint in enumerate(robot.joints)}


def joint_numbers(robot: Robot, correction: Sequence[Effect], model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Numbers of the joints of a robot with some effects, (joints,) each; ``model`` has the effects already."""
    count, dofs = len(robot.joints), robot.joint_dofs
    drive = Drive.ideal(count)
    delay, bias = np.zeros(count), np.zeros(count)
    for effect in correction:
        drive = effect.change_drive(drive, robot)
        if isinstance(effect, CommandDelay):
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


def body_entries(robot: Robot, nominal: mujoco.MjModel, corrected: mujoco.MjModel) -> dict[str, Any]:
    """Mass, centre of mass and inertia of the bodies whose numbers differ."""
    fields = {"mass_kg": "body_mass", "com_m": "body_ipos", "inertia_kgm2": "body_inertia"}
    names = [nominal.body(body).name or f"body_{body}" for body in robot.bodies]
    return changed_rows(nominal, corrected, dict(zip(names, robot.bodies, strict=True)), fields)


def foot_entries(robot: Robot, nominal: mujoco.MjModel, corrected: mujoco.MjModel) -> dict[str, Any]:
    """Contact parameters of the feet whose numbers differ: friction, and MuJoCo's solref and solimp."""
    fields = {"friction": "geom_friction", "solref": "geom_solref", "solimp": "geom_solimp"}
    return changed_rows(nominal, corrected, dict(zip(robot.feet, robot.foot_geoms.tolist(), strict=True)), fields)


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
