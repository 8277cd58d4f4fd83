"""A long computation that says nothing is said to be running, and its steps say how long they may take."""

import sys
import time
from pathlib import Path

import pytest

from leapgap import cli
from leapgap.runtime.processes import still_running
from tests import plain_arm


def test_silence_is_broken_and_talk_is_passed_on() -> None:
    lines: list[str] = []
    with still_running(lines.append, silence_s=0.2) as tell:
        tell("begun")
        time.sleep(0.5)
    assert lines == ["begun", *["still running; 1 s so far"] * 2]


def test_nothing_is_added_between_lines_nor_after_the_end() -> None:
    lines: list[str] = []
    with pytest.raises(KeyError), still_running(lines.append, silence_s=0.3) as tell:
        for _ in range(6):
            tell("a step")
            time.sleep(0.05)
        raise KeyError
    time.sleep(0.4)
    assert lines == ["a step"] * 6


def test_each_step_of_equal_length_says_about_how_long_the_others_will_take() -> None:
    """By hand: after one of four steps in 20 s, 60 s remain; after three in 240 s, 80 s."""
    lines: list[str] = []
    now = 100.0
    with still_running(lines.append, clock=lambda: now) as tell:
        tell("step 1 of 4, checks")
        now = 120.0
        tell("step 2 of 4, search")
        tell("a cause")
        now = 340.0
        tell("step 4 of 4, report")
    assert lines == [
        "step 1 of 4, checks",
        "step 2 of 4, search; 20 s so far, about 60 s more",
        "a cause",
        "step 4 of 4, report; 4 min so far, about 80 s more",
    ]


def test_a_step_that_begins_at_a_known_share_of_the_time_says_from_when_to_when_the_end_is_near() -> None:
    """By hand: 10 s are a tenth to a half of 20 to 100 s, of which 10 to 90 s remain; nothing is known of step 3."""
    lines: list[str] = []
    now = 0.0
    with still_running(lines.append, {2: (0.1, 0.5)}, clock=lambda: now) as tell:
        now = 10.0
        tell("step 2 of 3, search")
        now = 12.0
        tell("step 3 of 3, report")
    assert lines == ["step 2 of 3, search; 10 s so far, about 10 s to 90 s more", "step 3 of 3, report; 10 s so far"]


def test_an_estimate_that_has_passed_is_no_longer_said() -> None:
    lines: list[str] = []
    now = 0.0
    with still_running(lines.append, {2: (0.1, 0.5)}, silence_s=0.05, clock=lambda: now) as tell:
        now = 30.0
        tell("step 2 of 2, search")
        now = 100.0
        time.sleep(0.1)
        now = 600.0
        time.sleep(0.1)
    assert lines[0] == "step 2 of 2, search; 30 s so far, about 30 s to 4 min more"
    assert lines[1] == "still running; 2 min so far, up to 3 min more"
    assert lines[-1] == "still running; 10 min so far"


@pytest.mark.parametrize("at_terminal", [True, False])
def test_a_quick_command_says_its_steps_to_a_person_alone(
    at_terminal: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain_arm.write_parquet(tmp_path / "logs", 2)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: at_terminal)
    assert cli.main(["check", str(tmp_path / "logs")]) == 0
    said = capsys.readouterr()
    steps = [line for line in said.err.splitlines() if line.startswith("step ")]
    assert "step" not in said.out
    assert [line.partition(":")[0] for line in steps] == ["step 1 of 2, reading", "step 2 of 2, checks"] * at_terminal
