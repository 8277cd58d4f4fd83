"""Cutting of jump logs into windows, against the rows of the logs and a clock of its own."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.learning import window_extraction
from leapgap.jumping.learning.windows import ARRAYS, TimeGrid
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.log import Log
from leapgap.logs.metadata import Segment
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.kinematics import feet_in_world
from tests.jumping.learning.conftest import CROUCH, jumps, pose, synthetic_jump  # noqa: F401 - fixtures

PUBLISHED_ROWS = [*range(0, 776, 25), *range(800, 1201, 100)]


@pytest.fixture
def jump(jumps: list[Log]) -> Log:  # noqa: F811
    return jumps[1]


def without(jump: Log, *prefixes: str) -> Log:
    return replace(jump, columns={k: v for k, v in jump.columns.items() if not k.startswith(prefixes)})


@pytest.mark.parametrize(
    "contact_s, flight_s, k, steps",
    [(0.025, 0.1, 10, 36), (0.025, 0.08, 10, 37), (0.05, 0.05, 10, 24), (0.025, 0.025, 22, 48), (0.1, 0.1, 12, 12)],
)
def test_a_jump_gives_n_minus_k_plus_one_windows(jumps, robot, contact_s, flight_s, k, steps):  # noqa: F811
    found = window_extraction.cut(jumps[:2], TimeGrid(contact_s, flight_s, k), robot)
    assert len(found) == 2 * (steps - k + 1)
    assert found.state.shape == (len(found), k + 1, 6) and found.force.shape == (len(found), k, 4)


def test_flags_lengths_and_numbers_of_the_steps(jump, robot):
    found = window_extraction.cut([jump], TimeGrid(), robot)
    assert len(found) == 27
    i, k = np.indices((27, 10))
    np.testing.assert_array_equal(found.contact, i + k < 32)
    np.testing.assert_allclose(found.inputs.step_s, np.where(i + k < 32, 0.025, 0.1))
    np.testing.assert_array_equal(found.start, np.arange(27))


def test_states_forces_and_feet_are_those_of_the_rows(jump, robot):
    found = window_extraction.cut([jump], TimeGrid(), robot)
    for window, sample in ((0, 0), (5, 3), (26, 9)):
        row = PUBLISHED_ROWS[window + sample] // 5  # a row every 5 ms
        state = found.state[window, sample]
        assert state[0] + found.start_x[window] == pytest.approx(jump["base_pos_x"][row])
        assert state[1] == jump["base_pos_z"][row] and state[2] == pytest.approx(jump.pitch[row])
        assert state[5] == jump["base_angvel_y"][row]
        whole = jump.pair_force("mpc_force")[row] + jump.pair_force("pd_force")[row]
        np.testing.assert_allclose(found.force[window, sample], whole if window + sample < 32 else 0)
        position, quaternion = pose((state)[None])
        feet = feet_in_world(robot, position, quaternion, CROUCH[None])[0] - position[0]
        by_name = dict(zip(robot.feet, feet, strict=True))
        front, rear = (by_name["FR"] + by_name["FL"]) / 2, (by_name["RR"] + by_name["RL"]) / 2
        np.testing.assert_allclose(found.foot[window, sample], [*front[[0, 2]], *rear[[0, 2]]], atol=1e-12)
    assert (found.state[:, 0, 0] == 0).all()


def test_forces_logged_in_flight_are_not_used(jump, robot):
    noisy = replace(
        jump, columns={**jump.columns, **{f"train_force/{axis}": np.full(len(jump), 7.0) for axis in PAIR_FORCE_AXES}}
    )
    found = window_extraction.cut([noisy], TimeGrid(), robot)
    assert (found.force[found.contact] == 7).all()  # and the source's own u comes first
    assert (found.force[~found.contact] == 0).all()


def test_a_shift_in_x_changes_nothing_but_start_x(jump, robot):
    shifted = replace(jump, columns={**jump.columns, "base_pos_x": jump["base_pos_x"] + 3.0})
    here, there = (window_extraction.cut([j], TimeGrid(), robot) for j in (jump, shifted))
    np.testing.assert_allclose(there.start_x, here.start_x + 3.0)
    for name in set(ARRAYS) - {"start_x"}:
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), atol=1e-12, err_msg=name)


def test_rows_are_found_by_the_clock_not_by_their_number(jump, robot):
    kept = np.sort(np.unique([*(np.array(PUBLISHED_ROWS) // 5), *range(3, 240, 7)]))
    thinned = replace(jump, columns={k: v[kept] for k, v in jump.columns.items()})
    np.testing.assert_array_equal(
        window_extraction.cut([thinned], TimeGrid(), robot).state,
        window_extraction.cut([jump], TimeGrid(), robot).state,
    )


@pytest.mark.parametrize(
    "spoil, grid, said",
    [
        (
            lambda j: j,
            TimeGrid(steps=40),
            "jump_01: found windows of 40 steps; expected 36 steps or fewer: all that this jump's schedule has; "
            "shorten the window (chunk.steps), or make the steps shorter",
        ),
        (
            lambda j: j,
            TimeGrid(flight_step_s=0.15),
            "jump_01, time grid, flight: found 0.4 s, which is not a whole number of 0.15 s steps; "
            "expected for instance 0.3 s or 0.45 s; choose a step that divides the phase, or another schedule",
        ),
        (
            lambda j: j.first_rows(200),
            TimeGrid(),
            "jump_01: found a log that ends at 0.995 s; expected one that reaches 1.2 s",
        ),
        (lambda j: without(j, "pd_force"), TimeGrid(), "jump_01: found no forces (only mpc_force)"),
        (lambda j: without(j, "mpc_force", "pd_force"), TimeGrid(), "jump_01: found no forces (no column of them)"),
        (
            lambda j: without(j, "base_"),
            TimeGrid(),
            "jump_01: found no base state (no base_pos_x, base_pos_z, base_quat_w",
        ),
        (
            lambda j: replace(j, columns={k: v[abs(j.time - 0.625) > 0.004] for k, v in j.columns.items()}),
            TimeGrid(),
            "jump_01, column time: found no row within 2.5 ms of 0.625 s",
        ),
    ],
)
def test_bad_input_is_named(jump, robot, spoil, grid, said):
    with pytest.raises(InputError) as raised:
        window_extraction.cut([spoil(jump)], grid, robot)
    assert str(raised.value).startswith(said)


def test_jumps_of_two_schedules_do_not_mix(jump, robot):
    other = synthetic_jump("other", robot, ContactSchedule(0.5, 0.3, 0.5))
    with pytest.raises(InputError, match="other: found ContactSchedule"):
        window_extraction.cut([jump, other], TimeGrid(), robot)


def test_a_jump_after_a_stand_is_refused(jump, robot):
    info = replace(jump.info, stated_segments=(Segment("stand", 0.0, 0.3), Segment("double_contact", 0.3, 0.8)))
    with pytest.raises(InputError, match=r"jump_01: found a stand of 0\.3 s before the jump; expected"):
        window_extraction.cut([jump, replace(jump, info=info)], TimeGrid(), robot)


def test_planned_forces_leave_the_joint_pd_out(jump, robot):
    total, planned = (window_extraction.cut([jump], TimeGrid(), robot, force) for force in ("total", "planned"))
    np.testing.assert_allclose(planned.force, 0.75 * total.force, atol=1e-12)  # of the synthetic jumps' law
    with pytest.raises(InputError, match=r"jump_01: found no planned forces \(no mpc_force\)"):
        window_extraction.cut([without(jump, "mpc_force")], TimeGrid(), robot, "planned")
    with pytest.raises(InputError, match=r"chunk.force: found all; expected one of total, planned"):
        window_extraction.cut([jump], TimeGrid(), robot, "all")


@pytest.mark.parametrize(
    "contact_s, flight_s, k, schedule",
    [
        (0.025, 0.08, 10, ContactSchedule()),
        (0.05, 0.05, 10, ContactSchedule()),
        (0.025, 0.025, 10, ContactSchedule()),
        (0.02, 0.1, 7, ContactSchedule(0.3, 0.2, 0.3)),
        (0.1, 0.05, 1, ContactSchedule(0.4, 0.2, 0.25)),
    ],
)
def test_the_switch_inside_a_window_falls_on_its_step(robot, contact_s, flight_s, k, schedule):
    """Against a clock: each step begins where the last ended, and pushes iff it begins before take-off."""
    one = synthetic_jump("any", robot, replace(schedule), grid=TimeGrid(contact_s, flight_s))
    found = window_extraction.cut([one], TimeGrid(contact_s, flight_s, k), robot)
    clock = [0.0]
    while clock[-1] < schedule.landing_s - 1e-9:
        clock.append(clock[-1] + (contact_s if clock[-1] < schedule.take_off_s - 1e-9 else flight_s))
    assert len(found) == len(clock) - k
    for window in range(len(found)):
        times = np.array(clock[window : window + k + 1])
        np.testing.assert_allclose(found.time_s[window], times, atol=1e-9)
        np.testing.assert_array_equal(found.contact[window], times[:-1] < schedule.take_off_s - 1e-9)
        rows = np.round(times / one.info.sample_period_s).astype(int)
        np.testing.assert_array_equal(found.state[window, :, 1], one["base_pos_z"][rows])
    switching = found.contact.any(axis=1) & ~found.contact.all(axis=1)
    assert switching.any() == (k > 1)
    assert (found.force[~found.contact] == 0).all() and (found.force[found.contact] != 0).any(axis=-1).all()


def test_a_nan_is_found_when_the_log_is_read(jump):
    height = jump["base_pos_z"].copy()
    height[17] = np.nan
    with pytest.raises(InputError, match=r"jump_01, column base_pos_z: found 1 values .*first in row 17"):
        replace(jump, columns={**jump.columns, "base_pos_z": height})
