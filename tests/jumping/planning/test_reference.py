import numpy as np
import pytest

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.problem import terrain
from leapgap.jumping.planning.reference import motion, name_of
from leapgap.jumping.task import Target, target_of
from leapgap.logs.log import read_log, write_log
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import Robot
from tests.jumping.planning.centre_of_mass import centre_of_mass
from tests.jumping.planning.conftest import PUBLISHED_COST

NAMES = sorted(PUBLISHED_COST)
BASE = ("base_pos_x", "base_pos_y", "base_pos_z")
QUATERNION = ("base_quat_w", "base_quat_x", "base_quat_y", "base_quat_z")


@pytest.fixture(scope="module")
def a1() -> Robot:
    return Robot.load()


@pytest.mark.parametrize("name", NAMES)
def test_standing_feet_stay_on_the_floor_in_the_robots_model(references, a1, name):
    jump = references[name]
    feet = feet_in_world(a1, jump.stack(BASE), jump.stack(QUATERNION), jump.per_joint("joint_pos", a1.joints))
    np.testing.assert_allclose(feet[0, :, 2], PlanarRobot().foot_radius, atol=1e-9)
    for foot, leg in enumerate(a1.feet):
        stands = jump[f"contact/{leg}"] == 1
        assert np.linalg.norm(feet[stands, foot] - feet[0, foot], axis=1).max() < 1e-3
    assert (feet[:, :, 2] > PlanarRobot().foot_radius - 5e-4).all()
    target = target_of(jump)
    np.testing.assert_allclose(feet[-1] - feet[0], np.tile([target.x_m, 0, target.z_m], (4, 1)), atol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_velocities_are_the_derivatives_of_the_positions(references, name):
    jump = references[name]
    pairs = [("base_pos_x", "base_linvel_x"), ("base_pos_z", "base_linvel_z")]
    pairs += [(f"joint_pos/{joint}", f"joint_vel/{joint}") for joint in jump.joints]
    for position, velocity in pairs:
        trapezoid = jump[position][0] + np.concatenate(
            [[0], np.cumsum(jump[velocity][:-1] + jump[velocity][1:]) * 0.0005]
        )
        np.testing.assert_allclose(jump[position], trapezoid, atol=2e-3)
    pitch = np.cumsum(jump["base_angvel_y"][:-1] + jump["base_angvel_y"][1:]) * 0.0005
    np.testing.assert_allclose(jump.pitch[1:], pitch, atol=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_newtons_law_carries_the_centre_of_mass_along_the_reference(solutions, references, name):
    """Red if the forces are held half a step late."""
    jump, robot = references[name], PlanarRobot()
    q, _ = motion(solutions[name], jump.time)
    planned = np.array([centre_of_mass(robot, row) for row in q])
    force = jump.pair_force("mpc_force")
    acceleration = (force[:, :2] + force[:, 2:]) / robot.total_mass - [0, robot.gravity]
    acceleration[:5] = 0  # the robot stands still until half a step before the first knot
    velocity = np.vstack([np.zeros(2), np.cumsum(acceleration[:-1], axis=0) * 0.001])
    travel = np.cumsum(velocity[:-1] + velocity[1:], axis=0) * 0.0005
    position = planned[0] + np.vstack([np.zeros(2), travel])
    error = np.abs(position - planned)
    assert error[:801].max() < 5e-3
    assert error.max() < 12e-3


def test_time_base_is_exact(references):
    for jump in references.values():
        assert (jump.time == np.arange(1201) / 1000).all()


def test_left_and_right_are_mirrored_and_abduction_is_zero(references):
    for jump in references.values():
        for quantity in ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"):
            for pair in "FR":
                for group in ("hip", "thigh", "calf"):
                    right, left = (jump[f"{quantity}/{pair}{side}_{group}"] for side in "RL")
                    assert (right == left).all()
                    if group == "hip" and quantity not in ("cmd_kp", "cmd_kd"):
                        assert not right.any()
        for sideways in ("base_pos_y", "base_linvel_y", "base_quat_x", "base_quat_z"):
            assert not jump[sideways].any()
        assert not jump["base_angvel_x"].any() and not jump["base_angvel_z"].any()


def test_signs_are_the_robots(references):
    jump = references["h00_d60"]
    assert jump["joint_pos/FR_thigh"][0] == pytest.approx(0.4 * np.pi)
    assert jump["joint_pos/RL_calf"][0] == pytest.approx(-0.75 * np.pi)
    assert jump.pitch.min() < -1  # nose up
    weight = PlanarRobot().total_mass * 9.81
    force = jump.pair_force("mpc_force")
    assert (force[:, [1, 3]] >= 0).all()
    assert force[0, 1] + force[0, 3] == pytest.approx(weight, rel=0.15)
    # Standing, the ground pushes up on the feet and the calves push down: J^T F of the crouch, per leg.
    assert jump["cmd_tau/RR_calf"][:790].max() > 25
    assert jump["base_pos_z"][0] == pytest.approx(0.1726, abs=1e-4)


def test_forces_end_with_the_phases(references):
    for jump in references.values():
        force = jump.pair_force("mpc_force")
        assert force[:495, 1].all() and not force[495:, :2].any()
        assert force[:795, 3].all() and not force[795:].any()


def test_box_is_touched_by_landing_feet_only():
    robot = PlanarRobot()
    (box,) = terrain(robot, Target(0.6, 0.2))
    near = box.x_m - box.size_m[0] / 2
    assert 0.171 + PlanarRobot().foot_radius < near < 0.6 - 0.195 - PlanarRobot().foot_radius
    assert box.top_m == box.size_m[2] == 0.2
    assert terrain(robot, Target(0.6, 0.0)) == ()


@pytest.mark.parametrize(
    ("x_m", "z_m", "name"),
    [
        (0.6, 0.0, "h00_d60"),
        (0.6, 0.2, "h20_d60"),
        (-0.1, 0.0, "h00_d-10"),
        (0.555, 0.0, "h00_d55.5"),
        (0.0, 0.0, "h00_d00"),
        (0.05, 0.075, "h07.5_d05"),
        (-0.055, 0.0, "h00_d-05.5"),
        (0.1 + 0.2, 0.0, "h00_d30"),
    ],
)
def test_names_are_as_published(x_m, z_m, name):
    assert name_of(Target(x_m, z_m)) == name


def test_a_reference_survives_its_file(references, tmp_path):
    jump = references["h20_d60"]
    write_log(jump, tmp_path / "h20_d60.parquet")
    again = read_log(tmp_path / "h20_d60.parquet")
    assert again.info == jump.info
    assert all((again[column] == jump[column]).all() for column in jump.columns)
