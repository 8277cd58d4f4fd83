"""Feet that stand are on the ground: a jump by plain MuJoCo, whose joint sensors are then read wrongly."""

from dataclasses import replace

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.engine.intervals import Intervals
from leapgap.diagnosis.engine.planted import Planted
from leapgap.diagnosis.engine.search import SOME
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.diagnosis.pushed_robots import A1, quadruped_jump

KINDS = ("encoder_bias", "ground_height", "ground_slope", "frame_tilt", "leg_geometry")


def told(off: dict[str, float]) -> list[tuple[float, Hypothesis, np.ndarray]]:
    """What the feet tell of a jump whose joints are reported so much too large, rad."""
    log, robot = quadruped_jump(0, []), Robot.load(A1)
    columns = {name: own + off.get(name.removeprefix("joint_pos/"), 0.0) for name, own in log.columns.items()}
    judged = JudgedLogs.of([replace(log, columns=columns)], robot, {})
    planted = Planted.of(Intervals.of(judged.states, Replayer(robot, 1, 1), 0.01))
    return planted.numbers([()], list_hypotheses([effects.known()[name] for name in KINDS], robot, None))


def test_a_wrong_zero_is_read_from_the_foot_that_it_moves() -> None:
    """The knee that is reported 0.05 rad too large is among the first, with its number."""
    found = told({"RL_calf": 0.05})
    (number,) = [own for _, h, own in found if (h.name, h.location) == ("encoder_bias", "RL_calf")]
    assert number == pytest.approx([0.05], rel=0.15)
    gains = {(h.name, h.location): gain for gain, h, _ in found}
    assert gains["encoder_bias", "RL_calf"] > 0.9 * found[0][0]
    assert gains["encoder_bias", "FR_calf"] < 0.2 * found[0][0]


def test_feet_of_a_robot_as_its_model_tell_little() -> None:
    """They sink in a little under their load, which is no other ground: four such logs are not worth a closer look."""
    assert 4 * told({})[0][0] < SOME < 4 * told({"RL_calf": 0.05})[0][0]


def test_a_foot_that_bends_far_is_read_by_two_steps() -> None:
    """A knee that is reported 0.2 rad too large: once more about the first number."""
    log, robot = quadruped_jump(0, []), Robot.load(A1)
    columns = {name: own + (0.2 if name == "joint_pos/RL_calf" else 0.0) for name, own in log.columns.items()}
    judged = JudgedLogs.of([replace(log, columns=columns)], robot, {})
    planted = Planted.of(Intervals.of(judged.states, Replayer(robot, 1, 1), 0.01))
    hypothesis = Hypothesis(effects.known()["encoder_bias"], robot, "RL_calf")
    first = planted.numbers([()], [hypothesis])[0][2]
    _, second = planted.numbers_about([()], hypothesis, first)
    assert abs(second[0] - 0.2) < 0.5 * abs(first[0] - 0.2)
    assert second == pytest.approx([0.2], rel=0.05)
