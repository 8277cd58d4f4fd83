"""Aerodynamic drag on the trunk."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, parameter
from leapgap.effects.links import jacobians
from leapgap.robot.model import Robot

DENSITY = 1e-9
"""Of the simulated air, kg/m³: so thin that the links it is not meant for do not feel it (nor does added mass)."""
RADIUS_M = 0.1


@dataclass(frozen=True)
class AerodynamicDrag(Effect):
    """Force against the velocity of the trunk's centre of mass, −coefficient · |v| · v, in still air.

    MuJoCo's ellipsoid model of blunt drag on a massless sphere at that centre: on a sphere the force has no other
    direction than that of v, and there is no lift and no torque.
    """

    name = "aerodynamic_drag"
    needs_base = True

    coefficient: float = parameter(0.0, "N·s²/m²", 0.0, 8.0, 1.0)

    @classmethod
    def force(cls, at: ForceContext, location: str = "all") -> np.ndarray | None:
        """Against the velocity of the trunk's centre, by its square."""
        (jacobian,) = np.moveaxis(jacobians(at, [at.robot.base_body]), 1, 0)
        velocity = np.einsum("sij,sj->si", jacobian, at.qvel)
        drag = -np.linalg.norm(velocity, axis=1, keepdims=True) * velocity
        return np.einsum("si,sij->sj", drag, jacobian)[None]

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Put the sphere at the trunk's centre of mass; it touches nothing."""
        body = spec.bodies[robot.base_body]
        sphere = body.add_geom()
        sphere.name, sphere.type, sphere.size = self.name, mujoco.mjtGeom.mjGEOM_SPHERE, [RADIUS_M, 0, 0]
        sphere.pos = robot.model.body_ipos[robot.base_body]
        sphere.contype, sphere.conaffinity, sphere.mass, sphere.group = 0, 0, 0.0, 5
        sphere.fluid_ellipsoid, sphere.fluid_coefs = 1, [0.0] * 5

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set the blunt drag coefficient so that density · area · coefficient is what is asked for."""
        if self.is_nominal:
            return
        model.opt.density = DENSITY
        model.geom_fluid[model.geom(self.name).id, 1] = self.coefficient / (DENSITY * np.pi * RADIUS_M**2)
