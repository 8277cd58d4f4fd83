"""The simulation's own step is no cause: logs of plain MuJoCo by steps of a tenth, and by the usual ones."""

from types import SimpleNamespace

import numpy as np
import pytest

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.joint_likelihood import JointLikelihood
from leapgap.diagnosis.log_errors import LogErrors
from leapgap.diagnosis.numbers_beside import NumbersBeside
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import NOMINAL, joint_fit_in_parts, worn
from tests.diagnosis.two_link_arm import torque_driven_arm


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return torque_driven_arm(tmp_path_factory.mktemp("arm"))


def joint_fit(robot: Robot, steps: int, near: Candidate | None = NOMINAL) -> JointFit:
    """The joint fit to logs of the nominal robot of so many steps a millisecond."""
    return joint_fit_in_parts(robot, lambda _: None, steps, near)


def damping_and_lag(robot: Robot, joint: JointFit) -> np.ndarray:
    """Damping and lag of all joints that are fitted to logs that have none beyond the model's, (2,)."""
    every = list_hypotheses(["joint_damping", "motor_lag"], robot, None)
    return joint.fit(tuple(h for h in every if h.location == "all"), np.zeros(2), 4, settled=0.5).numbers


@pytest.mark.parametrize(("steps", "share"), [(1, 0.0), (2, 2 / 3), (10, 1.2)])
def test_the_share_of_short_steps_is_that_of_the_step_of_the_log(robot: Robot, steps: int, share: float) -> None:
    """Steps of a quarter change 1 − 1/4 of the step's error, and steps of a ``steps``-th 1 − 1/``steps``."""
    joint = joint_fit(robot, steps)
    assert joint.share_and_rest(NOMINAL)[0] == pytest.approx(share, abs=0.03)
    judged = joint.by_steps_of(NOMINAL)
    assert judged is not None
    assert judged.steps_known
    assert (judged.judging is joint.heldout_gap) == (steps == 1)
    assert bool(joint.notes) == (steps > 1)


def test_steps_are_not_judged_by_a_robot_that_lacks_a_cause(robot: Robot) -> None:
    joint = joint_fit_in_parts(robot, worn)
    assert joint.by_steps_of(NOMINAL) is None
    assert not joint.notes


def test_the_error_of_the_step_is_neither_damping_nor_lag(robot: Robot) -> None:
    short = joint_fit(robot, 10)
    assert damping_and_lag(robot, short) == pytest.approx([0.0, 0.0], abs=1e-4)
    taken_as_it_is = joint_fit(robot, 10, near=None)
    assert damping_and_lag(robot, taken_as_it_is)[1] > 4e-4
    assert short.nominal_loss < taken_as_it_is.nominal_loss - 200


def test_the_slope_of_the_likelihood_is_its_derivative_where_the_numbers_beside_are_at_their_best() -> None:
    """Finite differences of the loss of errors that answer linearly, with step and tolerances found at each."""
    rng = np.random.default_rng(2)
    errors, slopes, off, by_short = (
        [LogErrors(rng.normal(size=(40, *of)), rng.normal(size=(5, 12, *of))) for _ in range(2)]
        for of in ((), (3,), (4,), ())
    )
    folds = np.arange(2)
    none = NumbersBeside(tuple(off), np.zeros(4), np.full(4, np.inf))
    gap = SimpleNamespace(folds=folds)
    likelihood = JointLikelihood(gap, SimpleNamespace(), none.with_step(errors, by_short))

    def loss(departs: np.ndarray) -> float:
        return likelihood.loss([a.moved(b, departs) for a, b in zip(errors, slopes, strict=True)], departs)

    _, slope = likelihood.normal(errors, slopes, np.zeros(3))
    by = 1e-4 * np.eye(3)
    assert slope == pytest.approx([(loss(one) - loss(-one)) / 2e-4 for one in by], rel=0.02, abs=0.02)
