"""Velocities of plain MuJoCo through a filter written here, and back."""

import numpy as np
import pytest

from leapgap.logs.message_clock import filter_of, obeyed_filters
from leapgap.logs.row_clock import with_clock, without_filter
from leapgap.logs.row_clock_estimate import row_clock
from tests.logs.test_row_clock import FILTER, JOINTS, STEP_S, motion, of_messages


def filtered(position: np.ndarray) -> np.ndarray:
    """What a controller shows as velocity that keeps a share of the one before, (steps,)."""
    shown = np.zeros(len(position))
    for step in range(1, len(position)):
        difference = (position[step] - position[step - 1]) / STEP_S
        shown[step] = FILTER * shown[step - 1] + (1 - FILTER) * difference
    return shown


def test_up_to_two_steps_apart_the_filter_is_undone_exactly_and_further_apart_mostly() -> None:
    positions, velocities, _ = motion(2.0)
    position, velocity = positions[:, 1], velocities[:, 1]
    shown = filtered(position)
    steps = np.random.default_rng(3).choice([1, 2, 3, 5], 600, p=(0.4, 0.3, 0.2, 0.1))
    at = 20 + np.concatenate([[0], np.cumsum(steps)])
    found = without_filter(position[at], shown[at], at * STEP_S, STEP_S, FILTER)
    # Semi-implicit: the velocity of a step is what moved the position into it.
    wrong, late = (np.abs(own - velocity[at])[1:] for own in (found, shown[at]))
    assert wrong[steps <= 2].max() < 1e-9
    assert np.median(wrong[steps > 2]) < 0.1 * np.median(late[steps > 2])


def test_wrong_instants_leave_at_worst_a_lag() -> None:
    positions, velocities, _ = motion(2.0)
    position, velocity = positions[:, 1], velocities[:, 1]
    shown = filtered(position)
    at = 20 + np.cumsum(np.random.default_rng(4).choice([1, 2, 3], 600))
    claimed = at.copy()
    claimed[1::7] += 1  # one step late, as a clock may be that few joints tell
    found = without_filter(position[at], shown[at], claimed * STEP_S, STEP_S, FILTER)
    wrong, late = (np.sqrt(np.mean((own - velocity[at])[1:] ** 2)) for own in (found, shown[at]))
    assert wrong < late


def test_a_log_by_its_own_clock_has_velocities_without_their_filter() -> None:
    log, _ = of_messages()
    clock = row_clock(log, JOINTS)
    assert clock is not None
    own, _ = with_clock(log, clock)
    for joint in JOINTS:
        moved = np.gradient(own[f"joint_pos/{joint}"], own.time)  # the mean of both sides: neither early nor late
        as_written = np.interp(own.time, clock.sampled[f"joint_vel/{joint}"], log[f"joint_vel/{joint}"])
        late, own_velocity = (np.std((moved - v)[5:-5]) for v in (as_written, own[f"joint_vel/{joint}"]))
        assert own_velocity < 0.8 * late


def test_the_rule_is_told_and_one_message_with_noise_follows_the_others() -> None:
    positions, _, _ = motion(1.0)
    position = positions[20:]
    shown = np.stack([filtered(positions[:, k]) for k in (0, 1)], axis=1)[20:]
    rule = filter_of(position, shown, STEP_S * np.arange(len(position)), STEP_S)
    assert rule is not None and rule[0] == pytest.approx(FILTER, abs=1e-6) and rule[1] > 0.99
    told = obeyed_filters({"a": rule, "b": (0.355, 0.5), "c": (0.6, 0.5), "d": None})
    assert set(told) == {"a", "b"}
    assert obeyed_filters({"b": (0.355, 0.5)}) == {}
