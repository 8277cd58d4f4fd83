"""Shape of the robot: drag of its trunk, and lengths in its legs."""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.effects.base import Effect, ForceContext, parameter, recompute_constants
from leapgap.effects.bodies import jacobians
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
    words = "aerodynamic drag on the trunk"
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


@dataclass(frozen=True)
class LegGeometry(Effect):
    """Extra distance of the hips from the middle of the base, and extra length of the legs' last two links.

    Each leg is fixed ``hip_x_m`` further away from the base's origin along its x axis. ``upper_m`` and ``lower_m``
    lengthen the link above the last joint, and the link below it that ends in the foot. Masses and their places in the
    links stay.
    """

    name = "leg_geometry"
    words = "leg geometry error"
    needs_base = True

    hip_x_m: float = parameter(0.0, "m", -0.03, 0.03, 0.005)
    upper_m: float = parameter(0.0, "m", -0.03, 0.03, 0.005)
    lower_m: float = parameter(0.0, "m", -0.03, 0.03, 0.005)

    @classmethod
    def lacks(cls, robot: Robot) -> str | None:
        """A base that floats, and feet on limbs of two joints or more."""
        return super().lacks(robot) or (None if legs_of(robot) else "legs with two joints or more and feet")

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the first bodies of the legs, the bodies of their last joints, and all shapes and sites at the feet."""
        if self.is_nominal:
            return
        for first, last, foot in legs_of(robot):
            model.body_pos[first, 0] += self.hip_x_m * np.sign(model.body_pos[first, 0])
            model.body_pos[last] += self.upper_m * direction(model.body_pos[last])
            lengthen(model, last, model.geom(robot.foot_geom_names[foot]).id, self.lower_m)
        recompute_constants(model)


def legs_of(robot: Robot) -> list[tuple[int, int, int]]:
    """First body, body of the last joint, and index of the foot, of each leg with two joints or more."""
    found, parts = [], robot.topology
    for limb, feet in parts.feet_of_limb.items():
        joints = parts.limbs[limb]
        if len(joints) > 1:
            first, last = (int(robot.joint_bodies[robot.joints.index(joint)]) for joint in (joints[0], joints[-1]))
            found += [(first, last, robot.feet.index(foot)) for foot in feet]
    return found


def lengthen(model: mujoco.MjModel, last: int, geom: int, by: float) -> None:
    """Move a foot's geom, and what lies at its centre, away from the joint of the last body.

    A foot that is a body of its own, fixed to the last one, is moved whole.
    """
    body = int(model.geom_bodyid[geom])
    if body != last:
        down = model.body_pos[body] if np.any(model.body_pos[body]) else model.geom_pos[geom]
        moved = by * direction(down)
        model.body_pos[body] += moved
        if model.body_mass[body] == 0:  # MuJoCo puts the centre of a body without mass where the body is
            model.body_ipos[body] += moved
        return
    centre = model.geom_pos[geom].copy()
    for owner, positions in ((model.geom_bodyid, model.geom_pos), (model.site_bodyid, model.site_pos)):
        there = (owner == body) & np.isclose(positions, centre, atol=1e-9).all(axis=1)
        positions[there] += by * direction(centre)


def direction(offset: np.ndarray) -> np.ndarray:
    """Unit vector of an offset (3,); down the leg, −z, where there is none."""
    length = np.linalg.norm(offset)
    return np.asarray(offset / length) if length > 0 else np.array([0.0, 0.0, -1.0])
