"""Answers that leave much are told as a part where another cause surely acts: on logs of plain MuJoCo."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.decision import Conclusion, Judgement, with_doubt
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import joint_fit_in_parts
from tests.diagnosis.two_link_arm import torque_driven_arm


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


def named_armature(robot: Robot, inertia: float, friction_nm: float = 0.0) -> tuple[Judgement, JointFit]:
    """The judgement `armature` on logs of an arm with so much more of it, kg·m², and of friction at both joints."""

    def more(model: mujoco.MjModel) -> None:
        model.dof_armature[:] += inertia
        model.dof_frictionloss[:] += friction_nm

    fit = joint_fit_in_parts(robot, more)
    (armature,) = (h for h in list_hypotheses(["armature"], robot, None) if h.location == "all")
    begin = np.minimum(inertia, 0.9 * armature.bounds[1])
    found = fit.fit((armature,), np.ravel(begin), 8)
    conclusion = Conclusion("named", (("armature",),), (found,), (1.0,))
    return Judgement(SimpleNamespace(), np.ones(1), conclusion), fit


def test_what_ends_at_its_range_and_leaves_much_is_told_as_a_part(robot: Robot) -> None:
    judgement, fit = named_armature(robot, 0.3)
    assert judgement.selected.at_bound
    found = with_doubt(judgement, fit, DecisionThresholds())
    assert found.conclusion.verdict == "partly" and found.conclusion.answer == (("armature",),)
    assert any("ends at its range" in note for note in fit.notes)


def test_what_leaves_short_pieces_far_from_noise_is_told_as_a_part(robot: Robot) -> None:
    judgement, fit = named_armature(robot, 0.02, friction_nm=1.0)
    assert not judgement.selected.at_bound
    found = with_doubt(judgement, fit, DecisionThresholds())
    assert found.conclusion.verdict == "partly" and found.conclusion.answer == (("armature",),)
    assert any("short pieces stay" in note for note in fit.notes)


def test_what_fits_within_its_range_stays(robot: Robot) -> None:
    judgement, fit = named_armature(robot, 0.02)
    assert with_doubt(judgement, fit, DecisionThresholds()) is judgement
    assert not fit.notes
