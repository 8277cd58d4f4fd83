"""Answers that leave much are told as a part where another cause surely acts: on logs of plain MuJoCo."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.decision import Conclusion, Judgement, steps_of
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.doubts import of_causes, partly_where_another_acts, without_uncertain
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit, part
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import Change, joint_fit_in_parts
from tests.diagnosis.two_link_arm import torque_driven_arm


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


def more(inertia: float, friction_nm: float) -> Change:
    """So much more armature, kg·m², and friction at both joints."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_armature[:] += inertia
        model.dof_frictionloss[:] += friction_nm

    return change


def named_armature(robot: Robot, inertia: float, friction_nm: float = 0.0) -> tuple[Judgement, JointFit]:
    """The judgement `armature` on logs of an arm with so much more of it, and of friction."""
    fit = joint_fit_in_parts(robot, more(inertia, friction_nm))
    (armature,) = (h for h in list_hypotheses(["armature"], robot, None) if h.location == "all")
    begin = np.minimum(inertia, 0.9 * armature.bounds[1])
    found = fit.fit((armature,), np.ravel(begin), 8)
    conclusion = Conclusion("named", (("armature",),), (found,), (1.0,))
    return Judgement(SimpleNamespace(), np.ones(1), conclusion), fit


def test_what_ends_at_its_range_and_leaves_much_is_told_as_a_part(robot: Robot) -> None:
    judgement, fit = named_armature(robot, 0.3)
    assert judgement.selected.at_bound
    found = partly_where_another_acts(judgement, fit, DecisionThresholds())
    assert found.conclusion.verdict == "partly" and found.conclusion.answer == (("armature",),)
    assert any("at the end of its range" in note for note in fit.notes)


def test_what_leaves_short_pieces_far_from_noise_is_told_as_a_part(robot: Robot) -> None:
    judgement, fit = named_armature(robot, 0.02, friction_nm=1.0)
    assert not judgement.selected.at_bound
    found = partly_where_another_acts(judgement, fit, DecisionThresholds())
    assert found.conclusion.verdict == "partly" and found.conclusion.answer == (("armature",),)
    assert any("short segments stay" in note for note in fit.notes)


def test_what_fits_within_its_range_stays(robot: Robot) -> None:
    judgement, fit = named_armature(robot, 0.02)
    assert partly_where_another_acts(judgement, fit, DecisionThresholds()) is judgement
    assert not fit.notes


def friction_with_armature(robot: Robot, inertia: float, friction_nm: float = 0.3) -> tuple[Judgement, JointFit]:
    """The answer `joint_friction` and `armature` on logs of an arm with so much more armature and friction."""
    fit = joint_fit_in_parts(robot, more(inertia, friction_nm))
    kinds = ("joint_friction", "armature")
    both = tuple(h for h in list_hypotheses(list(kinds), robot, None) if h.location == "all")
    assert tuple(h.name for h in both) == kinds
    found = fit.fit(both, np.array([0.7 * friction_nm, 0.002]), 8)
    conclusion = Conclusion("named", (("joint_friction",), ("armature",)), (part(found, [0]), found), (1.0, 1.0))
    return Judgement(SimpleNamespace(), np.ones(1), conclusion), fit


def test_a_further_cause_that_logs_do_not_tell_is_left_out(robot: Robot) -> None:
    judgement, fit = friction_with_armature(robot, 0.0)
    found = without_uncertain(judgement, fit, DecisionThresholds())
    assert found.conclusion.answer == (("joint_friction",),) and found.conclusion.verdict == "named"
    assert found.selected.names == ("joint_friction",) and found.selected.numbers == pytest.approx(0.3, rel=0.03)
    assert fit.notes == ["left out, since the logs do not determine its number: armature"]


def test_a_further_cause_that_logs_tell_stays(robot: Robot) -> None:
    judgement, fit = friction_with_armature(robot, 0.01)
    assert judgement.selected.numbers == pytest.approx([0.3, 0.01], rel=0.1)
    assert without_uncertain(judgement, fit, DecisionThresholds()) is judgement
    assert not fit.notes


def test_what_closes_much_and_is_hardly_known_leaves_a_part(robot: Robot) -> None:
    judgement, fit = friction_with_armature(robot, 0.02, friction_nm=1.0)
    strict = DecisionThresholds(least_known=1e9, enough_jointly=1.0)  # no number is known so well
    found = without_uncertain(judgement, fit, strict)
    assert len(found.conclusion.answer) == 1 and found.conclusion.verdict == "partly"


def test_several_causes_that_leave_much_and_are_less_known_than_such_that_act_are_a_part(robot: Robot) -> None:
    judgement, fit = friction_with_armature(robot, 0.02, friction_nm=1.0)
    much = DecisionThresholds(enough_jointly=2.0)  # no answer closes so much
    assert partly_where_another_acts(judgement, fit, much) is judgement
    strict = replace(much, least_known_named=1e9)  # no number is known so well
    found = partly_where_another_acts(judgement, fit, strict)
    assert found.conclusion.verdict == "partly" and found.conclusion.answer == judgement.conclusion.answer
    assert any("poorly determined" in note and "joint_friction" in note for note in fit.notes)
    closing = replace(strict, enough_jointly=0.5)
    assert partly_where_another_acts(judgement, fit, closing) is judgement
    rivals = (("joint_friction", "joint_damping"), ("armature",))
    open_still = replace(judgement, conclusion=replace(judgement.conclusion, verdict="ambiguous", answer=rivals))
    assert partly_where_another_acts(open_still, fit, strict) is open_still


def test_causes_that_stay_behind_one_left_out_are_fitted_anew(robot: Robot) -> None:
    judgement, fit = friction_with_armature(robot, 0.0)
    conclusion = judgement.conclusion
    (damping,) = (h for h in list_hypotheses(["joint_damping"], robot, None) if h.location == "all")
    three = fit.fit((*conclusion.steps[-1].hypotheses, damping), np.array([0.2, 0.002, 0.1]), 8)
    strict = DecisionThresholds(least_known=1e-9)
    answer = (("joint_friction",), ("armature",), ("joint_damping",))
    some = replace(judgement, conclusion=Conclusion("named", answer, steps_of(three), (1.0, 1.0, 1.0)))
    assert without_uncertain(some, fit, strict) is some
    kept = of_causes(some.conclusion, fit, [0, 2])
    assert kept.answer == (("joint_friction",), ("joint_damping",)) and len(kept.steps) == 2
    assert kept.steps[-1].names == ("joint_friction", "joint_damping")
    assert kept.steps[-1].numbers == pytest.approx([0.3, 0.0], abs=0.02)
