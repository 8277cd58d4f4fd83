"""A cause in the place of another simulation that explains the logs: held-out logs of plain MuJoCo decide."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.decision import Conclusion, Judgement, OtherSimulationExplains
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.slow_causes import judge_slow_causes
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import NOMINAL, joint_fit_in_parts
from tests.diagnosis.two_link_arm import torque_driven_arm


def heavy_rotors(model: mujoco.MjModel) -> None:
    model.dof_armature[:] += 0.02


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def fit(robot: Robot) -> JointFit:
    return joint_fit_in_parts(robot, heavy_rotors)


def judged(robot: Robot, fit: JointFit, squares: np.ndarray) -> tuple[Judgement, Judgement]:
    """The judgement that another simulation explains the logs but for some squares (logs,), and what comes of it."""
    other = OtherSimulationExplains(("Euler's integrator",), fit.heldout_gap.gap(squares), squares)
    none = Judgement(SimpleNamespace(selected=NOMINAL), np.zeros(0), Conclusion("none", (), other_simulation=other))
    hypotheses = list_hypotheses(["joint_damping", "armature", "motor_lag"], robot, None)
    return none, judge_slow_causes(none, fit, hypotheses, DecisionThresholds())


def test_a_cause_that_explains_surely_more_is_the_answer(robot: Robot, fit: JointFit) -> None:
    _, found = judged(robot, fit, 0.25 * fit.heldout_gap.nominal)
    assert found.conclusion.verdict == "named"
    assert found.conclusion.answer == (("armature",),)
    assert found.selected.numbers == pytest.approx([0.02], rel=0.05)
    assert found.conclusion.other_simulation is None


def test_another_simulation_that_explains_as_much_stays(robot: Robot, fit: JointFit) -> None:
    none, found = judged(robot, fit, fit.heldout_gap.floor)
    assert found is none


def test_without_another_simulation_nothing_is_looked_for(robot: Robot) -> None:
    none = Judgement(SimpleNamespace(selected=NOMINAL), np.zeros(0), Conclusion("none", ()))
    assert judge_slow_causes(none, SimpleNamespace(), [], DecisionThresholds()) is none
