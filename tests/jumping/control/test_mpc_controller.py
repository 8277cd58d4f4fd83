"""The jump controllers tick by tick: frames, holds, phases, fallbacks; and in MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control.leg_kinematics import LegKinematics, StartFrame
from leapgap.jumping.control.mpc import POSE_NOT_FINITE, DepartingMpc, JumpMpc, MpcConfig
from leapgap.jumping.control.qp import NOT_FINITE
from leapgap.jumping.control.tracking import JointPd, PhaseGains, Reference
from leapgap.jumping.models.rigid_body import NominalDeviation, RigidBodyModel
from leapgap.jumping.task import JointGains
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import Counting, estimate


@pytest.fixture(scope="module")
def jump_reference(reference: Log, robot: Robot) -> Reference:
    return Reference.of(reference, robot)


def mpc(jump_reference: Reference, robot: Robot, **changed: object) -> JumpMpc:
    config = replace(MpcConfig(), **changed)  # type: ignore[arg-type]
    return JumpMpc(jump_reference, robot, PhaseGains(), Counting(RigidBodyModel(A1_BODY)), config)


def estimate_at(jump_reference: Reference, time_s: float, yaw: float = 0.0, off: float = 0.0) -> StateEstimate:
    row = jump_reference.row(time_s)
    return estimate(time_s, jump_reference.state[row] + off * (time_s > 0), jump_reference.joint_pos[row], yaw)


def test_commands_do_not_depend_on_where_and_which_way_the_jump_begins(jump_reference: Reference, robot: Robot) -> None:
    here, there = mpc(jump_reference, robot), mpc(jump_reference, robot)
    elsewhere = np.array([3.0, -2.0, 0.0])
    for time_s in (0.0, 0.025, 0.05):
        first = here.command(estimate_at(jump_reference, time_s, off=0.02))
        turned = estimate_at(jump_reference, time_s, yaw=0.8, off=0.02)
        moved = there.command(replace(turned, base_position=turned.base_position + elsewhere))
        assert moved.planned_force == pytest.approx(first.planned_force, abs=1e-6)
        assert moved.torque == pytest.approx(first.torque, abs=1e-6)


def test_a_departing_mpc_sends_the_torques_of_the_plan_and_what_it_departs_by(
    jump_reference: Reference, robot: Robot
) -> None:
    """On the plan those of joint PD alone, in flight too; beside it, the torques of the forces by which it departs."""
    legs, frame = LegKinematics(robot), StartFrame(0.0, 0.0, 0.0)
    for off in (0.0, 0.02):
        controller = DepartingMpc(jump_reference, robot, PhaseGains(), NominalDeviation(A1_BODY), MpcConfig())
        pd = JointPd(jump_reference, robot, PhaseGains())
        for time_s in (0.0, 0.3, 0.307, 0.7, 0.9, 1.3):
            seen = estimate_at(jump_reference, time_s, off=off)
            sent, plain = controller.command(seen), pd.command(seen)
            departs = sent.planned_force - plain.planned_force
            torque = legs.torque(seen.base_quaternion, seen.joint_pos, frame.in_world(departs))
            assert sent.torque == pytest.approx(plain.torque + torque, abs=1e-6)
            assert (np.abs(departs).max() > 1.0) == (off > 0 and 0 < time_s < 0.8)


def test_a_departing_mpc_that_cannot_measure_sends_the_plan(jump_reference: Reference, robot: Robot) -> None:
    controller = DepartingMpc(jump_reference, robot, PhaseGains(), NominalDeviation(A1_BODY), MpcConfig())
    for time_s in (0.0, 0.2, 0.55):
        blind = replace(estimate_at(jump_reference, time_s, off=0.02), base_velocity=np.full(3, np.nan))
        sent = controller.command(blind)
        row = jump_reference.row(time_s)
        assert sent.torque == pytest.approx(jump_reference.torque[row], abs=1e-9)
        assert sent.position == pytest.approx(jump_reference.joint_pos[row])
    assert controller.fallbacks == {NOT_FINITE: 3}


def test_frame_gives_back_the_planar_state_and_turns_forces(jump_reference: Reference, robot: Robot) -> None:
    state = np.array([0.3, 0.25, -0.2, 0.5, -0.4, 0.7])
    seen = estimate(0.0, state, yaw=-1.1)
    frame = StartFrame(0.0, 0.0, -1.1)
    assert frame.state(seen) == pytest.approx(state)
    assert StartFrame.of(seen).yaw_rad == pytest.approx(-1.1)
    assert StartFrame(0.0, 0.0, -1.1, level_m=0.2).state(seen)[1] == pytest.approx(0.05)
    force = frame.in_world(np.array([10.0, 20.0, 0.0, 5.0]))
    assert force[0] == pytest.approx([10 * np.cos(1.1), -10 * np.sin(1.1), 20])
    level = estimate(0.0, np.array([0, 0.17, 0.3, 0, 0, 0]), jump_reference.joint_pos[0], yaw=-1.1)
    straight = estimate(0.0, np.array([0, 0.17, 0.3, 0, 0, 0]), jump_reference.joint_pos[0])
    legs = LegKinematics(robot)
    assert frame.foot(level, legs) == pytest.approx(StartFrame(0, 0, 0).foot(straight, legs))


def test_the_force_is_held_between_updates_and_mapped_at_every_tick(jump_reference: Reference, robot: Robot) -> None:
    controller = mpc(jump_reference, robot)
    counted: list[int] = controller.planner.formulation.model.asked  # type: ignore[attr-defined]
    counted.clear()
    commands = [controller.command(estimate_at(jump_reference, tick / 1000, off=0.01)) for tick in range(60)]
    assert counted == [1, 1, 1], "updates at 0, 25 and 50 ms"
    forces = np.array([c.planned_force for c in commands])
    assert (np.flatnonzero(np.abs(np.diff(forces, axis=0)).any(axis=1)) == [24, 49]).all()
    legs = LegKinematics(robot)
    for tick in (7, 31):
        seen = estimate_at(jump_reference, tick / 1000, off=0.01)
        force = forces[tick].reshape(2, 2) @ np.array([[1, 0, 0], [0, 0, 1.0]])
        assert commands[tick].torque == pytest.approx(legs.torque(seen.base_quaternion, seen.joint_pos, force))


def test_a_slower_update_is_honoured(jump_reference: Reference, robot: Robot) -> None:
    controller = mpc(jump_reference, robot, period_s=0.05)
    counted: list[int] = controller.planner.formulation.model.asked  # type: ignore[attr-defined]
    counted.clear()
    for tick in range(0, 201):
        controller.command(estimate_at(jump_reference, tick / 1000))
    assert len(counted) == 5


def test_legs_in_the_air_get_no_force_and_joints_follow_the_reference(jump_reference: Reference, robot: Robot) -> None:
    controller = mpc(jump_reference, robot)
    front = robot.joints_at("front")
    for tick in range(0, 1300):
        command = controller.command(
            estimate_at(jump_reference, min(tick, 1200) / 1000) if tick <= 1200 else at(jump_reference, 1.3)
        )
        row = min(tick, 1200)
        assert (command.position == jump_reference.joint_pos[row]).all()
        if tick >= 500:
            assert (command.torque[front] == 0).all()
            assert (command.planned_force[:2] == 0).all()
        if tick >= 800:
            assert (command.torque == 0).all()
            assert (command.planned_force == 0).all()
        if tick > 1200:
            assert (command.velocity == 0).all()
    assert not controller.fallbacks


def at(jump_reference: Reference, time_s: float) -> StateEstimate:
    return replace(estimate_at(jump_reference, 1.2), time_s=time_s)


def test_joint_pd_sends_the_plan(jump_reference: Reference, robot: Robot) -> None:
    controller = JointPd(jump_reference, robot, PhaseGains())
    for time_s in (0.0, 0.3, 0.7, 1.0):
        command = controller.command(estimate_at(jump_reference, time_s))
        row = jump_reference.row(time_s)
        assert (command.torque == jump_reference.torque[row]).all()
        assert (command.planned_force == jump_reference.force[row]).all()
        assert (command.kp == 300).all()
        assert (command.kd == 3).all()
    assert (controller.command(at(jump_reference, 1.3)).torque == 0).all()


def test_gains_by_phase(jump_reference: Reference, robot: Robot) -> None:
    gains = PhaseGains(JointGains(100, 3), JointGains(200, 4), JointGains(50, 5))
    kp, kd = gains.rows(jump_reference, robot)
    front, rear = robot.joints_at("front")[0], robot.joints_at("rear")[0]
    for row, of_front, of_rear in ((0, 100, 100), (499, 100, 100), (500, 200, 100), (800, 50, 50), (1200, 300, 300)):
        assert (kp[row, front], kp[row, rear]) == (of_front, of_rear)
    assert kd[1100, front] == 5


def sane(command: Command) -> bool:
    return all(np.isfinite(part).all() for part in vars(command).values())


@pytest.mark.parametrize("lost", ["base_position", "base_quaternion", "base_velocity", "joint_pos"])
@pytest.mark.parametrize("from_tick", [0, 30])
def test_no_sensor_failure_reaches_the_joints(
    jump_reference: Reference, robot: Robot, lost: str, from_tick: int
) -> None:
    controller = mpc(jump_reference, robot)
    for tick in range(0, 500, 5):
        seen = estimate_at(jump_reference, tick / 1000)
        if tick >= from_tick:
            seen = replace(seen, **{lost: getattr(seen, lost) * np.nan})
        command = controller.command(seen)
        assert sane(command)
        assert command.planned_force[FRONT_Z] > 10, "feed-forward goes on"
        assert np.abs(command.torque).max() < 40
    assert controller.fallbacks[NOT_FINITE] > 15
    assert (controller.fallbacks[POSE_NOT_FINITE] > 90) == (lost in ("base_quaternion", "joint_pos"))
    assert len(controller.substituted) == sum(controller.fallbacks.values())


FRONT_Z = 1


def test_references_that_cannot_be_followed_are_refused(reference: Log, robot: Robot) -> None:
    with pytest.raises(InputError, match="reaches its take-off"):
        Reference.of(reference.first_rows(700), robot)
    other = replace(reference, columns={k: v for k, v in reference.columns.items() if "RL_calf" not in k})
    with pytest.raises(InputError, match="no joint RL_calf"):
        Reference.of(other, robot)


def test_mean_force_keeps_the_impulse(jump_reference: Reference) -> None:
    times = np.array([0.0, 0.013, 0.5, 0.55, 0.8, 0.9, 1.2])
    mean = jump_reference.mean_force(times)
    total = jump_reference.force[:1200].sum(axis=0) * 0.001
    assert np.diff(times) @ mean == pytest.approx(total)
    assert mean[1] == pytest.approx(jump_reference.force[13:500].mean(axis=0))
    assert (mean[4:] == 0).all()
