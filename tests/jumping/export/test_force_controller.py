"""The learned MPC in C against the one in Python: a kicked jump, pushed far, and with values that are missing."""

import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.mpc import DepartingMpc, JumpMpc, MpcConfig, StateWeights
from leapgap.jumping.control.tracking import PhaseGains, Reference
from leapgap.jumping.experiments.method import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup, attempt_task
from leapgap.jumping.export.tables import force_tables_of
from leapgap.jumping.export.write import write_controller
from leapgap.jumping.models.rigid_body import AffineModel, DeviationModel, NominalDeviation, PlannedSteps
from leapgap.jumping.task import JointGains
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate
from tests.conftest import A1_BODY
from tests.jumping.export.conftest import PARTS, compiled, far_from_plan, run_program

GAINS = PhaseGains(JointGains(100.0, 2.0), JointGains(300.0, 3.0), JointGains(100.0, 2.0))
CONFIG = MpcConfig(
    weights=StateWeights(50.0, 100.0, 5.0, 10.0, 10.0, 1.0),
    landing_weights=StateWeights(5000.0, 500.0, 50.0, 0.0, 0.0, 5.0),
    force_weight=1e-5,
    limits=ForceLimits(from_plan_n=120.0),
)
CLOSE = 1e-9
"""Largest difference of a command: N·m, rad, rad/s, N."""
KINDS = {"forces": JumpMpc, "departing": DepartingMpc}


class Drifting(DeviationModel):
    """Joint PD that pulls back, a drift late in the push, and forces of which 90 % act."""

    body = A1_BODY

    def residual(self, steps: PlannedSteps) -> AffineModel:
        pushing = steps.pushing.any(axis=1)
        h, slope = np.zeros((len(steps), 3)), np.zeros((len(steps), 3, 6))
        h[(steps.time_s > 0.5) & pushing] = (0.8, -0.5, 0.6)
        pull = np.zeros((3, 6))
        pull[0, [0, 3]] = pull[1, [1, 4]] = (-20, -3)
        slope[pushing] = pull
        return AffineModel(h, -0.1 * A1_BODY.force_rows(steps.foot), slope)

    def arrays(self) -> dict[str, np.ndarray]:
        return {}


@dataclass(frozen=True)
class Case:
    """A controller's recorded jump, and its program in C."""

    kind: type[JumpMpc]
    reference: Reference
    robot: Robot
    estimates: list[StateEstimate]
    program: Path

    def python(self, estimates: Sequence[StateEstimate]) -> tuple[np.ndarray, JumpMpc]:
        """Commands of the controller in Python, (ticks, 64), and the controller."""
        controller = self.kind(self.reference, self.robot, GAINS, Drifting(), CONFIG)
        return commands(controller.command(estimate) for estimate in estimates), controller


def commands(sent: object) -> np.ndarray:
    return np.array([np.concatenate([getattr(one, part) for part in PARTS]) for one in sent])  # type: ignore[attr-defined]


@pytest.fixture(scope="module", params=list(KINDS))
def case(
    request: pytest.FixtureRequest, robot: Robot, reference: Log, tmp_path_factory: pytest.TempPathFactory
) -> Case:
    folder, kind = tmp_path_factory.mktemp(request.param), KINDS[request.param]
    ticks = export_learned(robot, reference, folder, kind)
    return Case(kind, Reference.of(reference, robot), robot, ticks, compiled(folder))


def export_learned(robot: Robot, reference: Log, folder: Path, kind: type[JumpMpc] = JumpMpc) -> list[StateEstimate]:
    """Export the controller; what it is told in a kicked jump with noise."""
    plan = Reference.of(reference, robot)
    ticks: list[StateEstimate] = []

    class Recorder(kind):  # type: ignore[valid-type,misc]
        def command(self, estimate: StateEstimate) -> Command:
            ticks.append(estimate)
            return super().command(estimate)

    task = JumpTask("push_50", 0.5, kick_m_s=0.25, disturbed_at_s=(0.3,))
    recorder = Recorder(plan, robot, GAINS, Drifting(), CONFIG)
    attempt_task(task, lambda _: [recorder], reference, (), TrialSetup(robot), np.random.default_rng(2))
    write_controller(kind(plan, robot, GAINS, Drifting(), CONFIG), folder, {"robot": robot.name})
    return ticks


def test_c_sends_the_commands_of_python(case: Case) -> None:
    """Python solves each problem by another method."""
    expected, controller = case.python(case.estimates)
    assert not controller.fallbacks
    assert len(expected) > 1000
    decided = expected[:800:25, 60:] - case.reference.force[:800:25]
    assert np.abs(decided).max() > 20, "the MPC departs from the plan"
    np.testing.assert_allclose(run_program(case.program, case.estimates), expected, rtol=0, atol=CLOSE)


def test_limits_that_act_get_the_commands_of_python(case: Case) -> None:
    """States far from the plan, of a robot that starts elsewhere with another heading."""
    rng, acting = np.random.default_rng(5), 0
    for _ in range(4):
        ticks = far_from_plan(case.estimates[:820], rng)
        expected, _ = case.python(ticks)
        x, z = expected[:800, 60::2], expected[:800, 61::2]
        acting += int(((np.abs(np.abs(x) - 0.6 * z) < 1e-6) & (z > 1)).any(axis=1).sum())
        np.testing.assert_allclose(run_program(case.program, ticks), expected, rtol=0, atol=CLOSE)
    assert acting > 200, "ticks at the edge of the cone"


def test_missing_values_and_wrong_times_get_the_commands_of_python(case: Case) -> None:
    """Updates that cannot be solved, and a clock that is set; no tick at which an update is due is missed."""
    ticks, nan = list(case.estimates[:1200]), np.full(3, np.nan)
    ticks[0] = replace(ticks[0], base_position=nan)
    for i in range(120, 140):
        ticks[i] = replace(ticks[i], base_velocity=nan)
    for i in range(290, 305):
        ticks[i] = replace(ticks[i], base_quaternion=3 * ticks[i].base_quaternion)
    for i in range(350, 520):  # longer than a plan is valid
        ticks[i] = replace(ticks[i], joint_pos=np.full(12, 1e9))
    for i in range(526, 549):
        ticks[i] = replace(ticks[i], time_s=float("inf"))
    ticks[560] = replace(ticks[560], time_s=-3.0)
    ticks[603:] = [replace(tick, time_s=tick.time_s + 50.0) for tick in ticks[603:]]
    expected, controller = case.python(ticks)
    assert {"time not usable", "not finite", "pose not finite"} <= set(controller.fallbacks)
    np.testing.assert_allclose(run_program(case.program, ticks), expected, rtol=0, atol=CLOSE)


def test_a_late_update_is_near_that_of_its_moment(case: Case) -> None:
    """C has tables of the time at which an update was due; Python prepares anew for a time between."""
    ticks = case.estimates[:400] + case.estimates[405:]
    expected, _ = case.python(ticks)
    answer = run_program(case.program, ticks)
    np.testing.assert_allclose(answer[:400], expected[:400], rtol=0, atol=CLOSE)
    assert np.abs(answer[400:420, 60:] - expected[400:420, 60:]).max() < 15, "N"
    assert np.isfinite(answer).all()


def test_no_memory_is_allocated(case: Case) -> None:
    symbols = subprocess.run(["nm", "-u", str(case.program)], capture_output=True, check=True, text=True).stdout
    assert not {"malloc", "calloc", "realloc"} & {line.split()[-1].split("@")[0] for line in symbols.splitlines()}


def test_a_controller_that_learned_nothing_is_refused(robot: Robot, reference: Log) -> None:
    plain = JumpMpc(Reference.of(reference, robot), robot, GAINS, NominalDeviation(A1_BODY), CONFIG)
    with pytest.raises(InputError, match="learned model"):
        force_tables_of(plain)
