"""The steps of the horizon, on the grid and off it."""

import numpy as np
import pytest

from leapgap.jumping.control.condensed_qp import horizon
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.task import ContactSchedule

GRIDS = [TimeGrid(0.025, 0.1, 10), TimeGrid(0.025, 0.025, 22), TimeGrid(0.05, 0.05, 10), TimeGrid(0.03, 0.09, 7)]
SCHEDULES = [ContactSchedule(), ContactSchedule(0.41, 0.22, 0.37)]


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("schedule", SCHEDULES)
def test_steps_end_at_take_off_and_at_the_landing_from_any_time(grid: TimeGrid, schedule: ContactSchedule) -> None:
    for time_s in np.arange(0, schedule.landing_s - 1e-9, 0.0013):
        steps = horizon(grid, schedule, time_s)
        assert 1 <= len(steps) <= grid.steps
        assert steps.time_s[0] == time_s
        assert steps.step_s.min() > 0
        assert steps.time_s[-1] < schedule.landing_s + 1e-9
        straddling = (steps.time_s[:-1] < schedule.take_off_s - 1e-6) & (steps.time_s[1:] > schedule.take_off_s + 1e-6)
        assert not straddling.any()
        whole = np.where(steps.contact, grid.contact_step_s, grid.flight_step_s)
        assert np.allclose(steps.step_s[1:-1], whole[1:-1])
        rest_of_flight = schedule.flight_s % grid.flight_step_s  # goes to its last step, or is one
        assert steps.step_s[0] < 1.5 * whole[0] + rest_of_flight + 1e-9
        at_end = np.isclose(steps.time_s[1], [schedule.take_off_s, schedule.landing_s]).any()
        assert at_end or steps.step_s[0] > whole[0] / 2 - 1e-5
        if len(steps) < grid.steps:
            assert steps.time_s[-1] == pytest.approx(schedule.landing_s)


@pytest.mark.parametrize("schedule", SCHEDULES)
def test_the_pairs_push_as_long_as_scheduled(schedule: ContactSchedule) -> None:
    steps = horizon(TimeGrid(0.025, 0.1, 100), schedule, 0.0)
    assert steps.step_s @ steps.share == pytest.approx([schedule.double_contact_s, schedule.take_off_s])


def test_contact_steps_shrink_as_take_off_nears_and_ten_reach_the_landing() -> None:
    grid, schedule = TimeGrid(), ContactSchedule()
    counts = [int(horizon(grid, schedule, t).contact.sum()) for t in np.arange(0.55, 0.80, 0.025)]
    assert counts == [10, 9, 8, 7, 6, 5, 4, 3, 2, 1]
    ends = [0.675, 0.7, 0.725, 0.75, 0.775, 0.8, 0.9, 1.0, 1.1, 1.2]
    assert horizon(grid, schedule, 0.65).time_s == pytest.approx([0.65, *ends])
    assert len(horizon(grid, schedule, 0.775)) == 5, "nothing is predicted past the landing"
    assert len(horizon(grid, schedule, 1.2)) == len(horizon(grid, schedule, 1.3)) == 0


def test_updates_on_the_grid_see_the_samples_that_learning_sees() -> None:
    grid, schedule = TimeGrid(), ContactSchedule()
    samples = grid.sample_times(schedule)
    for first in range(len(samples) - grid.steps):
        assert horizon(grid, schedule, samples[first]).time_s == pytest.approx(samples[first : first + grid.steps + 1])


def test_a_sliver_of_a_step_joins_the_next() -> None:
    steps = horizon(TimeGrid(), ContactSchedule(), 0.112)
    assert steps.step_s[:3] == pytest.approx([0.013, 0.025, 0.025])
    assert horizon(TimeGrid(), ContactSchedule(), 0.114).step_s[:2] == pytest.approx([0.036, 0.025])
    assert horizon(TimeGrid(), ContactSchedule(), 0.799).step_s[:2] == pytest.approx([0.001, 0.1])


def test_a_lift_off_inside_a_step_shares_it() -> None:
    steps = horizon(TimeGrid(), ContactSchedule(0.51, 0.29, 0.4), 0.5)
    assert steps.share[0] == pytest.approx([0.4, 1.0])
    assert steps.share[1] == pytest.approx([0.0, 1.0])
