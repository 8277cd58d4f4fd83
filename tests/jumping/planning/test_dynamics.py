import numpy as np
import pytest

from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.planning.dynamics import CROUCH, inverse_dynamics_residual, legs
from leapgap.robot.model import Robot
from tests.jumping.planning.centre_of_mass import centre_of_mass
from tests.jumping.planning.lagrangian import residual

# Link angles (trunk, front thigh, front calf, rear thigh, rear calf) by pitch and joints.
LINK_ANGLES = np.array(
    [
        [1, 0, 0, 0, 0],
        [1, -1, 0, 0, 0],
        [1, -1, -1, 0, 0],
        [1, 0, 0, -1, 0],
        [1, 0, 0, -1, -1],
    ]
)


@pytest.mark.parametrize("robot", [PlanarRobot(), planar_robot(Robot.load())], ids=["published", "own"])
def test_newton_euler_balances_are_the_lagrangian_ones(rng, robot):
    lagrangian = residual(robot)
    for _ in range(20):
        q, v, a = rng.normal(size=(3, 7)) * [[1.0], [5.0], [50.0]]
        torque, force = rng.normal(size=(2, 4)) * [[30.0], [100.0]]
        ours = np.array([float(r) for r in inverse_dynamics_residual(robot, q, v, a, torque, force)])
        generalised = np.concatenate([ours[:2], LINK_ANGLES.T @ ours[2:]])
        expected = np.array(lagrangian(q, v, a, torque, force)).ravel()
        np.testing.assert_allclose(generalised, expected, atol=1e-9)


def test_masses_and_inertia_are_the_published_ones():
    robot = PlanarRobot()
    assert robot.total_mass == pytest.approx(11.869)
    assert robot.trunk_inertia == pytest.approx(0.117476, abs=5e-7)
    assert robot.front.thigh.inertia == pytest.approx(0.0016276, abs=5e-8)
    assert robot.rear.calf.inertia == pytest.approx(0.00067042, abs=5e-9)


def test_feet_in_the_crouch_are_where_they_were_published():
    robot = PlanarRobot()
    front, rear = legs(robot, np.array([0, 0, 0, *CROUCH]))
    for leg, hip_x in ((front, 0.183), (rear, -0.183)):
        assert float(leg.foot.x) - hip_x == pytest.approx(-0.01201, abs=5e-6)
        assert float(leg.foot.z) == pytest.approx(-0.152601, abs=5e-7)


def test_centre_of_mass_moves_with_gravity_and_ground_force_only(rng):
    robot = PlanarRobot()
    q, v = rng.normal(size=(2, 7))
    # In free fall without joint torques or damping nothing but gravity acts: solve for the acceleration.
    loose = PlanarRobot(damping=0.0, armature=0.0)
    trials = np.vstack([np.zeros(7), np.eye(7)])
    at = [inverse_dynamics_residual(loose, q, v, a, np.zeros(4), np.zeros(4)) for a in trials]
    rows = np.array([[float(value) for value in row] for row in at])
    a = np.linalg.solve((rows[1:] - rows[0]).T, -rows[0])
    h = 1e-4
    path = [centre_of_mass(robot, q + t * v + t**2 / 2 * a) for t in (-h, 0, h)]
    np.testing.assert_allclose((path[0] - 2 * path[1] + path[2]) / h**2, [0, -9.81], atol=1e-4)
