"""One long log cut into parts."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.logs.cutting import at_least_two
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import Segment


def long_log(seconds: float) -> Log:
    time = np.arange(round(200 * seconds)) / 200
    names = ("joint_pos/j", "cmd_tau/j", "cmd_pos/j", "cmd_vel/j", "cmd_kp/j", "cmd_kd/j")
    segments = (Segment("slow", 0.0, 7.0), Segment("fast", 7.0, 20.0))
    info = LogInfo("one", 0.005, "a test", stated_segments=segments)
    return Log("chirp", {"time": time} | {name: time.copy() for name in names}, info)


def test_every_row_of_a_single_log_is_in_one_part() -> None:
    log = long_log(20.001)
    parts = at_least_two([log])
    assert [part.name for part in parts] == [f"chirp_{k}" for k in range(1, 9)]
    assert np.concatenate([part["joint_pos/j"] for part in parts]) == pytest.approx(log["joint_pos/j"])
    assert all(part.time[0] == 0 for part in parts)
    assert [[one.name for one in part.info.segments] for part in parts[:3]] == [["slow"], ["slow"], ["slow", "fast"]]
    assert parts[2].info.segments[1].begin_s == pytest.approx(2.0)


def test_a_short_log_is_cut_less_and_several_logs_not_at_all() -> None:
    assert len(at_least_two([long_log(1.7)])) == 3
    assert len(at_least_two([long_log(0.6)])) == 1
    assert len(at_least_two([long_log(20.0), long_log(20.0)])) == 2


def test_parts_of_a_jump_keep_the_times_of_its_phases() -> None:
    """The jump states its schedule alone: 0.5 s on all feet, 0.3 s on the rear feet, 0.4 s in flight."""
    log = long_log(3.0)
    schedule = {"double_contact_s": 0.5, "rear_contact_s": 0.3, "flight_s": 0.4}
    info = LogInfo("one", 0.005, "a test", extra={"schedule": schedule, "target": {"x_m": 0.6, "z_m": 0.0}})
    parts = at_least_two([replace(log, info=info)])
    assert [round(float(part.time[-1]), 3) for part in parts] == [0.595] * 5
    names = [[one.name for one in part.info.segments] for part in parts]
    assert names[:2] == [["double_contact", "rear_contact"], ["rear_contact", "lift_off", "flight"]]
    assert names[2:] == [["touch_down"]] * 3
    assert [one.begin_s for one in parts[0].info.segments] == pytest.approx([0.0, 0.5])
    assert [one.begin_s for one in parts[1].info.segments] == pytest.approx([0.0, 0.15, 0.25])
