"""A corrected robot as one MuJoCo model with the actuators of its makers, for simulators that know no effects of ours.

Masses, joints, contacts, geometry and motors are written into the model. What acts on the commands before they reach
the model, on measurements or on the clock cannot be: of those effects it is said why.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Effect, overrides
from leapgap.effects.drive import COOLING_S, Drive
from leapgap.robot import dc_motors, makers_actuators
from leapgap.robot.feet import name_contacts
from leapgap.robot.model import Robot
from leapgap.robot.model_file import keep_inertia_changeable

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
    in_model: bool
    """Whether the model has some of it."""
    lacks: str = ""
    """Why the model lacks it, or a part of it; empty where it has all of it."""


def corrected_spec(robot: Robot, correction: Sequence[Effect]) -> tuple[mujoco.MjSpec, tuple[Placement, ...]]:
    """The robot's model with the effects in it, and where each effect is."""
    spec = robot.published_spec() if robot.states_actuators else robot.spec()
    makers_actuators.move_to_joints(spec, robot.actuators)
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
    put_drive(drive, spec, robot)
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


def put_drive(drive: Drive, spec: mujoco.MjSpec, robot: Robot) -> None:
    """Put motors into the specification: a gain scales its actuators, a limit of voltage or a lag needs DC motors."""
    resistance = drive.resistances(robot)
    voltage = np.where(np.isfinite(drive.voltage_v), drive.voltage_v, 0.0)
    for i, motor in enumerate(robot.actuators):
        if not motor.driven:
            continue
        gain = float(drive.gain[i])
        if gain != 1:
            makers_actuators.scale_joint(spec, motor.joint, gain)
        if (limit := float(drive.limit_scale[i])) != 1:
            makers_actuators.scale_limit(spec, motor.joint, limit)
            motor = replace(motor, limit=(limit * motor.limit[0], limit * motor.limit[1]))
        if drive.electric[i]:
            electric = (resistance[i], voltage[i], drive.lag_s[i], drive.heating[i], COOLING_S)
            winding = dc_motors.Winding(*(float(number) for number in electric))
            makers_actuators.replace_by_dc_motor(spec, motor, gain, winding)
