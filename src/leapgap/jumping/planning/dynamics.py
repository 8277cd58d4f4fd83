"""Kinematics and Newton–Euler dynamics of the planar robot, for NumPy and CasADi alike.

Angles are positive nose-down, about +y of the world (x forward, z up). The planner's joint angles are *minus*
the robot's, so a link's own angle is the pitch less the joint angles up to it. Vectors are pairs (x, z).
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from leapgap.jumping.models.planar import PlanarLink, PlanarRobot

TRUNK = ("x", "z", "pitch")
JOINTS = ("front_thigh", "front_calf", "rear_thigh", "rear_calf")

# Layout of q and v: position of the trunk, its pitch, the joints of the pairs.
X, Z, PITCH = 0, 1, 2
JOINT = slice(3, 7)
COORDINATES = 7

CROUCH = np.array([-0.4, 0.75, -0.4, 0.75]) * np.pi  # Joint angles of the published crouch, rad, in the planner's sign


Scalar = Any  # A float, or a CasADi expression


@dataclass(frozen=True)
class Vector:
    """A vector in the plane of motion, world axes."""

    x: Scalar
    z: Scalar

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.z + other.z)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.z - other.z)

    def __rmul__(self, factor: Scalar) -> "Vector":
        return Vector(factor * self.x, factor * self.z)

    def moment_of(self, force: "Vector") -> Scalar:
        """Moment about +y of a force that acts at this lever arm."""
        return self.z * force.x - self.x * force.z

    def second_derivative(self, omega: Scalar, alpha: Scalar) -> "Vector":
        """Second time derivative of a link-fixed vector at angular velocity ω and acceleration α."""
        return alpha * Vector(self.z, -self.x) - omega**2 * self


@dataclass(frozen=True)
class Leg:
    """Link-fixed vectors of a leg in world axes, and its joints in the world."""

    trunk_to_hip: Vector
    hip_to_knee: Vector
    hip_to_thigh_com: Vector
    knee_to_foot: Vector
    knee_to_calf_com: Vector
    hip: Vector
    knee: Vector
    foot: Vector  # Centre of the foot's sphere
    foot_to_ground: Vector  # Vector to the contact point on the sphere
    anchor: Vector  # Point that does not move while the foot stands: its centre minus the distance it has rolled


def link_angles(q: Any) -> list[Scalar]:
    """Angles of trunk, front thigh, front calf, rear thigh, rear calf against the world, rad.

    Linear in q, so angular velocities and accelerations follow by the same function.
    """
    front_thigh, rear_thigh = q[PITCH] - q[3], q[PITCH] - q[5]
    return [q[PITCH], front_thigh, front_thigh - q[4], rear_thigh, rear_thigh - q[6]]


def legs(robot: PlanarRobot, q: Any) -> tuple[Leg, Leg]:
    """Front and rear leg at q (7,)."""
    trunk_angle, *angles = link_angles(q)
    trunk = Vector(q[X], q[Z])
    both = []
    for leg, thigh, calf in zip(robot.legs, angles[::2], angles[1::2], strict=True):
        to_hip = rotate(leg.hip_x, leg.hip_z, trunk_angle)
        to_knee, to_foot = rotate(0, -leg.thigh.length, thigh), rotate(0, -leg.calf.length, calf)
        hip = trunk + to_hip
        foot = hip + to_knee + to_foot
        radius = robot.rolling_radius_m
        coms = centre_of(leg.thigh, thigh), centre_of(leg.calf, calf)
        points = hip, hip + to_knee, foot, Vector(0.0, -radius), foot - Vector(radius * calf, 0.0)
        both.append(Leg(to_hip, to_knee, coms[0], to_foot, coms[1], *points))
    return both[0], both[1]


def rotate(x: float, z: float, angle: Scalar) -> Vector:
    """World coordinates of a link-fixed vector (x, z), for a link at an angle, nose-down, rad."""
    c, s = ca.cos(angle), ca.sin(angle)
    return Vector(x * c + z * s, z * c - x * s)


def centre_of(link: PlanarLink, angle: Scalar) -> Vector:
    """Vector from a link's upper joint to its centre of mass, world axes."""
    return rotate(link.com_across, -link.com_down, angle)


def inverse_dynamics_residual(robot: PlanarRobot, q: Any, v: Any, a: Any, torque: Any, force: Any) -> list[Scalar]:
    """Newton–Euler balances, zero where the robot moves by its dynamics.

    Shapes: q, v, a (7,); ``torque`` (4,) N·m of the joint pairs, positive with the planner's joint angles;
    ``force`` (4,) N of the feet *on the ground*, front x z, rear x z. Returned: the force balance of the
    whole robot (x, z; N), then the moment balances of trunk, front thigh, front calf, rear thigh, rear calf
    (N·m). They are M a + C + D v − S τ + Jᵀ F written in link angles: with link angles = A q[2:], Aᵀ times
    the moments gives the rows of the Lagrangian form in q. Sparser than that form, hence faster to factorise.
    """
    against_gravity = Vector(a[X], a[Z] + robot.gravity)
    omegas, alphas = link_angles(v), link_angles(a)
    trunk_to_com = rotate(robot.trunk_com_x, robot.trunk_com_z, q[PITCH])
    total = robot.trunk_mass * (against_gravity + trunk_to_com.second_derivative(omegas[0], alphas[0]))
    trunk_moment = robot.trunk_inertia * alphas[0] + trunk_to_com.moment_of(total)
    leg_moments: list[Scalar] = []
    for i, (leg, of) in enumerate(zip(legs(robot, q), robot.legs, strict=True)):
        thigh, calf = 1 + 2 * i, 2 + 2 * i
        hip_drive, knee_drive = (
            torque[j] - robot.armature * a[3 + j] - robot.damping * v[3 + j] for j in (2 * i, 2 * i + 1)
        )
        at_hip = against_gravity + leg.trunk_to_hip.second_derivative(omegas[0], alphas[0])
        at_knee = at_hip + leg.hip_to_knee.second_derivative(omegas[thigh], alphas[thigh])
        at_thigh = at_hip + leg.hip_to_thigh_com.second_derivative(omegas[thigh], alphas[thigh])
        at_calf = at_knee + leg.knee_to_calf_com.second_derivative(omegas[calf], alphas[calf])
        on_ground = Vector(force[2 * i], force[2 * i + 1])
        calf_inertial = (2 * of.calf.mass) * at_calf
        thigh_inertial = (2 * of.thigh.mass) * at_thigh
        knee_force = calf_inertial + on_ground
        hip_force = thigh_inertial + knee_force
        calf_moment = (
            2 * of.calf.inertia * alphas[calf]
            + knee_drive
            + leg.knee_to_calf_com.moment_of(calf_inertial)
            + (leg.knee_to_foot + leg.foot_to_ground).moment_of(on_ground)
        )
        thigh_moment = (
            2 * of.thigh.inertia * alphas[thigh]
            + hip_drive
            - knee_drive
            + leg.hip_to_thigh_com.moment_of(thigh_inertial)
            + leg.hip_to_knee.moment_of(knee_force)
        )
        leg_moments += [thigh_moment, calf_moment]
        trunk_moment = trunk_moment - hip_drive + leg.trunk_to_hip.moment_of(hip_force)
        total = total + hip_force
    return [total.x, total.z, trunk_moment, *leg_moments]
