"""No estimate, however broken, makes a controller raise or send what the robot must not get."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.jumping.control.border import TIME_NOT_USABLE, Border
from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.jump_sequence import LandingConfig
from leapgap.jumping.control.mpc import POSE_NOT_FINITE, JumpMpc, MpcConfig, StateWeights
from leapgap.jumping.control.qp import NOT_FINITE, SolutionRequirements
from leapgap.jumping.control.tracking import JointPd, PhaseGains, Reference
from leapgap.jumping.models.rigid_body import RigidBodyModel
from leapgap.jumping.task import JointGains
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Controller
from tests.conftest import A1_BODY
from tests.hostile.ticks import MOTOR_NM, a1_and_reference, bad_problems, hostile_ticks, truth_at


@pytest.fixture(scope="module")
def jump() -> tuple[Robot, Reference]:
    return a1_and_reference()


def mpc(jump: tuple[Robot, Reference]) -> JumpMpc:
    robot, reference = jump
    return JumpMpc(reference, robot, PhaseGains(), RigidBodyModel(A1_BODY), MpcConfig())


@pytest.mark.long
def test_hostile_ticks(jump: tuple[Robot, Reference]) -> None:
    """The same as in ``make hostile``, fewer of them."""
    tally = hostile_ticks(100_000, 1, *jump)
    assert tally.ticks >= 100_000
    assert (tally.exceptions, tally.nonfinite, tally.outside_limits, tally.unrecovered) == (0, 0, 0, 0), tally.first


def test_bad_problems_are_solutions_with_a_reason() -> None:
    found = bad_problems(500, 1)
    assert not [says for says in found if "raised" in says], found
    assert sum(found.values()) == 1000


@pytest.mark.parametrize("bad", [np.nan, np.inf, -5.0, 1e12])
def test_a_tick_without_a_time_repeats_the_command_and_harms_no_later_one(
    jump: tuple[Robot, Reference], bad: float
) -> None:
    _, reference = jump
    harmed, spared = mpc(jump), mpc(jump)
    last = harmed.command(truth_at(reference, 0))
    spared.command(truth_at(reference, 0))
    for tick in range(1, 120):
        told = truth_at(reference, tick)
        expected = spared.command(told)
        if tick in (40, 41, 77):
            assert harmed.command(replace(told, time_s=bad)) is last
        else:
            last = harmed.command(told)
        if tick > 100:
            assert last.torque == pytest.approx(expected.torque, abs=0.5)
    assert harmed.fallbacks == {TIME_NOT_USABLE: 3}


@pytest.mark.parametrize("bad", [np.nan, -5.0, 1e6])
def test_a_first_tick_with_a_wrong_time_does_not_poison_the_jump(jump: tuple[Robot, Reference], bad: float) -> None:
    _, reference = jump
    controller = mpc(jump)
    first = controller.command(replace(truth_at(reference, 0), time_s=bad))
    if np.isnan(bad):
        assert (first.torque == 0).all() and (first.kp == 0).all() and (first.kd > 0).all()
    for tick in range(1, 700):
        command = controller.command(truth_at(reference, tick))
        if tick > 2:
            assert np.abs(command.position - reference.joint_pos[tick]).max() < 0.02
    assert sum(controller.fallbacks.values()) == 1


def test_a_time_beyond_all_floats_is_not_usable(jump: tuple[Robot, Reference]) -> None:
    robot, reference = jump
    controller = JointPd(reference, robot, PhaseGains())
    last = controller.command(truth_at(reference, 0))
    assert controller.command(replace(truth_at(reference, 1), time_s=10**400)) is last
    assert controller.fallbacks == {TIME_NOT_USABLE: 1}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "value",
    [
        *(np.full(4, "0.5"), np.full(4, 0.5 + 2j), np.full(4, True), np.ones(4, "datetime64[s]")),
        *([None] * 4, [10**400] * 4, np.ma.array(np.full(4, 0.5), mask=True)),
    ],
    ids=["texts", "complex", "booleans", "dates", "none", "beyond all floats", "masked"],
)
def test_what_is_no_real_number_was_not_measured(jump: tuple[Robot, Reference], value: object) -> None:
    robot, reference = jump
    told = truth_at(reference, 0)
    told = replace(told, base_quaternion=value, joint_vel=np.repeat(value, 3), base_velocity=value[:3])  # type: ignore[index]
    judged = Border(robot).judged(told)
    assert judged is not None
    for found in (judged.base_quaternion, judged.joint_vel, judged.base_velocity):
        assert np.isnan(found).all()


@pytest.mark.parametrize("kind", [np.float32, np.float64, list])
def test_an_estimate_of_floats_of_any_kind_is_read(jump: tuple[Robot, Reference], kind: type) -> None:
    robot, reference = jump
    told = truth_at(reference, 50)
    names = ("base_position", "base_quaternion", "base_velocity", "base_angular_velocity", "joint_pos", "joint_vel")
    judged = Border(robot).judged(
        replace(
            told,
            **{
                name: [*map(float, getattr(told, name))] if kind is list else getattr(told, name).astype(kind)
                for name in names
            },
        )
    )
    assert judged is not None
    for name in names:
        assert getattr(judged, name) == pytest.approx(getattr(told, name), abs=1e-6)
        assert getattr(judged, name).dtype == np.float64


def test_a_clock_that_stays_lost_damps_the_joints(jump: tuple[Robot, Reference]) -> None:
    robot, reference = jump
    controller = JointPd(reference, robot, PhaseGains())
    held = controller.command(truth_at(reference, 0))
    commands = [controller.command(replace(truth_at(reference, tick), time_s=np.nan)) for tick in range(1, 60)]
    assert all(command is held for command in commands[:20])
    for command in commands[20:]:
        assert (command.torque == 0).all() and (command.kp == 0).all() and (command.velocity == 0).all()
        assert (command.kd == 3).all()
    again = controller.command(truth_at(reference, 60))
    assert (again.position == reference.joint_pos[60]).all() and (again.kp == 300).all()


def test_a_clock_that_was_set_is_followed_from_its_second_tick_on(jump: tuple[Robot, Reference]) -> None:
    robot, reference = jump
    controller = JointPd(reference, robot, PhaseGains())
    controller.command(truth_at(reference, 100))
    for tick in (0, 1, 2):
        controller.command(truth_at(reference, tick))
    assert controller.fallbacks == {TIME_NOT_USABLE: 1}


def test_a_first_attitude_that_is_impossible_does_not_decide_the_heading(jump: tuple[Robot, Reference]) -> None:
    _, reference = jump
    harmed, spared = mpc(jump), mpc(jump)
    first = truth_at(reference, 0)
    harmed.command(replace(first, base_quaternion=np.array([1e200, 1e200, 0, 1e200])))
    spared.command(first)
    assert harmed.fallbacks == {NOT_FINITE: 1, POSE_NOT_FINITE: 1}
    for tick in range(1, 120):
        told = truth_at(reference, tick)
        torques = [controller.command(told).torque for controller in (harmed, spared)]
    assert torques[0] == pytest.approx(torques[1], abs=0.5)
    assert harmed.frame is not None and abs(harmed.frame.yaw_rad) < 1e-9


def test_torques_stay_within_the_motors_and_forces_keep_their_direction(jump: tuple[Robot, Reference]) -> None:
    robot, reference = jump
    doubled = replace(reference, torque=reference.torque * 6.0, force=reference.force * 6.0)
    controller = JointPd(doubled, robot, PhaseGains())
    limited = 0
    for tick in range(0, 800, 5):
        command = controller.command(truth_at(reference, tick))
        asked = doubled.force[tick].reshape(2, 2)
        sent = command.planned_force.reshape(2, 2)
        assert np.abs(command.torque).max() <= MOTOR_NM
        assert np.cross(asked, sent) == pytest.approx(0, abs=1e-6)
        limited += bool((np.abs(doubled.torque[tick]) > MOTOR_NM).any())
    assert limited > 10
    assert controller.border.limited_ticks == limited
    assert not controller.fallbacks  # what is sent is the controller's own command, only smaller


def test_torques_that_the_motors_can_deliver_are_sent_as_they_are(jump: tuple[Robot, Reference]) -> None:
    robot, reference = jump
    border = Border(robot)
    torque, force = border.within_limits(reference.torque[300], reference.force[300])
    assert not border.limited_ticks
    assert (torque == reference.torque[300]).all() and (force == reference.force[300]).all()


@pytest.mark.parametrize(
    "make",
    [
        lambda: MpcConfig(period_s=np.nan),
        lambda: MpcConfig(period_s=np.inf),
        lambda: MpcConfig(force_weight=np.nan),
        lambda: MpcConfig(weights=StateWeights(x=np.nan)),
        lambda: MpcConfig(plan_valid_s=np.nan),
        lambda: JointGains(kp_nm_per_rad=np.nan),
        lambda: ForceLimits(largest_n=np.nan),
        lambda: ForceLimits(friction=np.inf),
        lambda: LandingConfig(step_s=np.nan),
        lambda: LandingConfig(steps=0),
        lambda: SolutionRequirements(primal_tolerance_n=np.nan),
    ],
)
def test_settings_that_are_no_numbers_are_refused(make: object) -> None:
    with pytest.raises(ValueError, match=r"above 0|below 0|limits|friction"):
        make()  # type: ignore[operator]


def test_every_controller_is_among_the_hostile_ticks() -> None:
    """Subclasses of ``Controller`` in the library that no hostile tick reaches."""
    from tests.hostile import ticks

    def below(kind: type) -> set[type]:
        return {kind} | {deeper for one in kind.__subclasses__() for deeper in below(one)}

    concrete = {kind.__name__ for kind in below(Controller) if not getattr(kind, "__abstractmethods__", None)}
    ours = {name for name in concrete if name in vars(ticks)}
    missing = {kind.__name__ for kind in below(Controller) if kind.__module__.startswith("leapgap.jumping.control")}
    assert missing - {"JumpController"} == ours
