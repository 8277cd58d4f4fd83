import dataclasses
from pathlib import Path

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.channels import logged_channels, sensor_noise
from leapgap.diagnosis.checks.base_clock import BaseClock
from leapgap.diagnosis.checks.free_fall import FreeFall
from leapgap.diagnosis.checks.joint_clock import JointClock
from leapgap.diagnosis.checks.planted_feet import PlantedFeet
from leapgap.diagnosis.gap import HeldOutGap, candidate_squares, headline_gap, noise_floor, scaled_error, scaled_errors
from leapgap.diagnosis.horizons import replayer_at
from leapgap.diagnosis.judged_logs import JudgedLogs, headline_rows
from leapgap.diagnosis.localisation import localise, phase_names, phase_of_rows
from leapgap.logs.log import Log, LogInfo, read_logs
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan, run_open_loop
from leapgap.simulation.replay import Replayer
from leapgap.simulation.sensors import SensorNoise
from tests import plain_arm
from tests.conftest import standing

SILENT = SensorNoise(0, 0, 0, 0, 0, 0)


def hardware(robot: Robot, reference: Log, *found: effects.Effect, noise: SensorNoise = SILENT, jumps: int = 1):
    plans = [MotionPlan(f"made_{i}", reference, 0.01 * i) for i in range(jumps)]
    return run_open_loop(plans, robot, found, noise, Course(), np.random.default_rng(0))


def test_real_jumps_have_the_published_gap(robot: Robot, real_jumps: list[Log]) -> None:
    """The project's reference figure: 0.94 for the sixteen jumps on rows 0 to 1089 with the nominal robot."""
    sixteen = [jump for jump in real_jumps if jump.name in {f"jump_{i:02d}" for i in (*range(1, 11), *range(15, 21))}]
    judged = JudgedLogs.of(sixteen, robot)
    assert set(judged.rows) == {1090}
    gap = headline_gap(candidate_squares(judged, Replayer(robot), [[()] * len(sixteen)])[0], judged)
    assert gap == pytest.approx(0.942, abs=0.01)


def test_the_nominal_robot_without_noise_has_no_gap(robot: Robot, reference: Log) -> None:
    judged = JudgedLogs.of(hardware(robot, reference), robot)
    assert headline_gap(candidate_squares(judged, Replayer(robot), [[()]])[0], judged) < 1e-6


def test_the_noise_floor_is_the_gap_of_a_perfect_model(robot: Robot, reference: Log) -> None:
    """Logs of the nominal robot with noise: what is left is the floor, estimated from the logs alone."""
    jumps = hardware(robot, reference, noise=SensorNoise(), jumps=3)
    judged, replayer = JudgedLogs.of(jumps, robot), Replayer(robot)
    gap = headline_gap(candidate_squares(judged, replayer, [[()] * 3])[0], judged)
    floor = headline_gap(noise_floor(judged, replayer, 4, np.random.default_rng(1)), judged)
    assert 0.4 < gap / floor < 2.5


def test_the_error_of_the_steps_is_that_to_replays_by_very_short_ones(tmp_path: Path) -> None:
    """An arm without noise or fault, swung by plain MuJoCo: what is left is of the steps, and is no gap to explain."""
    robot = Robot.load(plain_arm.write_model(tmp_path))
    logs = read_logs(plain_arm.write_parquet(tmp_path / "logs", 3, plain_arm.arm()))
    judged, replayer = JudgedLogs.of(logs, robot), Replayer(robot)
    gap = HeldOutGap.of(judged, replayer, 3, 2, 10, np.random.default_rng(0))
    at_all = replayer_at(replayer.with_steps(2e-5), gap.horizon_s).motions(judged.whole_trials())
    pairs = enumerate(zip(at_all, gap.nominal_motions, strict=True))
    left = [scaled_error(a, judged, log) - scaled_error(b, judged, log) for log, (a, b) in pairs]
    assert gap.of_steps == pytest.approx(np.sqrt(np.mean([(own**2).mean() for own in left])), rel=0.1)
    exact = gap.by_exact_steps
    assert exact is not gap
    assert exact.of_steps == pytest.approx(0.25 * gap.of_steps, rel=0.1)


def test_noise_is_read_off_the_high_frequencies(robot: Robot, reference: Log) -> None:
    (jump,) = hardware(robot, reference, noise=dataclasses.replace(SILENT, base_pos_m=0.002, joint_vel_rad_s=0.07))
    known = logged_channels([jump], robot)
    noise = sensor_noise(motion_of(jump, robot), jump.info.sample_period_s, known, robot)
    found = dict(zip((channel.name for channel in known), noise, strict=True))
    assert found["base_pos_z"] == pytest.approx(0.002, rel=0.15)
    assert found["joint_vel/RR_calf"] == pytest.approx(0.07, rel=0.15)
    assert found["joint_pos/RR_calf"] < 1e-4


def test_errors_are_scaled_as_the_contract_says(robot: Robot) -> None:
    """A log lifted by 5 cm in its claimed height differs by one at once, in height alone."""
    jump = standing(robot, 100)
    lifted = Log(
        "lifted", dict(jump.columns) | {"base_pos_z": jump["base_pos_z"] + 0.05 * (np.arange(100) > 0)}, jump.info
    )
    judged = JudgedLogs.of([lifted], robot)
    (error,) = scaled_errors(judged, Replayer(robot), [[()]])[0]
    names = [channel.name for channel in judged.channels]
    assert error[1, names.index("base_pos_z")] == pytest.approx(-1, abs=1e-3)
    assert error[1, names.index("base_pos_x")] == pytest.approx(0, abs=1e-3)


def test_judged_rows_end_at_touch_down_or_before_other_gains(robot: Robot, reference: Log) -> None:
    (jump,) = hardware(robot, reference)
    touch = headline_rows(jump, robot)
    assert 1000 < touch < 1300
    kp = np.where(np.arange(len(jump)) < 900, 300.0, 50.0)
    changed = Log("c", dict(jump.columns) | {"cmd_kp/FR_calf": kp}, jump.info)
    assert headline_rows(changed, robot) == 890


def test_phases_follow_the_schedule(reference: Log) -> None:
    names = phase_names([reference])
    named = [names[p] for p in phase_of_rows(reference, names)]
    assert [named[row] for row in (0, 499, 500, 749, 750, 849, 850, 1199, 1200)] == [
        "double_contact",
        "double_contact",
        "rear_contact",
        "rear_contact",
        "lift_off",
        "lift_off",
        "flight",
        "flight",
        "touch_down",
    ]


def test_where_finds_the_weak_joint_in_its_phases(robot: Robot, reference: Log) -> None:
    weak = effects.effect("torque_gain", location="RR_calf", scale=0.6)
    jumps = hardware(robot, reference, weak, noise=SensorNoise())
    places = localise(JudgedLogs.of(jumps, robot), Replayer(robot), 0.1, 3, np.random.default_rng(0))
    assert sum(place.share for place in places) == pytest.approx(1)
    assert "RR_calf" in places[0].channel
    assert places[0].phase in ("rear_contact", "lift_off")


def test_where_is_told_above_noise(robot: Robot, reference: Log) -> None:
    """An effect that leaves less than noise in each place is found where logs without noise show it."""
    drag = effects.effect("aerodynamic_drag", coefficient=2.0)
    tops = []
    for noise_of in (SILENT, SensorNoise()):
        jumps = hardware(robot, reference, drag, noise=noise_of, jumps=4)
        places = localise(JudgedLogs.of(jumps, robot), Replayer(robot), 0.1, 3, np.random.default_rng(0))
        tops.append((places[0].phase, places[0].channel))
    assert tops[0] == tops[1]


def test_clock_check_recovers_a_known_period(robot: Robot, reference: Log) -> None:
    slow = hardware(robot, reference, effects.effect("sample_period", scale=1.07), noise=SensorNoise(), jumps=2)
    check = JointClock().run(slow, robot, threshold=0.02)
    assert check is not None and not check.passed
    assert check.per_log["made_0"] == pytest.approx(1.07, abs=0.01)
    assert "runs slower than the log claims" in check.says
    true = hardware(robot, reference, noise=SensorNoise(), jumps=2)
    for judge in (JointClock().run, BaseClock().run):
        assert judge(true, robot, 0.02).passed


def test_fall_and_planted_feet_pass_on_a_true_log_and_fail_on_a_false_one(robot: Robot, reference: Log) -> None:
    (jump,) = hardware(robot, reference, noise=SensorNoise())
    assert FreeFall().run([jump], robot, 0.08).passed
    assert PlantedFeet().run([jump], robot, 0.01).passed
    drift = np.linspace(0, 0.05, len(jump))
    false = Log(
        "f",
        dict(jump.columns)
        | {"base_pos_z": jump["base_pos_z"] - 20 * drift**2, "base_pos_x": jump["base_pos_x"] + drift},
        jump.info,
    )
    assert not PlantedFeet().run([false], robot, 0.01).passed


def test_a_log_that_states_no_flight_is_judged_whole(tmp_path: Path) -> None:
    """An arm that swings for two seconds is compared for two seconds, and not for the 1.2 s of a jump."""
    arm = Robot.load(plain_arm.write_model(tmp_path))
    logs = read_logs(plain_arm.write_parquet(tmp_path / "logs", logs=2))
    assert JudgedLogs.of(logs, arm).rows == (2000, 2000)
    assert {
        place.phase for place in localise(JudgedLogs.of(logs, arm), Replayer(arm), 0.1, 1, np.random.default_rng(0))
    } == {
        "part_1",
        "part_2",
        "part_3",
        "part_4",
    }


def test_flight_and_planted_feet_are_not_judged_of_a_robot_that_never_flies_or_stands(robot: Robot) -> None:
    """Diagonal pairs of feet in turn, as in a trot: some foot always touches, and never all of them."""
    rows = np.arange(1000)
    first = ((rows // 250) % 2 == 0).astype(float)
    contacts = {f"contact/{foot}": first if foot in ("FR", "RL") else 1 - first for foot in robot.feet}
    trot = standing(robot, 1000, **contacts)
    trot = Log("trot", trot.columns, LogInfo("a1", 0.001, "a test"))
    assert FreeFall().run([trot], robot, 0.08) is None
    assert PlantedFeet().run([trot], robot, 0.01) is None
