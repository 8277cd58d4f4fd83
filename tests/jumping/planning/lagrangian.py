"""The planar robot's Lagrangian equations of motion by automatic differentiation: a second opinion.

Written from the robot's geometry alone, with none of the planner's kinematics: M v̇ + C + D v − S τ + Jᵀ F.
"""

import casadi as ca

from leapgap.jumping.models.planar import PlanarRobot


def residual(robot: PlanarRobot) -> ca.Function:
    """(q, v, a, torque, force on the ground) → generalised residual (7,) in the planner's coordinates."""
    q, v, a = ca.SX.sym("q", 7), ca.SX.sym("v", 7), ca.SX.sym("a", 7)
    torque, force = ca.SX.sym("torque", 4), ca.SX.sym("force", 4)

    def rotate(angle: ca.SX, x: float, z: float) -> ca.SX:
        return ca.vertcat(ca.cos(angle) * x + ca.sin(angle) * z, -ca.sin(angle) * x + ca.cos(angle) * z)

    trunk_com = q[:2] + rotate(q[2], robot.trunk_com_x, robot.trunk_com_z)
    bodies = [(robot.trunk_mass, robot.trunk_inertia, trunk_com, q[2])]
    feet = []
    for leg, first in ((robot.front, 3), (robot.rear, 5)):
        thigh, calf = q[2] - q[first], q[2] - q[first] - q[first + 1]
        hip = q[:2] + rotate(q[2], leg.hip_x, leg.hip_z)
        knee = hip + rotate(thigh, 0, -leg.thigh.length)
        rolled = ca.vertcat(robot.rolling_radius_m * calf, 0)  # the ground holds the lowest point of the sphere
        feet.append(knee + rotate(calf, 0, -leg.calf.length) - rolled)
        for link, joint, angle in ((leg.thigh, hip, thigh), (leg.calf, knee, calf)):
            for _left_and_right in range(2):
                centre = joint + rotate(angle, link.com_across, -link.com_down)
                bodies.append((link.mass, link.inertia, centre, angle))
    kinetic = robot.armature * ca.sumsqr(v[3:]) / 2
    potential = ca.SX(0)
    for mass, inertia, position, angle in bodies:
        velocity, spin = ca.jtimes(position, q, v), ca.jtimes(angle, q, v)
        kinetic += mass * ca.sumsqr(velocity) / 2 + inertia * spin**2 / 2
        potential += mass * robot.gravity * position[1]
    momentum = ca.gradient(kinetic, v)
    inertial = ca.jtimes(momentum, v, a) + ca.jtimes(momentum, q, v) - ca.gradient(kinetic, q)
    damping = ca.vertcat(ca.SX.zeros(3), robot.damping * v[3:])
    drive = ca.vertcat(ca.SX.zeros(3), torque)
    ground = ca.jtimes(ca.vertcat(*feet), q, force, True)
    balance = inertial + ca.gradient(potential, q) + damping - drive + ground
    return ca.Function("lagrangian", [q, v, a, torque, force], [balance])
