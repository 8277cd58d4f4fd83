"""What a diagnosis says in its one sentence: shares that a reader can believe."""

import numpy as np
import pytest

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.engine.verdict import Conclusion
from leapgap.diagnosis.gap import HeldOutFigures, Interval
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.summary import few_names, listed, sentence, share_in_words
from leapgap.effects.friction import JointDamping
from leapgap.robot.model import Robot


@pytest.mark.parametrize(
    ("closes", "words"),
    [
        (Interval(0.85, 0.801, 0.907), "85 % (95 %: 80 to 91) of the gap"),
        (Interval(0.40, -0.12, 0.61), "40 % (95 %: -12 to 61) of the gap"),
        (Interval(0.97, 0.93, 1.05), "97 % (95 %: 93 to 100) of the gap"),
        (Interval(1.02, 0.93, 1.10), "all of the gap (95 %: 93 % or more)"),
        (Interval(1.08, 1.03, 1.13), "all of the gap"),
        (Interval(0.70, 0.72, 0.80), "70 % (95 %: 70 to 80) of the gap"),
        (Interval(0.90, 0.70, 0.88), "90 % (95 %: 70 to 90) of the gap"),
    ],
)
def test_a_share_lies_within_its_interval_and_none_is_more_than_all(closes: Interval, words: str) -> None:
    assert share_in_words(closes) == words


def test_a_gap_closed_beyond_its_noise_floor_is_said_to_be_all_of_it(robot: Robot) -> None:
    """A corrected gap below the noise floor closes 108 % by the formula; there is no such share."""
    damping = Hypothesis(JointDamping, robot)
    selected = Candidate((damping,), np.array([0.4]), np.eye(1), np.array([[0.4]]))
    conclusion = Conclusion("named", (("joint_damping",),), (selected,), (1.0,))
    logs = ["jump_0", "jump_1"]
    words = sentence(
        conclusion, selected, 1.40, 0.05, HeldOutFigures(np.zeros(2), 0.11, Interval(1.08, 1.03, 1.13)), logs
    )
    assert words.endswith("explains all of the gap on held-out logs: it falls from 1.40 to 0.11.")
    words = sentence(
        conclusion, selected, 1.40, 0.05, HeldOutFigures(np.zeros(2), 0.31, Interval(0.85, 0.80, 0.91)), logs
    )
    assert "explains 85 % (95 %: 80 to 91) of the gap on held-out logs: it falls from" in words


def test_ten_causes_make_no_sentence_of_ten(robot: Robot) -> None:
    damping = Hypothesis(JointDamping, robot)
    selected = Candidate((damping,) * 6, np.full(6, 0.4), np.eye(6), np.full((1, 6), 0.4))
    conclusion = Conclusion("named", (("joint_damping",),) * 6, (selected,), (1.0,) * 6)
    figures = HeldOutFigures(np.zeros(2), 0.31, Interval(0.85, 0.80, 0.91))
    words = sentence(conclusion, selected, 1.40, 0.05, figures, ["jump_0", "jump_1"])
    assert words.count("viscous friction") == 3
    assert " and 3 further causes explain 85 %" in words


def test_a_gap_without_a_cause_is_told_apart_from_noise() -> None:
    none, figures = (
        Candidate((), np.zeros(0), np.zeros((0, 0)), np.zeros((4, 0))),
        HeldOutFigures(np.zeros(2), 0.31, Interval(0.0, 0.0, 0.0)),
    )
    near, far = (sentence(Conclusion("none", ()), none, 0.31, floor, figures, ["a", "b"]) for floor in (0.1, 0.05))
    assert near.startswith("The simulation agrees with the 2 logs within sensor noise")
    assert far.startswith("These 2 logs show no fault of the robot: in short replays")
    assert far.endswith("add up to a gap of 0.31; noise alone makes 0.05.")


@pytest.mark.parametrize(
    "parts, said",
    [
        (["a"], "a"),
        (["a", "b"], "a and b"),
        (["a, like d,", "b"], "a, like d, and b"),
        (["a, like d,", "b", "c"], "a, like d, b and c"),
    ],
)
def test_parts_are_listed_with_one_comma_each(parts: list[str], said: str) -> None:
    assert listed(parts) == said


def test_many_rivals_are_counted() -> None:
    assert few_names(["a", "b", "c", "d"]) == ["a", "b", "c", "d"]
    assert few_names(["a", "b", "c", "d", "e"]) == ("a", "b", "c", "2 others")
