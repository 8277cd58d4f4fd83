"""Windows as they are kept: the time grid, the stored form, and windows of some jumps."""

import numpy as np

from leapgap.jumping.learning import window_extraction, windows
from leapgap.jumping.learning.windows import ARRAYS, TimeGrid
from leapgap.jumping.task import ContactSchedule
from tests.jumping.learning.conftest import jumps  # noqa: F401 - fixture

PUBLISHED_ROWS = [*range(0, 776, 25), *range(800, 1201, 100)]


def test_the_published_grid_samples_the_published_rows():
    times = TimeGrid().sample_times(ContactSchedule(0.5, 0.3, 0.4))
    assert len(times) == 37
    np.testing.assert_array_equal(np.round(times * 1000), PUBLISHED_ROWS)


def test_written_windows_read_back_and_repeat_byte_for_byte(jumps, robot, tmp_path):  # noqa: F811
    found = window_extraction.cut(jumps[:2], TimeGrid(), robot)
    for folder in ("a", "b"):
        windows.write(found, tmp_path / folder)
    for file in ("windows.npz", "windows.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    back = windows.read(tmp_path / "a")
    assert (back.grid, back.schedule, back.jumps, back.robot_sha256) == (
        found.grid,
        found.schedule,
        found.jumps,
        robot.sha256,
    )
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(back, name), getattr(found, name))


def test_no_jumps_give_valid_windows_that_say_so(robot, tmp_path):
    windows.write(window_extraction.cut([], TimeGrid(), robot), tmp_path)
    back = windows.read(tmp_path)
    assert len(back) == 0 and back.jumps == () and back.state.shape == (0, 11, 6)
    assert "no logs" in (tmp_path / "windows.json").read_text()


def test_thinned_windows_are_spread_over_all_jumps(jumps, robot):  # noqa: F811
    every = window_extraction.cut(jumps, TimeGrid(), robot)
    assert every.thin(162) is every
    some = every.thin(54)
    assert np.bincount(some.jump).tolist() == [9] * 6
    assert some.start[:9].tolist() == list(range(0, 27, 3))
    np.testing.assert_array_equal(some.state, every.state[::3])


def test_windows_of_some_jumps_are_those_of_these_jumps_alone(jumps, robot):  # noqa: F811
    some = window_extraction.cut(jumps, TimeGrid(), robot).of_jumps(["jump_04", "jump_02"])
    alone = window_extraction.cut([jumps[2], jumps[4]], TimeGrid(), robot)
    assert some.jumps == alone.jumps
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(some, name), getattr(alone, name))
