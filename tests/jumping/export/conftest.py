"""A kicked jump in closed loop with goal-shift MPC: its estimates, its commands, and the controller that sent them."""

import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.shifted_plan import ShiftedPlan
from leapgap.jumping.experiments.goal_directed_jump import AIMING_LIMITS, JumpPlanner
from leapgap.jumping.experiments.goal_shift_jump import shifted_plan
from leapgap.jumping.experiments.landing_feedback import Authority, FeedbackConfig, ShiftedJumps, learn_feedback
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup, attempt_task
from leapgap.jumping.export.write import write_controller
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.planning.reference import Gains, to_jump
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate

UPDATES, FLIGHT_S = 32, 0.4
GOAL, TARGET, STANCE = np.array([0.52, 0.01, 0.02]), np.array([0.5, 0.015, 0.0]), -0.004
PARTS = ("torque", "position", "velocity", "kp", "kd", "planned_force")
MEASURED = ("base_position", "base_quaternion", "base_velocity", "base_angular_velocity", "joint_pos")


@dataclass(frozen=True)
class RecordedJump:
    estimates: list[StateEstimate]
    commands: np.ndarray
    """(ticks, 64), as ``PARTS``."""
    tracker: ShiftTracker


class Recorder(ShiftTracker):
    """Keeps what it is given and what it answers."""

    def command(self, estimate: StateEstimate) -> Command:
        answer = super().command(estimate)
        self.__dict__.setdefault("ticks", []).append((estimate, answer))
        return answer


def jumps(count: int, short_m: float, rng: np.random.Generator) -> ShiftedJumps:
    """Robots that land ``short_m`` short, and fly on by their excess velocity."""
    goal = rng.uniform([0.3, 0.0, -0.1], [0.8, 0.1, 0.1], (count, 3))
    shift = np.cumsum(0.01 * rng.uniform(-1, 1, (count, UPDATES, 3)), axis=1)
    deviation = rng.standard_normal((count, 1, 10)) + 0.1 * rng.standard_normal((count, UPDATES, 10))
    deviation *= [0.01, 0.01, 0.04, 0.1, 0.1, 0.4, *[0.01] * 4]
    landing = goal + shift.mean(axis=1) - [short_m, 0, 0]
    landing[:, 0] += FLIGHT_S * deviation[:, :, 3].mean(axis=1) + 0.02 * np.sin(8 * goal[:, 0])
    return ShiftedJumps(goal, rng.uniform(-0.1, 0.1, count), landing, shift, deviation, np.zeros(count))


@cache
def shifted(robot: Robot) -> ShiftedPlan:
    """The plan to the goal and three more around it, planned once."""
    planner, target = JumpPlanner(planar_robot(robot), limits=AIMING_LIMITS), Target(0.5)
    solution = planner.plan(target, GOAL, STANCE)
    assert solution is not None
    plan = shifted_plan(planner, solution, Reference.of(to_jump(solution, Gains()), robot), robot)
    assert plan is not None
    return plan


def new_tracker(
    robot: Robot, kind: type[ShiftTracker] = ShiftTracker, simulated: int = 60, own: int = 30
) -> ShiftTracker:
    """A controller with four plans, and a model of a robot that was learned on top of that of another one."""
    plan = shifted(robot)
    rng, late = np.random.default_rng(3), 1.6 * (1 - np.arange(UPDATES) / UPDATES) / UPDATES
    mean = late[:, None, None] * (np.eye(3) + 0.1 * rng.standard_normal((UPDATES, 3, 3)))
    shifts, config = Authority(mean[None], 0.01 * mean[None]), FeedbackConfig(bias=1.0, change=1.0)
    other = learn_feedback(jumps(simulated, 0.0, rng), shifts, config)
    model = learn_feedback(jumps(own, 0.02, rng), shifts, config, other)
    return kind(plan, robot, PhaseGains(), GoalShiftConfig(on_rear_feet=True), GOAL, STANCE, TARGET, model)


@pytest.fixture(scope="session")
def jump(robot: Robot, reference: Log) -> RecordedJump:
    """See ``record_jump``; the same one for all tests."""
    return record_jump(robot, reference)


def record_jump(robot: Robot, reference: Log) -> RecordedJump:
    """A jump in closed loop with noise, and with a kick at 0.3 s."""
    recorder = new_tracker(robot, Recorder)
    task = JumpTask("push_50", 0.5, kick_m_s=0.2, disturbed_at_s=(0.3,))
    attempt_task(task, lambda _: [recorder], reference, (), TrialSetup(robot), np.random.default_rng(2))
    ticks = recorder.__dict__["ticks"]
    commands = np.array([np.concatenate([getattr(command, part) for part in PARTS]) for _, command in ticks])
    return RecordedJump([estimate for estimate, _ in ticks], commands, recorder)


@pytest.fixture(scope="session")
def folder(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of the same controller."""
    out = tmp_path_factory.mktemp("export")
    write_controller(new_tracker(robot), out, {"robot": robot.name})
    return out


@pytest.fixture(scope="session")
def program(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The exported ``main.c``, compiled without a warning."""
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    out = tmp_path_factory.mktemp("program") / "jump"
    warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"]
    sources = [str(folder / name) for name in ("main.c", "jump_controller.c")]
    subprocess.run(["gcc", "-std=c99", "-O2", *warnings, *sources, "-o", str(out), "-lm"], check=True)
    return out


def raw(estimates: list[StateEstimate]) -> bytes:
    """Estimates as the C program reads them."""
    rows = [np.concatenate([[one.time_s], *(getattr(one, part) for part in MEASURED)]) for one in estimates]
    return np.array(rows).tobytes()


def run_program(program: Path, estimates: list[StateEstimate]) -> np.ndarray:
    """Commands of the C program, (ticks, 64)."""
    answer = subprocess.run([str(program)], input=raw(estimates), capture_output=True, check=True).stdout
    return np.frombuffer(answer).reshape(len(estimates), -1)
