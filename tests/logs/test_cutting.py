"""One long log cut into parts; many or long logs: which stretches are diagnosed, and that this is said."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.logs import cutting
from leapgap.logs.cutting import MOST_ROWS, at_least_two, choose_stretches
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import Segment


def log(name: str, seconds: float, period_s: float = 0.001, segments: tuple[Segment, ...] = ()) -> Log:
    """A log of one joint whose feed-forward torque is its time."""
    time = np.arange(round(seconds / period_s)) * period_s
    columns = {"time": time, "joint_pos/j": np.sin(time)}
    columns |= {f"{command}/j": time if command == "cmd_tau" else time * 0 for command in COMMANDS}
    return Log(name, columns, replace(LogInfo("arm", period_s, "test"), stated_segments=segments))


COMMANDS = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")


def chirp(seconds: float) -> Log:
    return log("chirp", seconds, 0.005, (Segment("slow", 0.0, 7.0), Segment("fast", 7.0, 20.0)))


def test_logs_of_usual_length_stay_as_they_are() -> None:
    logs = [log("a", 40.0), log("b", 20.0)]
    chosen, said = choose_stretches(logs)
    assert chosen == logs and said == ()


def test_two_logs_of_ten_minutes_become_stretches_spread_over_all_of_their_time() -> None:
    logs = [log("a", 600.0), log("b", 600.0)]
    chosen, (said,) = choose_stretches(logs)
    assert [len(one) for one in chosen] == [5000] * 12
    assert sum(map(len, chosen)) == MOST_ROWS
    begins = [float(one["cmd_tau/j"][0]) for one in chosen]
    assert begins == pytest.approx([*np.arange(0, 600, 100), *np.arange(0, 600, 100)])
    assert all(one.time[0] == 0.0 and one.time[-1] == pytest.approx(4.999) for one in chosen)
    assert chosen[0].name == "a_at_0_s" and chosen[-1].name == "b_at_500_s"
    assert said.startswith("12 of 240 stretches of 5 s and more, spread evenly over 2 logs, were diagnosed (60000 of")
    assert not any(np.shares_memory(one["cmd_tau/j"], logs[0]["cmd_tau/j"]) for one in chosen)


def test_of_many_short_logs_every_nth_is_taken_whole() -> None:
    jumps = [log(f"jump_{i:03d}", 1.2) for i in range(500)]
    chosen, (said,) = choose_stretches(jumps)
    assert len(chosen) == 50 and all(len(one) == 1200 for one in chosen)
    assert all(any(one is jump for jump in jumps) for one in chosen)
    assert said.startswith("50 of 500 logs, spread evenly over 500 logs, were diagnosed (60000 of 600000 samples)")


def test_one_long_log_gives_at_least_two_stretches_to_judge_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cutting, "MOST_ROWS", 100)
    chosen, _ = choose_stretches([log("a", 20.0)])
    assert [one.name for one in chosen] == ["a_at_0_s", "a_at_10_s"]


def test_segments_go_with_their_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cutting, "MOST_ROWS", 10_000)
    segments = (Segment("walk", 0.0, 7.0), Segment("stand", 7.0, 20.0))
    chosen, _ = choose_stretches([log("a", 20.0, segments=segments)])
    assert [(s.name, s.begin_s, s.end_s) for s in chosen[0].info.stated_segments] == [("walk", 0.0, 4.999)]
    (stand,) = chosen[1].info.stated_segments
    assert (stand.name, stand.begin_s) == ("stand", 0.0) and stand.end_s == pytest.approx(4.999)


def test_every_row_of_a_single_log_is_in_one_part() -> None:
    long = chirp(20.001)
    parts = at_least_two([long])
    assert [part.name for part in parts] == [f"chirp_{k}" for k in range(1, 9)]
    assert np.concatenate([part["joint_pos/j"] for part in parts]) == pytest.approx(long["joint_pos/j"])
    assert all(part.time[0] == 0 for part in parts)
    assert [[one.name for one in part.info.segments] for part in parts[:3]] == [["slow"], ["slow"], ["slow", "fast"]]
    assert parts[2].info.segments[1].begin_s == pytest.approx(2.0)


def test_a_short_log_is_cut_less_and_several_logs_not_at_all() -> None:
    assert len(at_least_two([chirp(1.7)])) == 3
    assert len(at_least_two([chirp(0.6)])) == 1
    assert len(at_least_two([chirp(20.0), chirp(20.0)])) == 2


def test_parts_of_a_jump_keep_the_times_of_its_phases() -> None:
    """The jump states its schedule alone: 0.5 s on all feet, 0.3 s on the rear feet, 0.4 s in flight."""
    schedule = {"double_contact_s": 0.5, "rear_contact_s": 0.3, "flight_s": 0.4}
    info = LogInfo("one", 0.005, "a test", extra={"schedule": schedule, "target": {"x_m": 0.6, "z_m": 0.0}})
    parts = at_least_two([replace(chirp(3.0), info=info)])
    assert [round(float(part.time[-1]), 3) for part in parts] == [0.595] * 5
    names = [[one.name for one in part.info.segments] for part in parts]
    assert names[:2] == [["double_contact", "rear_contact"], ["rear_contact", "lift_off", "flight"]]
    assert names[2:] == [["touch_down"]] * 3
    assert [one.begin_s for one in parts[0].info.segments] == pytest.approx([0.0, 0.5])
    assert [one.begin_s for one in parts[1].info.segments] == pytest.approx([0.0, 0.15, 0.25])
