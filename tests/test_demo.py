"""The first look: a hidden effect that the logs do not tell, a diagnosis that does, and a page."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import leapgap as lg
from leapgap import cli, demo
from leapgap.robot.model import Robot


def test_the_same_number_hides_the_same_effect_and_numbers_differ() -> None:
    first, again, other = demo.simulate(1), demo.simulate(1), demo.simulate(2)
    assert first.hidden == again.hidden != other.hidden
    for one, two in zip(first.logs, again.logs, strict=True):
        assert all(np.array_equal(one[name], two[name]) for name in one.columns)


def rms(logs: Sequence[lg.Log], replays: Sequence[lg.Log]) -> float:
    """Difference of all joint angles, rad."""
    return float(
        np.sqrt(
            np.mean(
                [(a.per_joint("joint_pos") - b.per_joint("joint_pos")) ** 2 for a, b in zip(logs, replays, strict=True)]
            )
        )
    )


def test_the_robot_stays_on_its_feet_and_no_log_says_what_is_hidden() -> None:
    for number in range(4):
        found = demo.simulate(number)
        for log in found.logs:
            assert log["base_pos_z"].min() > 0.1 and np.abs(log.pitch).max() < 0.4
            assert found.hidden.name not in str(log.info)
        nominal = lg.replay(found.logs, found.robot)
        truth = lg.replay(found.logs, found.robot, [found.hidden])
        off = [rms(found.logs, runs) for runs in (nominal, truth)]
        assert off[1] < 0.7 * off[0], "the hidden effect is not what moves the robot away from its model"


def test_an_effect_at_a_joint_that_stands_still_is_never_hidden() -> None:
    robot = Robot.load()
    assert demo.draw_effect(robot, np.random.default_rng(2)) == demo.simulate(2).hidden
    places = {demo.draw_effect(robot, np.random.default_rng(number)).location for number in range(20)}
    assert not any(place and place.endswith("_hip") for place in places)


def test_a_number_below_zero_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["demo", "--number", "-1", "--out", str(tmp_path / "demo"), "--no-browser"]) == 2
    assert "leapgap demo: --number: found -1; expected 0 or a larger whole number" in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()


@pytest.mark.long
def test_the_demo_names_what_it_hides(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "demo"
    assert cli.main(["demo", "--number", "3", "--out", str(out), "--no-browser"]) == 0
    said = capsys.readouterr().out
    report = json.loads((out / "report" / "report.json").read_text())
    hidden = demo.simulate(3).hidden
    assert report["verdict"] == "named" and report["answer"] == [[hidden.name]]
    assert report["causes"][0]["location"] == hidden.location
    assert report["closure_of_answer"]["ci95"][0] > 0.5
    assert f"named: {report['sentence']}" in said
    assert said.index("named: ") < said.index(f"hidden was {hidden.name}")
    assert f"page: {out / 'report' / 'report.html'}" in said
    assert (out / "report" / "report.html").is_file() and len(list((out / "logs").glob("*.parquet"))) == 3
