"""The best simulator: all effects fitted together, on logs that plain MuJoCo simulated."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.best_simulator import BestFit, BestSimulator, JointCandidate, chosen_without
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.diagnose import Diagnosis, Settings, diagnose
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.joint_likelihood import LogErrors, Numbers
from leapgap.diagnosis.linear_fits import LinearFits, LinearModel, Weighting, bounded_minimum
from leapgap.diagnosis.selection import SearchSettings
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.robot.model import Robot
from leapgap.simulation.corrected import write_corrected
from leapgap.simulation.replay import Replayer
from tests.diagnosis.test_joint_fit import heldout_gap, noisy_logs
from tests.diagnosis.two_link_arm import TORQUE_MOTOR, two_link_arm
from tests.plain_simulation import Pd, by_motors, simulate

KINDS = ["joint_damping", "joint_friction", "armature", "torque_gain", "encoder_bias", "leg_mass"]
UNSEEN = Pd(18, 0.6, 0.6, 1.5)
"""A motion that no diagnosis sees."""


def worn(model: mujoco.MjModel) -> None:
    """What is hidden: damping at both joints, friction and armature more at the elbow, a heavier lower link."""
    model.dof_damping[:] += 0.2
    model.dof_frictionloss[:] = [0.1, 0.25]
    model.dof_armature[:] += [0.01, 0.03]
    model.body_mass[2] *= 1.15
    model.body_inertia[2] *= 1.15
    mujoco.mj_setConst(model, mujoco.MjData(model))


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(two_link_arm(TORQUE_MOTOR))
    return Robot.load(path)


@pytest.fixture(scope="module")
def found(robot: Robot) -> Diagnosis:
    """A diagnosis of the worn arm that may name one cause."""
    settings = Settings(effects=KINDS, plan=SearchSettings(most_causes=1), noise_draws=1, bootstrap_draws=100)
    return diagnose(noisy_logs(robot.path, worn), robot, settings, threads=2)


def test_it_closes_more_of_held_out_logs_than_an_answer_of_fewer_causes(found: Diagnosis) -> None:
    best, report = found.report.best_simulator, found.report
    assert best is not None and best.source == "joint fit"
    assert report.closure_of_answer is not None and len(report.answer) == 1
    print(best.closure, best.closure_of_answer, best.effects)
    for n in best.numbers: print(n)
    assert best.closure.value > report.closure_of_answer.value + 0.1
    assert best.closure_of_answer == pytest.approx(report.closure_of_answer.value)
    assert best.closure.value > 0.95
