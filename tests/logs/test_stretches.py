"""Many or long logs: which stretches are diagnosed, and that this is said."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap.logs import cutting
from leapgap.logs.cutting import MOST_ROWS, choose_stretches
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import Segment


def log(name: str, seconds: float, period_s: float = 0.001, segments: tuple[Segment, ...] = ()) -> Log:
    """A log of one joint whose feed-forward torque is its time."""
    time = np.arange(round(seconds / period_s)) * period_s
    columns = {"time": time, "joint_pos/j": np.sin(time)}
    columns |= {f"{command}/j": time if command == "cmd_tau" else time * 0 for command in COMMANDS}
    return Log(name, columns, replace(LogInfo("arm", period_s, "test"), stated_segments=segments))


COMMANDS = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")


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
