"""Masses that move inside the trunk; the model holds their weight, but fixes them to the trunk."""

from abc import abstractmethod
from dataclasses import dataclass

import mujoco

from leapgap.effects.base import parameter, recompute_constants
from leapgap.robot.model import Robot
from leapgap.validation.off_table.base import OffTableEffect

SLOSH_HZ = 2.5
SLOSH_DAMPING_RATIO = 0.1
BATTERY_PLAY_M = 0.03
BATTERY_FRICTION = 0.15
"""Friction of the loose battery on its tray, as a share of its weight."""
GRAVITY = 9.81


@dataclass(frozen=True)
class MovingMass(OffTableEffect):
    """Part of the trunk's mass on a slide along the trunk's x axis."""

    needs_base = True

    mass_kg: float = parameter(0.0, "kg", 0.0, 3.0)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the body last, so that the indices of the robot's own bodies and joints stay."""
        body = spec.bodies[robot.base_body].add_body()
        body.name, body.pos = self.name, robot.model.body_ipos[robot.base_body]
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1e-4] * 3
        slide = body.add_joint()
        slide.name, slide.type, slide.axis = self.name, mujoco.mjtJoint.mjJNT_SLIDE, [1.0, 0.0, 0.0]
        slide.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        slide.range = [-BATTERY_PLAY_M, BATTERY_PLAY_M]

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Take the mass from the trunk and give it to the slide."""
        if self.is_nominal:
            return
        body = model.body(self.name).id
        model.body_mass[robot.base_body] -= self.mass_kg
        model.body_mass[body] = self.mass_kg
        self.mount(model, model.joint(self.name).id)
        recompute_constants(model)

    @abstractmethod
    def mount(self, model: mujoco.MjModel, joint: int) -> None:
        """Set the forces and limits that hold the mass in its place."""


@dataclass(frozen=True)
class SloshingPayload(MovingMass):
    """A half-full tank: a mass on a soft, hardly damped spring."""

    name = "sloshing_payload"

    def mount(self, model: mujoco.MjModel, joint: int) -> None:
        """Mount the mass on a spring with the natural frequency of the liquid."""
        omega = 2 * 3.141592653589793 * SLOSH_HZ
        model.jnt_stiffness[joint] = self.mass_kg * omega**2
        model.dof_damping[model.jnt_dofadr[joint]] = 2 * SLOSH_DAMPING_RATIO * self.mass_kg * omega
        model.jnt_range[joint] = [-0.12, 0.12]


@dataclass(frozen=True)
class LooseBattery(MovingMass):
    """A battery that slides in its tray, from stop to stop, against a little friction."""

    name = "loose_battery"

    def mount(self, model: mujoco.MjModel, joint: int) -> None:
        """Set the friction of the tray; its stops are the limits of the slide."""
        model.dof_frictionloss[model.jnt_dofadr[joint]] = BATTERY_FRICTION * self.mass_kg * GRAVITY
