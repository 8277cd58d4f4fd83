"""Landing and the sequence of jumps: the phases one by one, and in MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control.jump_sequence import (
    JumpSequence,
    LandingConfig,
    LandingMpc,
    SequenceConfig,
    standing_force,
)
from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.mpc import JumpMpc, MpcConfig
from leapgap.jumping.control.qp import NOT_FINITE, SolutionRequirements
from leapgap.jumping.control.tracking import JointPd, PhaseGains, Reference
from leapgap.jumping.experiments.trial import landing
from leapgap.jumping.models.rigid_body import RigidBodyModel
from leapgap.logs.log import Log
from leapgap.logs.pair_force import FORCE_X, FORCE_Z
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of
from leapgap.robot.terrain import Box
from leapgap.simulation.closed_loop import ClosedLoopRun, Sensing, run_closed_loop
from leapgap.simulation.controller import Controller
from leapgap.simulation.open_loop import Course, MotionPlan, prepare
from leapgap.simulation.replay import Replayer
from leapgap.simulation.sensors import SensorNoise
from tests.conftest import A1_BODY
from tests.jumping.control.simple_models import CROUCH, estimate
from tests.jumping.rigid_motion import step

REST = np.array([0.0, 0.1726, 0, 0, 0, 0])


@pytest.fixture(scope="module")
def jump_reference(reference: Log, robot: Robot) -> Reference:
    return Reference.of(reference, robot)


def lander(robot: Robot, **changed: object) -> LandingMpc:
    return LandingMpc(robot, CROUCH, replace(LandingConfig(height_m=0.1726), **changed), A1_BODY)  # type: ignore[arg-type]


def test_a_body_at_rest_over_its_feet_is_sent_its_weight(robot: Robot) -> None:
    pose = np.tile([0.0, 1.2, -2.4], 4)
    offset = LegKinematics(robot).pair_offsets(np.array([1.0, 0, 0, 0]), pose)
    assert offset[:, 0].mean() == pytest.approx(0, abs=1e-9), "a pose that is over its feet"
    height = 0.02 - offset[:, 2].mean()
    state = np.array([0, height, 0, 0, 0, 0])
    force = lander(robot, height_m=height).command(estimate(0.0, state, pose)).planned_force
    assert force == pytest.approx(standing_force(A1_BODY), abs=0.5)
    assert force[FORCE_Z].sum() == pytest.approx(12.453 * 9.81, abs=0.5)


@pytest.mark.parametrize(("component", "off"), [(3, 0.5), (4, -1.0), (4, 0.3), (2, 0.2), (5, 1.0)])
def test_forces_bring_the_body_to_rest(robot: Robot, component: int, off: float) -> None:
    """On the planar body itself, its feet standing: what is off after the touch-down is gone after the landing."""
    body, state = A1_BODY, REST.copy()
    state[component] += off
    foot_in_world = LegKinematics(robot).pair_offsets(np.array([1.0, 0, 0, 0]), CROUCH)[:, [0, 2]] + REST[:2]
    controller = lander(robot)
    worst = abs(state[2:]).copy()
    for tick in range(800):
        # The kinematics of legs that hold these feet is not needed: a pair's offset stands in for it.
        controller.legs.pair_offsets = lambda *_: np.insert(foot_in_world - state[:2], 1, 0.0, axis=1)  # type: ignore[method-assign]  # noqa: B023
        force = controller.command(estimate(tick / 1000, state, CROUCH)).planned_force
        assert (np.abs(force[FORCE_X]) <= 0.6 * force[FORCE_Z] + 1e-6).all()
        assert ((force[FORCE_Z] >= 10 - 1e-6) & (force[FORCE_Z] <= 350 + 1e-6)).all()
        state = step(body, state, (foot_in_world - state[:2]).ravel(), force, 0.001)
    assert not controller.fallbacks
    assert abs(state[2:]).max() < 0.3 * worst.max()


def test_a_landing_without_a_solution_sends_the_weight(robot: Robot) -> None:
    lost = lander(robot)
    command = lost.command(estimate(0.0, REST * np.nan, CROUCH))
    assert lost.fallbacks == {NOT_FINITE: 1}
    assert command.planned_force == pytest.approx(standing_force(A1_BODY))
    assert (command.torque == 0).all(), "no pose to map a force with"
    refused = lander(robot, demands=SolutionRequirements(relative_dual_tolerance=1e-300))
    command = refused.command(estimate(0.0, REST, CROUCH))
    assert refused.fallbacks == {"inaccurate": 1}
    assert np.abs(command.torque).max() > 1


def phases(controller: JumpSequence, touching: dict[float, bool], until_s: float) -> dict[float, str]:
    """Run on made estimates; ``touching`` says from when on all feet touch or not. When which phase began."""
    began: dict[float, str] = {}
    for tick in range(round(until_s * 1000)):
        time_s = tick / 1000
        now = [value for since, value in touching.items() if time_s >= since - 1e-9][-1]
        controller.command(estimate(time_s, REST, CROUCH, touching=now))
        if not began or list(began.values())[-1] != controller.phase:
            began[time_s] = controller.phase
    return began


def sequence(jump_reference: Reference, robot: Robot, jumps: int, **changed: object) -> JumpSequence:
    config = replace(SequenceConfig(), **changed)  # type: ignore[arg-type]
    return JumpSequence([JointPd(jump_reference, robot, PhaseGains()) for _ in range(jumps)], robot, config, A1_BODY)


def starts_s(controller: JumpSequence) -> list[float]:
    """When each jump so far began."""
    return [jump.start_s for jump in controller.jumps if jump.start_s is not None]


@pytest.mark.parametrize("touch_s", [1.0, 1.2, 1.35], ids=["early", "in time", "late"])
def test_the_landing_begins_when_both_pairs_touch(jump_reference: Reference, robot: Robot, touch_s: float) -> None:
    controller = sequence(jump_reference, robot, 2)
    began = phases(controller, {0.0: True, 0.81: False, touch_s: True}, touch_s + 1.0)
    down = touch_s + 0.003
    assert list(began.values()) == ["jump", "landing", "settling", "jump"]
    assert list(began) == pytest.approx([0.0, down, down + 0.2, down + 0.8])
    assert starts_s(controller) == pytest.approx([0.0, down + 0.8])
    assert controller.landings_s == pytest.approx([down])


def test_feet_that_have_not_left_yet_are_no_landing(jump_reference: Reference, robot: Robot) -> None:
    began = phases(sequence(jump_reference, robot, 1), {0.0: True, 0.84: False, 1.1: True}, 1.2)
    assert list(began) == pytest.approx([0.0, 1.103])


def test_a_bounce_shorter_than_a_few_ticks_is_no_landing(jump_reference: Reference, robot: Robot) -> None:
    began = phases(
        sequence(jump_reference, robot, 1), {0.0: True, 0.81: False, 1.0: True, 1.002: False, 1.1: True}, 1.2
    )
    assert list(began) == pytest.approx([0.0, 1.103])


def test_one_pair_alone_is_no_landing(jump_reference: Reference, robot: Robot) -> None:
    controller = sequence(jump_reference, robot, 1)
    for tick in range(1200):
        seen = estimate(tick / 1000, REST, CROUCH, touching=tick < 810)
        if tick > 1000:
            seen.foot_contact[robot.feet_at("rear")] = True
        controller.command(seen)
    assert controller.phase == "jump"


def test_without_any_touch_the_legs_settle_in_the_end(jump_reference: Reference, robot: Robot) -> None:
    controller = sequence(jump_reference, robot, 1)
    began = phases(controller, {0.0: True, 0.81: False}, 1.8)
    assert list(began) == pytest.approx([0.0, 1.5])
    assert controller.landings_s == []
    last = controller.command(estimate(1.8, REST, CROUCH, touching=False))
    assert (last.planned_force == 0).all(), "feet in the air carry nothing"


def test_set_points_do_not_jump_between_phases(jump_reference: Reference, robot: Robot) -> None:
    """While stiff: the soft landing may pull anywhere, and settling begins where the joints are."""
    controller = sequence(jump_reference, robot, 2)
    bent = CROUCH + 0.2
    before = None
    for tick in range(2400):
        time_s = tick / 1000
        command = controller.command(estimate(time_s, REST, bent, touching=time_s < 0.81 or time_s > 1.2))
        if controller.phase == "settling" and before is None:
            assert command.position == pytest.approx(bent, abs=0.001)
            before = command.position
        elif controller.phase == "settling":
            assert np.abs(command.position - before).max() < 0.002
            before = command.position
    assert before == pytest.approx(jump_reference.joint_pos[0], abs=1e-3)


def test_no_jump_is_refused(robot: Robot) -> None:
    with pytest.raises(InputError, match="one or more"):
        JumpSequence([], robot, SequenceConfig(), A1_BODY)


def run(
    reference: Log, robot: Robot, controller: Controller, after_s: float, terrain: tuple[Box, ...] = ()
) -> ClosedLoopRun:
    reference = replace(reference, info=replace(reference.info, terrain=terrain))
    replayer = Replayer(robot, terrain_slots=1 + len(terrain))
    ready = prepare([MotionPlan("made", reference)], replayer, (), Course(after_landing_s=after_s))[0]
    noise = Sensing(SensorNoise())
    return run_closed_loop(ready, controller, replayer, (), noise, np.random.default_rng(0))


def test_two_jumps_in_mujoco_each_lands_and_stands(reference: Log, jump_reference: Reference, robot: Robot) -> None:
    jumps = [JumpMpc(jump_reference, robot, PhaseGains(), RigidBodyModel(A1_BODY), MpcConfig()) for _ in range(2)]
    controller = JumpSequence(jumps, robot, SequenceConfig(), A1_BODY)
    made = run(reference, robot, controller, after_s=3.2)
    assert len(starts_s(controller)) == len(controller.landings_s) == 2
    assert not controller.fallbacks
    for start in starts_s(controller):
        found = landing(made, robot, first=round(1000 * start))
        assert found.success
        assert abs(found.error_cm) < 20
        assert found.apex > 2.5
    force = made.log.pair_force("mpc_force")
    assert (np.abs(force[:, FORCE_X]) <= 0.6 * force[:, FORCE_Z] + 1e-6).all()
    assert (force[:, FORCE_Z] <= 350 + 1e-6).all()
    assert abs(pitch_of(made.truth.qpos[-1, 3:7])) < 0.1
    assert np.abs(made.truth.qvel[-1, :6]).max() < 0.1


def test_the_landing_stands_where_holding_the_pose_does_not(
    reference: Log, jump_reference: Reference, robot: Robot
) -> None:
    alone = JointPd(jump_reference, robot, PhaseGains())
    landed = JumpSequence([JointPd(jump_reference, robot, PhaseGains())], robot, SequenceConfig(), A1_BODY)
    assert landing(run(reference, robot, landed, 1.0), robot).success
    speed = [
        np.abs(run(reference, robot, each, 0.35).truth.qvel[-1, [0, 2, 4]]).max()
        for each in (
            alone,
            JumpSequence([JointPd(jump_reference, robot, PhaseGains())], robot, SequenceConfig(), A1_BODY),
        )
    ]
    assert speed[1] < speed[0]


def test_an_unseen_step_up_lands_early_and_upright(reference: Log, jump_reference: Reference, robot: Robot) -> None:
    step = Box(1.2, 0.0, (1.9, 1.0, 0.06), 0.06)  # under all four feet at the landing, ahead of the front feet
    assert step.x_m - step.size_m[0] / 2 > 0.2
    controller = JumpSequence([JointPd(jump_reference, robot, PhaseGains())], robot, SequenceConfig(), A1_BODY)
    made = run(reference, robot, controller, 1.0, (step,))
    assert controller.landings_s[0] < 1.27
    assert abs(pitch_of(made.truth.qpos[-1, 3:7])) < 0.3
