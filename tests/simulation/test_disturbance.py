"""Kicks and pushes: momentum and velocity change as mechanics demands, when and only when they act."""

import copy

import mujoco
import numpy as np
import pytest

from leapgap.logs.log import Log
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot
from leapgap.simulation.closed_loop import Disturbance, Sensing, disturb, run_closed_loop
from leapgap.simulation.open_loop import Course, MotionPlan, prepare
from leapgap.simulation.replay import Replayer
from tests.simulation.test_closed_loop import SILENT, Playback


@pytest.fixture
def falling(robot: Robot) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot five metres up, where nothing but gravity acts on it; its joints hang loose."""
    model = copy.copy(robot.model)
    model.actuator_gainprm[:] = 0
    data = mujoco.MjData(model)
    data.qpos[2] += 5
    mujoco.mj_forward(model, data)
    return model, data


def momentum(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    return data.subtree_linvel[1] * model.body_subtreemass[1]


def test_a_push_adds_its_impulse_to_the_momentum(robot: Robot, falling: tuple[mujoco.MjModel, mujoco.MjData]) -> None:
    model, data = falling
    push = Disturbance(0.05, force_n=(-40.0, 25.0), duration_s=0.1)
    steps = round(0.3 / model.opt.timestep)
    before = momentum(model, data)
    for step in range(steps):
        disturb(model, data, robot.base_body, (push,), step * model.opt.timestep)
        mujoco.mj_step(model, data)
    gained = momentum(model, data) - before
    weight = model.body_subtreemass[1] * -model.opt.gravity[2]
    assert gained[0] == pytest.approx(-40 * 0.1, rel=3e-3)
    assert gained[2] == pytest.approx(25 * 0.1 - weight * steps * model.opt.timestep, rel=3e-3)


def test_a_kick_changes_the_velocity_once(robot: Robot, falling: tuple[mujoco.MjModel, mujoco.MjData]) -> None:
    model, data = falling
    kick = Disturbance(0.02, velocity=(0.2, -0.1, 1.0))
    changes = []
    for step in range(round(0.05 / model.opt.timestep)):
        before = data.qvel[:6].copy()
        disturb(model, data, robot.base_body, (kick,), step * model.opt.timestep)
        if (data.qvel[:6] != before).any():
            changes.append((step * model.opt.timestep, data.qvel[:6] - before))
        mujoco.mj_step(model, data)
    ((time_s, change),) = changes
    assert time_s == pytest.approx(0.02)
    np.testing.assert_allclose(change, [0.2, 0, -0.1, 0, 1.0, 0], atol=1e-12)


def test_times_count_from_the_start_of_the_jump_and_nothing_acts_before_it(robot: Robot, reference: Log) -> None:
    replayer = Replayer(robot)
    ready = prepare([MotionPlan("kicked", reference)], replayer, (), Course())[0]

    def run(start_s: float | None, *actions: Disturbance) -> np.ndarray:
        controller = Playback(ready.commanded, robot)
        rng = np.random.default_rng(0)
        found = run_closed_loop(ready, controller, replayer, (), Sensing(noise=SILENT), rng, actions, lambda: start_s)
        return found.truth.base_velocity

    plain, kick = run(0.0), Disturbance(0.2, velocity=(0.2, 0.0, 0.0))
    kicked = run(0.06, kick)
    assert np.array_equal(kicked[:261], plain[:261])  # the kick follows the row at 0.26 s
    assert kicked[261, 0] - plain[261, 0] == pytest.approx(0.2, abs=0.05)
    assert np.array_equal(run(None, kick), plain)


def test_all_feet_stand_on_their_own_blocks(robot: Robot, reference: Log) -> None:
    plan = MotionPlan("raised", reference, 0.05, 0.03)
    level, raised = (
        prepare([one], Replayer(robot, 2), (), Course())[0].start for one in (MotionPlan("level", reference), plan)
    )
    feet = [feet_positions(robot, state[None, : robot.model.nq])[0, :, 2] for state in (level, raised)]
    rise = feet[1] - feet[0]
    assert rise[robot.feet_at("front")] == pytest.approx(0.05, abs=1e-3)
    assert rise[robot.feet_at("rear")] == pytest.approx(0.03, abs=1e-3)


def test_a_wrong_crouch_is_where_the_robot_stands_at_first(robot: Robot, reference: Log) -> None:
    error = np.zeros(len(robot.joints))
    error[robot.joints_at("calf")] = 0.08
    plans = [MotionPlan("right", reference), MotionPlan("wrong", reference, crouch_error_rad=tuple(error))]
    right, wrong = (prepare([plan], Replayer(robot), (), Course())[0] for plan in plans)
    moved = (wrong.start - right.start)[robot.joint_qpos]
    np.testing.assert_allclose(moved, error, atol=0.02)
    assert wrong.commanded["cmd_pos/FR_calf"][0] == right.commanded["cmd_pos/FR_calf"][0]  # nobody knows of it


def test_a_disturbance_is_told_with_its_units_and_time() -> None:
    assert str(Disturbance(0.3, velocity=(-0.2, 0.0, 0.0))) == "-0.2 m/s at 0.3 s"
    assert str(Disturbance(0.4, velocity=(0.0, 0.0, 1.0))) == "+1 rad/s at 0.4 s"
    assert str(Disturbance(0.3, force_n=(45.5, 0.0), duration_s=0.1)) == "+45.5 N from 0.3 to 0.4 s"
