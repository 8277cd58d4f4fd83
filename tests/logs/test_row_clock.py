"""The clock of rows from the motion of the joints, on logs of plain MuJoCo whose writer has a clock of its own."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.checks import run_checks
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo, check_read
from leapgap.logs.row_clock import row_clock, with_clock
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
    kept = [rule.kept for rule in clock.filters.values()]
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
