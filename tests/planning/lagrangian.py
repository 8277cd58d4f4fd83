"""The planar robot's Lagrangian equations of motion by automatic differentiation: a second opinion.

Written from the robot's geometry alone, with none of the planner's kinematics: M v̇ + C + D v − S τ + Jᵀ F.
"""

import casadi as ca

from leapgap.planning.robot import PlanarRobot


def residual(robot: PlanarRobot) -> ca.Function:
    """(q, v, a, torque, force on the ground) → generalised residual (7,) in the planner's coordinates."""
    q, v, a = ca.SX.sym("q", 7), ca.SX.sym("v", 7), ca.SX.sym("a", 7)
    torque, force = ca.SX.sym("torque", 4), ca.SX.sym("force", 4)

    def rotated(angle: ca.SX, x: float, z: float) -> ca.SX:
        return ca.vertcat(ca.cos(angle) * x + ca.sin(angle) * z, -ca.sin(angle) * x + ca.cos(angle) * z)

    bodies = [(robot.trunk_mass, robot.trunk_inertia, q[:2], q[2])]
    feet = []
    for hip_x, first in ((robot.hip_x, 3), (-robot.hip_x, 5)):
        thigh, calf = q[2] - q[first], q[2] - q[first] - q[first + 1]
        hip = q[:2] + rotated(q[2], hip_x, 0)
        knee = hip + rotated(thigh, 0, -robot.link_length)
        feet.append(knee + rotated(calf, 0, -robot.link_length))
        half = -robot.link_length / 2
        for mass, joint, angle in ((robot.thigh_mass, hip, thigh), (robot.calf_mass, knee, calf)):
            for _left_and_right in range(2):
                bodies.append((mass, robot.link_inertia(mass), joint + rotated(angle, 0, half), angle))
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
