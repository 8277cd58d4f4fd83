"""A long computation that says nothing is said to be running, and one that talks is not."""

import time

import pytest

from leapgap.runtime.still_running import still_running


def test_silence_is_broken_and_talk_is_passed_on() -> None:
    lines: list[str] = []
    with still_running(lines.append, silence_s=0.2) as tell:
        tell("begun")
        time.sleep(0.5)
    assert lines == ["begun", *["still running, 0 min so far"] * 2]


def test_nothing_is_added_between_lines_nor_after_the_end() -> None:
    lines: list[str] = []
    with pytest.raises(KeyError), still_running(lines.append, silence_s=0.3) as tell:
        for _ in range(6):
            tell("a step")
            time.sleep(0.05)
        raise KeyError
    time.sleep(0.4)
    assert lines == ["a step"] * 6
