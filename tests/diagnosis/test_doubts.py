"""Answers that leave much are told as a part where another cause surely acts: on logs of plain MuJoCo."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.decision import Conclusion, Judgement, partly_where_another_acts
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import joint_fit
from tests.diagnosis.two_link_arm import torque_driven_arm


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


def named_armature(robot: Robot, inertia: float) -> tuple[Judgement, HeldOutGap]:
    """The judgement `armature` on logs of an arm with so much more of it, kg·m², at both joints."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_armature[:] += inertia

    fit = joint_fit(robot, change)
    (armature,) = (h for h in list_hypotheses(["armature"], robot, None) if h.location == "all")
    begin = np.minimum(inertia, 0.9 * armature.bounds[1])
    found = fit.fit((armature,), np.ravel(begin), 8)
    conclusion = Conclusion("named", (("armature",),), (found,), (1.0,))
    return Judgement(SimpleNamespace(), np.ones(1), conclusion), fit.heldout_gap


def test_what_ends_at_its_range_and_leaves_much_is_told_as_a_part(robot: Robot) -> None:
    judgement, gap = named_armature(robot, 0.3)
    assert judgement.selected.at_bound
    found = partly_where_another_acts(judgement, gap, DecisionThresholds())
    assert found.conclusion.verdict == "partly" and found.conclusion.answer == (("armature",),)
    assert any("at the end of its range" in note for note in found.notes)


def test_what_fits_within_its_range_stays(robot: Robot) -> None:
    judgement, gap = named_armature(robot, 0.02)
    assert partly_where_another_acts(judgement, gap, DecisionThresholds()) is judgement
