"""Forces from outside: found at their joint, time and impulse, absent from logs without any, and blamed on nothing."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.outside_forces.episodes import (
    Episode,
    Repeats,
    episodes_at,
    in_most_logs,
    largest_of_each_moment,
    least_peak,
    swings,
)
from leapgap.diagnosis.outside_forces.model_errors import Instants, inverse_dynamics, without_constraints
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce, OutsideForceSettings
from leapgap.diagnosis.outside_forces.residuals import Residual, Residuals, stops
from leapgap.diagnosis.outside_forces.search import OutsideForces, find_outside_forces, unexplained, without_moments
from leapgap.diagnosis.settings import Settings
from leapgap.effects.friction import JointDamping
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log
from leapgap.logs.reading import read_foreign
from leapgap.reports.diagnosis import diagnose_logs
from leapgap.reports.report import html
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.diagnosis.pushed_robots import ARM, Push, arm_swing, quadruped_jump, write_arm

SETTINGS = Settings(effects=["joint_damping", "torque_gain", "armature"])
PUSHES = (Push(0, "elbow", 1.5, 0.2, 1.5), Push(2, "shoulder", 2.5, 0.15, -1.5))


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return Robot.load(write_arm(tmp_path_factory.mktemp("arm")))


@pytest.fixture(scope="module")
def a1() -> Robot:
    return Robot.load()


def find(logs: Sequence[Log], robot: Robot, remove: bool = True) -> OutsideForces:
    settings = OutsideForceSettings(remove=remove)
    judged = JudgedLogs.of(logs, robot)
    return without_moments(find_outside_forces(judged, Replayer(robot, threads=1), settings), judged, settings)


def assert_are(found: Sequence[OutsideForce], pushes: Sequence[Push], of_logs: str) -> None:
    """Each force is a push: at its log and joint or axis, within 50 ms, with its impulse in the interval."""
    in_order = sorted(pushes, key=lambda push: (push.log, push.time_s))
    assert [(one.log, one.axis or one.at) for one in found] == [(f"{of_logs}_{p.log}", p.at) for p in in_order]
    for one, push in zip(found, in_order, strict=True):
        assert one.time_s == pytest.approx(push.time_s, abs=0.05)
        assert one.impulse_ci95[0] <= push.impulse <= one.impulse_ci95[1]
        assert one.impulse == pytest.approx(push.impulse, rel=0.15)


@pytest.mark.parametrize("damping", [0.1, 0.4])
def test_pushes_of_an_arm_are_found_at_their_joint_and_time(arm: Robot, damping: float) -> None:
    """Also where the elbow has four times the damping that the model states."""
    logs = [arm_swing(k, list(PUSHES), damping) for k in range(4)]
    assert_are(find(logs, arm).forces, PUSHES, "swing")


def test_a_force_is_dropped_only_where_the_answer_moves_through_its_moment_as_the_log_says(arm: Robot) -> None:
    """Fast swings of an elbow with four times the damping are explained by that; a push stays, whatever is known."""
    logs = [arm_swing(k, list(PUSHES), 0.4) for k in range(4)]
    given, replayer = JudgedLogs.of(logs, arm), Replayer(arm, threads=1)
    pushes = find(logs, arm).forces
    swings = [
        replace(pushes[0], log=log.name, at="elbow", begin_s=begin, end_s=begin + 0.3)
        for log in (logs[1], logs[3])
        for begin in (0.6, 1.7, 2.9)
    ]
    assert len(pushes) == len(PUSHES)
    assert unexplained([*pushes, *swings], given, replayer, [JointDamping("elbow", 0.3)]) == pushes
    assert unexplained([*pushes, *swings], given, replayer, []) == (*pushes, *swings)


@pytest.mark.long
@pytest.mark.parametrize("damping", [0.1, 0.4])
def test_an_arm_that_nothing_pushes_has_no_force_from_outside(arm: Robot, damping: float) -> None:
    false = [k for k in range(0, 40, 4) if find([arm_swing(k + i, [], damping) for i in range(4)], arm).forces]
    assert not false


@pytest.mark.parametrize(("pushed", "told"), [((0, 1, 2, 3), 0), ((2,), 1)])
def test_what_every_log_shows_at_one_moment_of_a_motion_is_no_push(
    arm: Robot, pushed: tuple[int, ...], told: int
) -> None:
    """Four times the same motion: what acts in all of them is the robot's or its cell's, what acts once is not."""
    pushes = [Push(k, "elbow", 1.5, 0.2, 1.5) for k in pushed]
    found = find([arm_swing(k, pushes, motion=7) for k in range(4)], arm).forces
    assert len(found) == told
    assert all(one.log == "swing_2" for one in found)


@pytest.mark.long
def test_pushes_are_blamed_on_no_parameter(arm: Robot, tmp_path: Path) -> None:
    logs = [arm_swing(k, list(PUSHES)) for k in range(4)]
    whole = diagnose_logs(logs, arm, SETTINGS)
    report = whole.content
    assert report.verdict == "named", report.sentence
    assert report.answer == (("external_push",),)
    assert report.causes[0].effect == "external_push"
    assert report.causes[0].location == "elbow, shoulder"
    impulse = report.causes[0].parameters["angular_impulse"]
    assert impulse.value == pytest.approx(sum(abs(push.impulse) for push in PUSHES), rel=0.1)
    assert report.closure_of_answer.value > 0.95
    assert "at 1.50 s in swing_0, elbow, +1.4 N·m for 0.2" in report.sentence
    assert [one["at"] for one in report.to_json()["outside_forces"]] == ["elbow", "shoulder"]
    assert "external force: at 2.50 s in swing_2, shoulder, -1.3 N·m for 0.17 s, impulse -0.14 N·m·s (" in str(whole)
    page = " ".join((whole.save(tmp_path) / "report.html").read_text().split())
    assert "<h2>External forces</h2>" in page
    assert "holds for these logs only" in page
    assert "Nothing about the robot: without the external forces" in page
    partly = replace(report, verdict="partly")
    page = " ".join(html(partly, whole.logs, arm, whole.nominal, whole.corrected).split())
    assert "Only external forces were identified: the corrected robot is the nominal one" in page
    assert "Simulate with the corrected robot" not in page


@pytest.mark.long
def test_damping_is_found_beside_pushes(arm: Robot) -> None:
    logs = [arm_swing(k, list(PUSHES), 0.4) for k in range(4)]
    report = diagnose(logs, arm, SETTINGS).report
    assert report.answer == (("joint_damping",), ("external_push",)), report.sentence
    assert report.causes[0].location == "elbow"
    assert report.causes[0].parameters["damping"].value == pytest.approx(0.3, rel=0.05)


def test_rows_with_pushes_are_left_out_and_nothing_else(arm: Robot) -> None:
    logs = [arm_swing(k, list(PUSHES)) for k in range(4)]
    found = find(logs, arm)
    names = ["swing_0", "swing_0", "swing_1", "swing_2", "swing_2", "swing_3"]
    assert list(found.part_of.values()) == names
    assert [log.name for log in found.logs][1].startswith("swing_0_from_1.6")
    first, second = found.logs[:2]
    begin = len(logs[0]) - len(second)
    assert np.array_equal(first["joint_pos/elbow"], logs[0]["joint_pos/elbow"][: len(first)])
    assert np.array_equal(second["joint_pos/elbow"], logs[0]["joint_pos/elbow"][begin:])
    push = PUSHES[0]
    assert first.time[-1] < push.time_s - push.duration_s / 2 < push.time_s + push.duration_s / 2
    assert logs[0].time[begin] > push.time_s + push.duration_s / 2
    assert first.time[-1] > 1.3


def test_pushes_are_told_and_rows_kept_where_the_user_asks(arm: Robot) -> None:
    logs = [arm_swing(k, list(PUSHES)) for k in range(4)]
    found = find(logs, arm, remove=False)
    assert len(found.forces) == 2
    assert not found.logs


@pytest.mark.parametrize("push", [Push(1, "x", 0.45, 0.1, 60.0), Push(2, "x", 0.3, 0.1, -60.0)])
def test_a_push_on_the_trunk_of_a_jumping_quadruped_is_found(a1: Robot, push: Push) -> None:
    """60 N for 100 ms, in the air and while it stands: a constant force, whose impulse is peak × duration."""
    logs = [quadruped_jump(k, [push]) for k in range(5)]
    (found,) = find(logs, a1).forces
    assert (found.log, found.at, found.axis, found.unit) == (f"jump_{push.log}", "trunk", "x", "N")
    assert found.time_s == pytest.approx(push.time_s, abs=0.03)
    assert found.impulse == pytest.approx(push.peak * push.duration_s, rel=0.15)


def test_jumps_that_nothing_pushes_have_no_force_from_outside(a1: Robot) -> None:
    assert not find([quadruped_jump(k, []) for k in range(8)], a1).forces


def test_inverse_dynamics_of_a_simulated_motion_is_its_torque() -> None:
    """Against MuJoCo's forward dynamics: the torque that was applied comes back, damping included."""
    model = mujoco.MjModel.from_xml_string(ARM.format(shoulder=0.3, elbow=0.2))
    model.dof_frictionloss[:] = 0
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = (0.4, -0.7), (2.0, -3.0), (1.5, -0.4)
    mujoco.mj_forward(model, data)
    one = [np.array(values)[None] for values in (data.qpos, data.qvel, data.qacc)]
    motion = Instants(np.zeros(1), *one, np.zeros((1, 2)), np.zeros((1, 2)))
    assert inverse_dynamics(without_constraints(model), motion)[0] == pytest.approx([1.5, -0.4], abs=1e-9)


def test_a_stop_of_the_model_is_no_force_from_outside() -> None:
    """Where a joint is at the end of its range, what pushes it back is the stop; what pushes it on is not."""
    robot = SimpleNamespace(model=mujoco.MjModel.from_xml_string(ARM.format(shoulder=0.1, elbow=0.1)))
    robot.model.jnt_limited[1], robot.model.jnt_range[1] = True, (-1.0, 2.0)
    found = stops(np.array([[5.0, -1.001], [-5.0, 0.5], [0.0, 2.001]]), robot)
    assert found.tolist() == [[0, -1], [0, 0], [0, 1]]


@pytest.fixture(scope="session")
def acrobot() -> Path:
    """Logs of a real acrobot, where this machine has them."""
    for folder in (os.environ.get("LEAPGAP_ROBOTS"), "data/raw"):
        if folder and (Path(folder) / "acrobot" / "acrobot.urdf").is_file():
            return Path(folder) / "acrobot"
    pytest.skip("no logs of the acrobot: set LEAPGAP_ROBOTS or fill data/raw")


def acrobot_logs(folder: Path) -> tuple[Robot, list[Log]]:
    """The robot and its logs, with the commands as they were sent."""
    robot = Robot.load(folder.parent / "acrobot.urdf")
    joints = {"1": "Joint1", "2": "Joint2"}
    sent = {"joint_pos/*": "pos_meas*", "joint_vel/*": "vel_meas*", "cmd_tau/*": "tau_con*", "time": "time"}
    constants = {f"cmd_{name}/*": 0.0 for name in ("pos", "vel", "kp", "kd")}
    layout = log_format("csv")
    options = layout.Options(columns=sent, joint_names=joints, constants=constants)
    return robot, list(read_foreign(layout, folder, robot, options).logs)


def test_pushes_of_a_real_acrobot_are_found_and_nothing_else(acrobot: Path) -> None:
    """Against the torques that its owners added to the motors, which the diagnosis does not see.

    Of their fourteen pushes two act while it tumbles, in states that no other log was in.
    """
    robot, logs = acrobot_logs(acrobot / "pushed")
    found = find(logs, robot).forces
    assert len(found) == 12
    for one in found:
        raw = np.genfromtxt(acrobot / "pushed" / f"{one.log}.csv", delimiter=",", names=True)
        time = raw["time"] - raw["time"][0]
        about = np.abs(time - one.time_s) < 0.4
        added = raw[f"tau_pert{one.at[-1]}"] * about
        impulse = np.trapezoid(added, time)
        assert one.time_s == pytest.approx(np.trapezoid(added * time, time) / impulse, abs=0.05)
        assert 0.5 < one.impulse / impulse < 1.8


def test_an_acrobot_as_it_was_sent_is_pushed_by_nothing(acrobot: Path) -> None:
    robot, logs = acrobot_logs(acrobot / "sent")
    assert not find(logs, robot).forces


@pytest.mark.parametrize(("size", "friction", "least"), [(5.0, 0.1, 0.4), (80.0, 0.02, 0.1), (80.0, 0.7, 0.7)])
def test_a_push_is_larger_than_a_share_of_the_torque_and_than_friction(
    size: float, friction: float, least: float
) -> None:
    """40 % of the torque of 1 N·m, a quarter of that where it stands out four times as much as what is sure."""
    residuals = Residuals((), np.array([9.0, 1.0]), np.array([9.0, friction]))
    one = Episode(0, 1, 0.0, 0.1, 0.05, 1.0, 0.1, 0.01, size)
    assert least_peak(one, residuals, OutsideForceSettings()) == pytest.approx(least)


@pytest.mark.parametrize("seed", [1437, 2111, 3124])
def test_a_moment_that_smoothing_turns_round_is_passed_over(seed: int) -> None:
    """A force that is up over 60 ms and down over the 70 ms that its begin and end are looked for in has no centre."""
    rng = np.random.default_rng(seed)
    time = 0.02 * np.arange(35)
    force = rng.standard_t(1.5, (35, 1)) * np.where(np.arange(35) > 24, 8, 1)[:, None]
    one = Residual(time, force, np.zeros((35, 1)), np.ones(35, bool))
    none = Repeats(np.zeros((35, 1)), np.zeros((35, 1)), np.zeros(35))
    assert all(found.peak * found.size > 0 for found in episodes_at([one], [force], [none], 0, 4.0))


@pytest.mark.parametrize("rows", [2, 20, 60])
def test_short_and_slow_logs_have_no_force_from_outside(arm: Robot, rows: int) -> None:
    """Few rows at 500, 25 and 6 Hz: nothing stands out, and nothing fails."""
    logs = [arm_swing(k, []) for k in range(3)]
    slow = [log.downsample(80) for log in logs]
    assert not find([log.first_rows(rows) for log in logs], arm).forces
    assert not find([log.first_rows(min(rows, 25)) for log in slow], arm).forces
    assert not find([log.downsample(20).first_rows(100) for log in logs], arm).forces


def moment(begin_s: float, end_s: float, impulse: float, size: float, dof: int = 0) -> Episode:
    return Episode(0, dof, begin_s, end_s, (begin_s + end_s) / 2, impulse, impulse, 0.01, size)


@pytest.mark.parametrize(("after", "swinging"), [(-0.9, True), (-0.5, False), (0.9, False), (0.0, False)])
def test_a_force_that_swings_back_is_no_push(after: float, swinging: bool) -> None:
    """1 N·m for 0.2 s, then a force for as long: back by most of it, as a wrong model does when a motion turns."""
    time = 0.01 * np.arange(100)
    force = np.where((time > 0.395) & (time < 0.605), 1.0, np.where((time > 0.605) & (time < 0.815), after, 0.0))
    one = Residual(time, force[:, None], np.zeros((100, 1)), np.ones(100, bool))
    assert swings(one, force, moment(0.395, 0.605, 0.21, 9.0)) is swinging
    assert swings(one, -force, moment(0.395, 0.605, -0.21, -9.0)) is swinging


@pytest.mark.parametrize(
    ("times", "dofs", "signs", "common"),
    [
        ((0.8, 0.8, 0.8, 0.8), (2, 2, 2, 2), (1, 1, 1, 1), [True] * 4),
        ((0.8, 0.81, 0.79, 1.6), (2, 2, 2, 2), (1, 1, 1, 1), [True] * 3 + [False]),
        ((0.8, 0.8, 0.5, 1.6), (2, 2, 2, 2), (1, 1, 1, 1), [False] * 4),  # two logs may be pushed at one time
        ((0.8, 0.8, 0.8, 0.8), (0, 1, 2, 3), (1, 1, 1, 1), [False] * 4),
        ((0.8, 0.8, 0.8, 0.8), (2, 2, 2, 2), (1, -1, 1, -1), [False] * 4),
    ],
)
def test_what_most_logs_show_at_one_time_is_no_push(
    times: tuple, dofs: tuple, signs: tuple, common: list[bool]
) -> None:
    found = [
        replace(moment(time - 0.05, time + 0.05, sign * 4.0, 9.0, dof), log=log)
        for log, (time, dof, sign) in enumerate(zip(times, dofs, signs, strict=True))
    ]
    assert [in_most_logs(one, found, 4) for one in found] == common


def test_of_moments_at_one_time_the_one_that_stands_out_most_is_told() -> None:
    """A push at the elbow is felt at the shoulder; a push later, or in another log, is another one."""
    elbow, shoulder = moment(1.0, 1.2, 0.2, 30.0, 1), moment(1.15, 1.3, -0.05, -6.0)
    later, other = moment(1.3, 1.4, 0.1, 5.0), replace(shoulder, log=1)
    assert largest_of_each_moment([shoulder, elbow, later, other]) == [elbow, other, later]


def test_a_vertical_force_on_a_base_may_be_the_grounds() -> None:
    force = OutsideForce("squat", "base", "z", 4.66, 4.6, 4.72, 828.0, 69.0, (50.0, 89.0), "N", 12.0)
    assert force.says == "at 4.66 s in squat, base, +830 N along z for 0.12 s (or the ground did)"
    assert replace(force, axis="x", peak=-4.2).says == "at 4.66 s in squat, base, -4.2 N along x for 0.12 s"
