"""The numbers of a corrected robot, as JSON and as settings of other simulators."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from leapgap.effects import describe
from leapgap.effects.base import Effect
from leapgap.effects.command_delay import CommandDelay
from leapgap.effects.drive import Drive
from leapgap.effects.encoder_bias import EncoderBias
from leapgap.robot.model import Robot
from leapgap.simulation.corrected_model import Placement

Gains = Mapping[str, tuple[float, float]]
"""Joint → kp and kd of its joint PD, N·m/rad and N·m·s/rad."""


def parameters(robot: Robot, placed: Sequence[Placement]) -> dict[str, Any]:
    """What ``parameters.json`` holds: effects with their values, joints, changed bodies and feet, SI units."""
    correction = [one.effect for one in placed]
    nominal = robot.model
    corrected = copy.copy(nominal)
    in_model = [effect for effect in correction if effect.structure is None]  # others add parts to the model
    for effect in in_model:
        effect.change_model(corrected, robot)
    return {
        "robot": robot.name,
        "robot_sha256": robot.sha256,
        "units": "SI: N·m, rad, kg, m, s, V; joints that slide: N, m",
        "effects": [effect_entry(one, robot) for one in placed],
        "joints": joint_entries(robot, correction, nominal, corrected),
        "bodies": body_entries(robot, nominal, corrected),
        "feet": foot_entries(robot, nominal, corrected),
    }


def effect_entry(placed: Placement, robot: Robot) -> dict[str, Any]:
    """One effect: where it acts, its values and nominal values, and whether the model holds all of it."""
    effect = placed.effect
    values = {
        one.name: {"value": effect.values.get(one.name, one.nominal), "nominal": one.nominal, "unit": one.unit}
        for one in effect.parameters(robot, effect.location)
    }
    at = {"joints": robot.topology.joints_at, "feet": robot.topology.feet_at}.get(effect.places)
    return {
        "name": effect.name,
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
    count = len(robot.joints)
    drive = Drive.ideal(count)
    delay, bias = np.zeros(count), np.zeros(count)
    for effect in correction:
        drive = effect.change_drive(drive, robot)
        if isinstance(effect, CommandDelay):
            delay[robot.joints_at(effect.location)] += effect.delay_s
        if isinstance(effect, EncoderBias):
            bias[robot.joints_at(effect.location)] += effect.bias_rad
    entries = {}
    for i, joint in enumerate(robot.joints):
        dof, limit = robot.joint_dofs[i], robot.torque_limits[i]
        entries[joint] = {
            "damping": pair(nominal.dof_damping[dof], corrected.dof_damping[dof]),
            "friction": pair(nominal.dof_frictionloss[dof], corrected.dof_frictionloss[dof]),
            "armature": pair(nominal.dof_armature[dof], corrected.dof_armature[dof]),
            "torque_limit": pair(limit, limit * drive.gain[i]),
            "torque_gain": pair(1.0, drive.gain[i]),
            "motor_lag_s": pair(0.0, drive.lag_s[i]),
            "motor_voltage_v": pair(np.inf, drive.voltage_v[i]),
            "motor_heating_per_n2m2s": pair(0.0, drive.heating[i]),
            "command_delay_s": pair(0.0, delay[i]),
            "encoder_bias_rad": pair(0.0, bias[i]),
        }
    return entries


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


def urdf_dynamics(found: Mapping[str, Any]) -> str:
    """The element ``dynamics`` of each joint for a URDF: its damping and its friction."""
    root = ElementTree.Element("robot", {"name": found["robot"]})
    for joint, of in found["joints"].items():
        element = ElementTree.SubElement(root, "joint", {"name": joint})
        numbers = {key: f"{of[key]['corrected']:.9g}" for key in ("damping", "friction")}
        ElementTree.SubElement(element, "dynamics", numbers)
    ElementTree.indent(root)
    return "<!-- The element dynamics of each joint of the corrected robot, to copy into a URDF. -->\n" + (
        ElementTree.tostring(root, encoding="unicode") + "\n"
    )


def isaac_actuators(found: Mapping[str, Any], gains: Gains) -> dict[str, Any]:
    """Settings of each joint as the actuator models of Isaac Lab and similar simulators name them, by joint.

    ``stiffness`` and ``damping`` are the gains of the joint PD, null where no log says them. ``friction`` is a torque,
    N·m; ``delay_s`` a time.
    """
    settings = {}
    for joint, of in found["joints"].items():
        kp, kd = gains.get(joint, (None, None))
        settings[joint] = {
            "stiffness": None if kp is None else kp * of["torque_gain"]["corrected"],
            "damping": None if kd is None else kd * of["torque_gain"]["corrected"],
            "effort_limit": of["torque_limit"]["corrected"],
            "armature": of["armature"]["corrected"],
            "friction": of["friction"]["corrected"],
            "viscous_friction": of["damping"]["corrected"],
            "delay_s": of["command_delay_s"]["corrected"],
        }
    return settings
