"""The planar robot the optimiser plans for: five links, the left and right leg of a pair merged into one."""

from dataclasses import dataclass

import numpy as np

TRUNK = ("x", "z", "pitch")
JOINTS = ("front_thigh", "front_calf", "rear_thigh", "rear_calf")

# Layout of q and v: position of the trunk, its pitch, the joints of the pairs.
X, Z, PITCH = 0, 1, 2
JOINT = slice(3, 7)
COORDINATES = 7

# Layout of a force row: front x z, rear x z.
FORCES = ("front_x", "front_z", "rear_x", "rear_z")


@dataclass(frozen=True)
class PlanarRobot:
    """Parameters of the planar A1; the defaults are those of the published full-body optimiser.

    Source: model behind the published references (Nguyen et al., RA-L 2025, and the group's earlier
    jumping papers); voltage law and gearing: motor data published by the same group. Masses and inertias
    are of one leg, the dynamics take each leg twice.
    """

    trunk_mass: float = 9.593
    """kg; centre of mass on the line through the hips."""
    thigh_mass: float = 0.403
    """kg, one leg; centre of mass mid-link."""
    calf_mass: float = 0.166
    """kg, one leg with its foot; centre of mass mid-link."""
    trunk_length: float = 0.366
    """m, from hip to hip; also the box the trunk's inertia is taken of."""
    trunk_height: float = 0.114
    """m, of that box."""
    link_length: float = 0.2
    """m, hip to knee and knee to foot."""
    link_width: float = 0.092
    """m, of the boxes the links' inertias are taken of."""
    armature: float = 0.128
    """kg·m², inertia of the motors of a pair of joints, seen at the joint."""
    damping: float = 1.0
    """N·m·s/rad, viscous, of a pair of joints."""
    gravity: float = 9.81
    """m/s²."""
    speed_per_torque: float = 0.34602
    """rad/s per N·m at one joint: R / (Kt² gear²) × Kt gear for Kt 4/34, R = 25 Kt², gear 8.5."""
    no_load_speed: float = 21.5
    """rad/s at 21.5 V, since gear × Kt = 1."""

    @property
    def hip_x(self) -> float:
        """Distance of the front (and, negative, rear) hips from the trunk's centre, m."""
        return self.trunk_length / 2

    @property
    def trunk_inertia(self) -> float:
        """Of a uniform box about its centre, kg·m²."""
        return self.trunk_mass * (self.trunk_length**2 + self.trunk_height**2) / 12

    def link_inertia(self, mass: float) -> float:
        """Of a uniform box with the links' edges about its centre, kg·m²."""
        return mass * (self.link_length**2 + self.link_width**2) / 12

    @property
    def total_mass(self) -> float:
        """Of trunk and four legs, kg."""
        return self.trunk_mass + 4 * (self.thigh_mass + self.calf_mass)

    @property
    def crouch(self) -> np.ndarray:
        """Joint angles the published jumps start and end with, rad, (4,), in the planner's sign."""
        return np.array([-0.4, 0.75, -0.4, 0.75]) * np.pi
