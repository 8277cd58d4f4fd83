"""Velocity columns that are late, filtered, coarse or of another unit: told in seconds, and no clock is blamed.

Motions are sums of sines whose velocities are known; registers are written here by hand.
"""

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.checks import as_read, run_checks
from leapgap.diagnosis.checks.base import CheckResult
from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import noisy_logs
from tests.diagnosis.two_link_arm import torque_driven_arm

JOINTS = ("shoulder", "elbow", "wrist")
Motion = tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]


def sines(seed: int, size: float = 0.5, rates: tuple[float, float] = (0.3, 1.5)) -> Motion:
    """Position and velocity of one joint as functions of time."""
    rng = np.random.default_rng(seed)
    sizes, rate, phase = size * rng.uniform(0.3, 1, 3), rng.uniform(*rates, 3), rng.uniform(0, 6, 3)

    def position(t: np.ndarray) -> np.ndarray:
        return np.asarray((sizes * np.sin(2 * np.pi * rate * t[:, None] + phase)).sum(axis=1))

    def velocity(t: np.ndarray) -> np.ndarray:
        return np.asarray((sizes * 2 * np.pi * rate * np.cos(2 * np.pi * rate * t[:, None] + phase)).sum(axis=1))

    return position, velocity


def log(
    seed: int,
    report: Callable[[Motion, np.ndarray, int], np.ndarray],
    period_s: float = 0.01,
    claimed_s: float | None = None,
    joints: int = 3,
    tick: float = 0.0,
    noise: float = 1e-5,
    **of: float | tuple[float, float],
) -> Log:
    """A log whose velocity columns are what ``report`` makes of the motion of each joint, 8 s."""
    time, rng = np.arange(round(8 / period_s)) * period_s, np.random.default_rng(seed)
    columns = {"time": np.arange(len(time)) * (claimed_s or period_s)}
    for k, joint in enumerate(JOINTS[:joints]):
        motion = sines(10 * seed + k, **of)  # type: ignore[arg-type]
        position = motion[0](time) + noise * rng.standard_normal(len(time))
        columns[f"joint_pos/{joint}"] = tick * np.round(position / tick) if tick else position
        columns[f"joint_vel/{joint}"] = report(motion, time, k)
        columns |= {f"cmd_{name}/{joint}": np.zeros(len(time)) for name in ("tau", "pos", "vel", "kp", "kd")}
    return Log(f"log_{seed}", columns, LogInfo("arm", claimed_s or period_s, "a test"))


def late(seconds: float) -> Callable[[Motion, np.ndarray, int], np.ndarray]:
    return lambda motion, time, _: motion[1](time - seconds)


def filtered(constant_s: float) -> Callable[[Motion, np.ndarray, int], np.ndarray]:
    """A first-order low-pass of the true velocity, in steps of 0.1 ms."""

    def report(motion: Motion, time: np.ndarray, _: int) -> np.ndarray:
        fine = np.arange(-1.0, time[-1] + 1e-4, 1e-4)
        true, out, kept = motion[1](fine), np.empty(len(fine)), np.exp(-1e-4 / constant_s)
        out[0] = true[0]
        for k in range(1, len(fine)):
            out[k] = kept * out[k - 1] + (1 - kept) * true[k]
        return np.interp(time, fine, out)

    return report


def found(logs: list[Log]) -> dict[str, CheckResult]:
    return {check.name: check for check in run_checks(logs, None, {})}


@pytest.mark.parametrize("period_s", [0.002, 0.01, 0.02])
@pytest.mark.parametrize("lag_s", [0.02, 0.05, 0.12])
def test_a_late_velocity_is_told_in_ms_and_no_clock_is_doubted(period_s: float, lag_s: float) -> None:
    logs = [log(seed, late(lag_s), period_s) for seed in range(3)]
    checks = found(logs)
    assert not checks["velocity_channel"].passed
    told = re.match(
        r"velocities of shoulder, elbow, wrist are late (?:or filtered )?by ([\d.]+)", checks["velocity_channel"].says
    )
    assert told and float(told[1]) == pytest.approx(1000 * lag_s, abs=1.0), checks["velocity_channel"].says
    assert [name for name, check in checks.items() if not check.passed] == ["velocity_channel"]
    read = as_read(logs, list(checks.values()))
    assert not any(name.startswith("joint_vel/") for one in read for name in one.columns)


@pytest.mark.parametrize("period_s", [0.005, 0.02])
def test_a_difference_of_two_rows_is_moved_by_half_a_row(period_s: float) -> None:
    def difference(motion: Motion, time: np.ndarray, _: int) -> np.ndarray:
        return (motion[0](time) - motion[0](time - period_s)) / period_s

    rates = (0.03 / period_s, 0.05 / period_s)  # up to a twentieth of a turn a row
    logs = [log(seed, difference, period_s, rates=rates) for seed in range(2)]
    checks = found(logs)
    told = re.search(r"are differences of two rows, late by ([\d.]+)", checks["velocity_channel"].says)
    assert told and float(told[1]) == pytest.approx(500 * period_s, rel=0.1), checks["velocity_channel"].says
    assert [name for name, check in checks.items() if not check.passed] == ["velocity_channel"]
    for seed, (given, read) in enumerate(zip(logs, as_read(logs, list(checks.values())), strict=True)):
        for k, joint in enumerate(JOINTS):
            true = sines(10 * seed + k, rates=rates)[1](read.time)
            late, moved = (np.std((one[f"joint_vel/{joint}"][: len(read)] - true)[2:-2]) for one in (given, read))
            assert moved < 0.3 * late


def test_velocities_of_mujoco_stay_where_they_are(tmp_path: Path) -> None:
    """Its step advances positions by the velocity at the step's end, which is thus late by half a step."""
    robot = torque_driven_arm(tmp_path)
    logs = noisy_logs(robot.path, lambda model: None, noise=0.0)
    position, velocity = (
        logs[0].stack([f"{of}/{joint}" for joint in robot.joints]) for of in ("joint_pos", "joint_vel")
    )
    assert velocity[1:] == pytest.approx(np.diff(position, axis=0) / logs[0].info.sample_period_s, abs=1e-9)
    check = next(one for one in run_checks(logs, robot, {}) if one.name == "velocity_channel")
    assert check.passed, check.says


def test_a_filtered_velocity_is_told_from_a_late_one() -> None:
    checks = found([log(seed, filtered(0.03), rates=(1.0, 5.0), size=0.1) for seed in range(2)])
    told = re.search(r"are filtered with a time constant of ([\d.]+)", checks["velocity_channel"].says)
    assert told and float(told[1]) == pytest.approx(30, rel=0.02)
    assert [name for name, check in checks.items() if not check.passed] == ["velocity_channel"]


def test_a_velocity_that_is_off_without_lag_or_ticks_is_left_out_and_tells_no_clock() -> None:
    def blurred(motion: Motion, time: np.ndarray, joint: int) -> np.ndarray:
        noise = 0.004 * np.random.default_rng(joint).standard_normal(len(time))
        return np.asarray(0.2 * np.round(motion[1](time) / 0.2) + noise)

    checks = found([log(seed, blurred, 0.002) for seed in range(2)])
    assert "off the derivative of the positions" in checks["velocity_channel"].says
    assert [name for name, check in checks.items() if not check.passed] == ["velocity_channel"]
    assert not {"joint_clock", "even_clock"} & set(checks)


@pytest.mark.parametrize("period_s", [0.001, 0.005, 0.02])
def test_a_velocity_in_time_is_used_as_it_is(period_s: float) -> None:
    logs = [log(seed, late(0.0), period_s, noise=2e-4) for seed in range(2)]
    checks = found(logs)
    assert all(check.passed for check in checks.values()), [check.says for check in checks.values()]
    assert all(one is other for one, other in zip(as_read(logs, list(checks.values())), logs, strict=True))


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_a_slow_clock_is_told_beside_a_late_velocity(lag_s: float) -> None:
    """A loop that takes 11 ms a row and claims 10: the lag hides no clock."""
    checks = found([log(seed, late(lag_s), 0.011, claimed_s=0.010) for seed in range(3)])
    assert not checks["joint_clock"].passed
    assert checks["joint_clock"].statistic == pytest.approx(0.10, abs=0.01)
    assert checks["velocity_channel"].passed == (lag_s == 0)


def test_the_threshold_of_a_clock_does_not_grow_with_the_period() -> None:
    """Rows of 20 ms of a slow motion tell 5 %: nothing in these columns is too coarse for it."""
    (result,) = [one for one in run_checks([log(1, late(0.0), 0.02)], None, {}) if one.name == "joint_clock"]
    assert result.threshold == 0.02
    (wrong,) = [one for one in run_checks([log(1, late(0.0), 0.021, 0.02)], None, {}) if one.name == "joint_clock"]
    assert not wrong.passed and wrong.statistic == pytest.approx(0.05, abs=0.005)


def test_columns_too_coarse_for_a_clock_say_so() -> None:
    def register(motion: Motion, time: np.ndarray, _: int) -> np.ndarray:
        return np.asarray(0.024 * np.round(motion[1](time) / 0.024))

    tick = 2 * np.pi / 4096
    checks = found([log(seed, register, tick=tick, joints=1, size=0.03, rates=(0.2, 0.5)) for seed in range(3)])
    assert all(check.passed for check in checks.values()), [check.says for check in checks.values()]
    assert "they come in steps of 0.024 a second, positions in steps of 0.0015" in checks["velocity_channel"].says
    assert "the columns are too coarse to show less than" in checks["even_clock"].says


def test_velocities_coarser_than_what_positions_tell_are_not_used() -> None:
    def register(motion: Motion, time: np.ndarray, _: int) -> np.ndarray:
        return np.asarray(0.5 * np.round(motion[1](time) / 0.5))

    checks = found([log(seed, register, noise=1e-6) for seed in range(2)])
    assert "velocities of shoulder, elbow, wrist come in steps of 0.5 a second" in checks["velocity_channel"].says
    assert not checks["velocity_channel"].passed and checks["joint_clock"].passed and checks["even_clock"].passed


def test_one_joint_of_another_unit_is_no_clock() -> None:
    def gripper(motion: Motion, time: np.ndarray, joint: int) -> np.ndarray:
        return np.asarray(motion[1](time) * (2.3 if joint == 2 else 1.0))

    checks = found([log(seed, gripper) for seed in range(2)])
    assert "wrist moves 0.43 times as far as its velocities say" in checks["velocity_channel"].says
    assert [name for name, check in checks.items() if not check.passed] == ["velocity_channel"]


SERVO = """
<mujoco model="servo"><compiler angle="radian" autolimits="true"/><option timestep="0.001" integrator="implicitfast"/>
<worldbody><body><joint name="servo" axis="0 1 0" damping="0.6" armature="0.03" frictionloss="0.05"/>
<geom type="capsule" fromto="0 0 0 .12 0 0" size=".012" mass=".12"/></body></worldbody>
<actuator><position joint="servo" kp="18" forcerange="-3 3"/></actuator></mujoco>"""


@pytest.mark.long
def test_late_velocities_of_a_servo_are_neither_used_nor_taken_for_a_cause(tmp_path: Path) -> None:
    (tmp_path / "servo.xml").write_text(SERVO)
    robot, model, logs = Robot.load(tmp_path / "servo.xml"), mujoco.MjModel.from_xml_string(SERVO), []
    for seed in range(3):
        wanted = 0.8 * sines(seed)[0](np.arange(600) * 0.01)
        data, position, velocity = mujoco.MjData(model), np.empty(600), np.empty(600)
        data.qpos[:] = wanted[0]
        for row in range(600):
            position[row], velocity[row] = data.qpos[0], data.qvel[0]
            data.ctrl[:] = wanted[row]
            for _ in range(10):
                mujoco.mj_step(model, data)
        columns = {"time": np.arange(600) * 0.01, "joint_pos/servo": position + 1e-5 * np.sin(1e5 * position)}
        columns["joint_vel/servo"] = np.concatenate([np.full(5, velocity[0]), velocity[:-5]])
        sent = {"tau": 0.0, "pos": wanted, "vel": 0.0, "kp": 18.0, "kd": 0.0}
        columns |= {f"cmd_{name}/servo": np.broadcast_to(value, 600) + 0.0 for name, value in sent.items()}
        logs.append(Log(f"log_{seed}", columns, LogInfo("servo", 0.01, "plain MuJoCo")))
    report = diagnose(logs, robot, Settings(best=False)).report
    assert "late by 5" in next(check.says for check in report.checks if check.name == "velocity_channel")
    assert report.gap_nominal < 0.01 and "joint_vel" in " ".join(report.not_judged)
    assert not {"sample_period", "armature"} & {name for names in report.answer for name in names}, report.sentence
