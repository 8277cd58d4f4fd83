"""The clock of rows from the motion of the joints, on logs of plain MuJoCo whose writer has a clock of its own."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.checks import run_checks
from leapgap.diagnosis.checks.base import CheckResult
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo, check_read
from leapgap.logs.row_clock import CURVATURE, with_clock
from leapgap.logs.row_clock_estimate import START, Samples, row_clock, smooth
from tests.plain_arm import EXAMPLE, JOINTS, KD, KP

STEP_S = 0.001
CLAIMED_S = 0.001
FILTER = 0.35
"""Share of the velocity before in a simulation's filtered velocity."""


def motion(seconds: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and torques of the arm in every step of plain MuJoCo, (steps, 2) each."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(EXAMPLE.MODEL.format(elbow=EXAMPLE.TRUE))
    model.opt.timestep = STEP_S
    data, steps = mujoco.MjData(model), round(seconds / STEP_S)
    size, rate, phase = rng.uniform(0.3, 0.6, (2, 3)), rng.uniform(0.5, 2.0, (2, 3)), rng.uniform(0, 6, (2, 3))
    position, velocity, torque = (np.empty((steps, 2)) for _ in range(3))
    for step in range(steps):
        wanted = (size * np.sin(2 * np.pi * rate * step * STEP_S + phase)).sum(axis=1)
        if step == 0:
            data.qpos[:] = wanted
        position[step], velocity[step] = data.qpos, data.qvel
        torque[step] = KP * (wanted - data.qpos) - KD * data.qvel
        data.qfrc_applied[:] = torque[step]
        mujoco.mj_step(model, data)
    return position, velocity, torque


def as_log(time: np.ndarray, position: np.ndarray, velocity: np.ndarray, torque: np.ndarray) -> Log:
    """A log of torque commands."""
    columns = {"time": time}
    for i, joint in enumerate(JOINTS):
        columns |= {f"joint_pos/{joint}": position[:, i], f"joint_vel/{joint}": velocity[:, i]}
        columns |= {f"cmd_tau/{joint}": torque[:, i]}
        columns |= {f"{gain}/{joint}": np.zeros(len(time)) for gain in ("cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
    return Log("arm", columns, LogInfo("arm", CLAIMED_S, "plain MuJoCo"))


def row_steps(rows: int, rng: np.random.Generator) -> np.ndarray:
    """Steps that pass from each row to the next: 0 to 3 at random, and a stall now and then."""
    steps = rng.choice(4, rows - 1, p=(0.25, 0.4, 0.25, 0.1))
    steps[rng.integers(0, rows - 1, 6)] = 12
    return steps


def uneven(noise: float, seed: int = 1) -> tuple[Log, np.ndarray]:
    """A log whose rows last 0 to 3 steps and claim to last one, and the true length of each, s, (rows − 1,)."""
    rng = np.random.default_rng(seed)
    steps = row_steps(1500, rng)
    at = np.concatenate([[0], np.cumsum(steps)])
    position, velocity, torque = (values[at] for values in motion((at[-1] + 2) * STEP_S))
    noisy = position + noise * rng.standard_normal(position.shape)
    fast = velocity + 20 * noise * rng.standard_normal(velocity.shape)
    return as_log(CLAIMED_S * np.arange(len(at)), noisy, fast, torque), steps * STEP_S


def of_messages(seed: int = 2) -> tuple[Log, np.ndarray]:
    """A log of the latest message of each joint, each late by itself, with six digits; and when each row was written.

    Velocities are filtered differences, as some simulators compute them.
    """
    rng = np.random.default_rng(seed)
    steps = row_steps(1500, rng)
    at = np.concatenate([[3], 3 + np.cumsum(steps)])
    position, _, torque = motion((at[-1] + 2) * STEP_S)
    filtered = np.zeros_like(position)
    for step in range(1, len(position)):
        difference = (position[step] - position[step - 1]) / STEP_S
        filtered[step] = FILTER * filtered[step - 1] + (1 - FILTER) * difference
    late = rng.choice(3, (len(at), 2), p=(0.6, 0.3, 0.1))
    shown = np.maximum.accumulate(at[:, None] - late, axis=0)

    def digits(values: np.ndarray) -> np.ndarray:
        return np.array([[float(f"{value:.6g}") for value in row] for row in values])

    columns = np.arange(2)
    log = as_log(
        CLAIMED_S * np.arange(len(at)), digits(position[shown, columns]), digits(filtered[shown, columns]), torque[at]
    )
    return log, (at - at[0]) * STEP_S


def test_rows_of_noisy_logs_get_their_lengths() -> None:
    log, lengths = uneven(noise=2e-5)
    clock = row_clock(log, JOINTS)
    assert clock is not None and clock.step_s is None
    off = clock.lengths - lengths
    assert np.median(np.abs(off)) < 1e-4  # a tenth of a step
    assert np.corrcoef(clock.lengths, lengths)[0, 1] > 0.95
    assert clock.instants[-1] == pytest.approx(lengths.sum(), rel=0.01)


def test_messages_show_the_step_and_the_filter_of_the_simulation() -> None:
    log, instants = of_messages()
    clock = row_clock(log, JOINTS)
    assert clock is not None and clock.step_s == STEP_S
    # Two joints, of which one or the other is slow now and then: the clock may drift by a few steps, not by a share.
    assert np.abs(clock.instants - instants).max() < 6 * STEP_S
    assert np.mean(np.abs(clock.lengths - np.diff(instants)) < 1.5 * STEP_S) > 0.9
    kept = list(clock.filters.values())
    assert kept and np.allclose(kept, FILTER, atol=0.005)
    assert 0.2 < clock.repeated < 0.5


def test_rows_of_one_instant_become_one_with_the_last_command() -> None:
    log, instants = of_messages()
    clock = row_clock(log, JOINTS)
    assert clock is not None
    exact = replace(clock, instants=instants)
    own, kept = with_clock(log, exact)
    assert own.time[-1] == pytest.approx(instants[-1])
    assert (np.diff(own.time) > 0).all() and kept.sum() == len(np.unique(instants))
    last = np.flatnonzero(np.append(np.diff(instants) > 0, True))
    assert (own[f"cmd_tau/{JOINTS[0]}"] == log[f"cmd_tau/{JOINTS[0]}"][last]).all()


def test_an_even_log_passes_and_an_uneven_one_is_told_in_words() -> None:
    position, velocity, torque = motion(1.5)
    rng = np.random.default_rng(3)
    even = as_log(STEP_S * np.arange(1500), position + 2e-5 * rng.standard_normal(position.shape), velocity, torque)
    slow = replace(even, columns={**even.columns, "time": 0.9 * STEP_S * np.arange(1500)})
    for log in (even, replace(slow, info=replace(slow.info, sample_period_s=0.9 * STEP_S))):
        (passed,) = [check for check in run_checks([log], None, {}) if check.name == "row_clock"]
        assert passed.passed, passed.says
    (failed,) = [check for check in run_checks([of_messages()[0]], None, {}) if check.name == "row_clock"]
    assert not failed.passed
    assert "whole multiples of 1 ms" in failed.says and "0.35 of the one before" in failed.says


def test_a_joint_that_stands_still_does_not_hold_the_clock() -> None:
    """Its one sample is as old as the log, and says nothing of the time between rows."""
    log, instants = of_messages()
    still = {"joint_pos/wrist": np.full(len(log), 0.3), "joint_vel/wrist": np.zeros(len(log))}
    clock = row_clock(replace(log, columns={**log.columns, **still}), (*JOINTS, "wrist"))
    assert clock is not None and clock.step_s == STEP_S
    assert np.abs(clock.instants - instants).max() < 6 * STEP_S
    alone = row_clock(replace(log, columns={**log.columns, **still}), ("wrist",))
    assert alone is None


def test_a_log_of_a_loop_that_hangs_for_12_ms_is_read_as_one_of_lost_rows_is_not() -> None:
    """The motion goes on through a stall as its velocities say; what is lost in longer gaps nothing says."""
    rows = np.concatenate([np.arange(700), np.arange(712, 1400)])
    position, velocity, torque = motion(1.4)
    fast = 6.0  # as a jump moves its joints
    log = as_log(CLAIMED_S * np.arange(len(rows)), fast * position[rows], fast * velocity[rows], torque[rows])
    check_read(log, log.name)
    lost = np.concatenate([np.arange(600), np.arange(800, 1400)])
    log = as_log(CLAIMED_S * np.arange(len(lost)), fast * position[lost], fast * velocity[lost], torque[lost])
    with pytest.raises(InputError, match="rows were lost here"):
        check_read(log, log.name)


FAST = 3.0
"""Factor on the motion of the arm, so that its joints move as fast as those of a jump; time stays."""


def noisy(position: np.ndarray, velocity: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The motion, sped up, with the noise of sensors: 0.3 mrad and 18 mrad/s."""
    return (
        FAST * position + 3e-4 * rng.standard_normal(position.shape),
        FAST * velocity + 0.018 * rng.standard_normal(velocity.shape),
    )


def of_steps(steps: np.ndarray, seed: int) -> Log:
    """A noisy log whose rows last so many steps each and claim to last one."""
    at = np.concatenate([[0], np.cumsum(steps)])
    position, velocity, torque = (values[at] for values in motion((at[-1] + 2) * STEP_S))
    rng = np.random.default_rng(seed)
    return as_log(CLAIMED_S * np.arange(len(at)), *noisy(position, velocity, rng), torque)


def row_check(log: Log) -> CheckResult:
    """The check of the rows."""
    (found,) = [check for check in run_checks([log], None, {}) if check.name == "row_clock"]
    return found


@pytest.mark.parametrize("seed", [0, 2])
def test_a_few_stalls_are_found_with_their_lengths_and_no_other_row_moves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    steps = np.ones(1499, dtype=int)
    steps[rng.choice(1499, 8, replace=False)] = rng.integers(4, 13, 8)
    log = of_steps(steps, seed)
    clock = row_clock(log, JOINTS)
    assert clock is not None
    off = np.abs(clock.lengths - steps * STEP_S)
    assert off[steps > 1].max() < 0.5 * STEP_S and off[steps == 1].max() < 0.2 * STEP_S
    check = row_check(log)
    assert not check.passed and "stalls of 8 ms or more" in check.says


def test_a_few_lost_rows_are_found_where_the_joints_move_most() -> None:
    steps = np.random.default_rng(0).geometric(0.93, 1499)
    log = of_steps(steps, 0)
    clock = row_clock(log, JOINTS)
    assert clock is not None and clock.step_s is None
    assert np.corrcoef(clock.lengths, steps)[0, 1] > 0.9
    assert clock.instants[-1] == pytest.approx(steps.sum() * STEP_S, rel=0.01)
    assert not row_check(log).passed


def test_late_messages_of_even_rows_are_put_at_the_rows_that_they_are_of() -> None:
    rng = np.random.default_rng(4)
    position, velocity, torque = motion(1.5)
    stale = rng.random(position.shape) < 0.25
    stale[0] = False
    shown = np.maximum.accumulate(np.where(stale, 0, np.arange(1500)[:, None]), axis=0)
    at = np.take_along_axis
    seen = (at(values, shown, axis=0) for values in noisy(position, velocity, rng))
    log = as_log(CLAIMED_S * np.arange(1500), *seen, torque)
    clock = row_clock(log, JOINTS)
    assert clock is not None
    assert np.allclose(clock.lengths, STEP_S, rtol=0.01)
    for joint, rows in zip(JOINTS, shown.T, strict=True):
        assert np.allclose(clock.sampled[f"joint_pos/{joint}"], rows * clock.lengths[0])
    check = row_check(log)
    assert not check.passed and "measurements are late by varying times" in check.says
    own, kept = with_clock(log, clock)
    assert kept.all()
    error = [np.abs(of[f"joint_pos/{JOINTS[0]}"] - FAST * position[:, 0]) for of in (log, own)]
    assert error[0].max() > 0.02 and error[1].max() < 0.005  # stale samples of a joint that moves at 30 rad/s


def test_noise_does_not_add_up_over_the_rows_of_an_uneven_log() -> None:
    """What noise adds to one row it takes from the next: the instants stay right, not only the lengths."""
    steps = row_steps(1500, np.random.default_rng(1))
    clock = row_clock(of_steps(steps, 1), JOINTS)
    assert clock is not None
    off = clock.instants - np.concatenate([[0.0], np.cumsum(steps)]) * STEP_S
    assert np.abs(off).max() < 8 * STEP_S and np.std(clock.lengths - steps * STEP_S) < 0.3 * STEP_S


def test_a_smoother_over_blocks_agrees_with_one_dense_gaussian() -> None:
    """Forward and backward passes against the posterior of all unknowns at once, some samples missing."""
    rng, rows = np.random.default_rng(0), 12
    velocity = np.stack([np.linspace(14, 13, rows), np.linspace(-8, -8.4, rows)], axis=1)
    claimed, width = np.full(rows - 1, STEP_S), np.full(rows - 1, 3e-4)
    moved = np.cumsum((velocity[1:] + velocity[:-1]) / 2 * claimed[:, None], axis=0)
    position = np.concatenate([np.zeros((1, 2)), moved]) + 5e-4 * rng.standard_normal((rows, 2))
    fresh = np.ones((rows, 2), dtype=bool)
    fresh[5], fresh[8, 0] = False, False
    samples = Samples(position, velocity, fresh, np.full(2, 5e-4), np.full(2, 0.02))
    lengths, deviation = smooth(samples, claimed, claimed, width)
    speed, bend = (velocity[1:] + velocity[:-1]) / 2, np.abs(np.diff(velocity, axis=0))
    wander = ((CURVATURE * bend) ** 2 + 0.02**2) * claimed[:, None] ** 2
    # Unknown: two first positions, the lengths, and what each channel moves beside its speed in each row.
    unknown = 2 + 3 * (rows - 1)
    at = np.zeros((rows, 2, unknown))
    for row in range(rows):
        for channel in range(2):
            at[row, channel, channel] = 1
            at[row, channel, 2 : 2 + row] = speed[:row, channel]
            at[row, channel, 1 + rows + channel : 1 + rows + 2 * row : 2] = 1
    before = np.diag(np.concatenate([np.full(2, START**2), width**2, wander.ravel()]))
    mean = np.concatenate([position[0], claimed, np.zeros(2 * (rows - 1))])
    seen = at[fresh]
    gain = before @ seen.T @ np.linalg.inv(seen @ before @ seen.T + 25e-8 * np.eye(len(seen)))
    after, spread = mean + gain @ (position[fresh] - seen @ mean), np.sqrt(np.diag(before - gain @ seen @ before))
    assert np.allclose(lengths, after[2 : 1 + rows], atol=1e-8)
    assert np.allclose(deviation, spread[2 : 1 + rows], atol=1e-8)


def test_a_long_log_is_smoothed_in_blocks_as_a_short_one_is() -> None:
    steps = row_steps(1500, np.random.default_rng(1))
    log = of_steps(steps, 1)
    whole, first = row_clock(log, JOINTS), row_clock(log.first_rows(500), JOINTS)
    assert whole is not None and first is not None
    inside = slice(50, 450)
    assert np.corrcoef(whole.lengths[inside], first.lengths[inside])[0, 1] > 0.99
