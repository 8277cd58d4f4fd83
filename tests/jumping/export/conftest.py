"""Kicked jumps in closed loop with goal-shift MPC: estimates, commands, and the controller that sent them.

One is from the ground that its plan knows, one from blocks that it measures at its beginning.
"""

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.control.goal_shift_jump import LateStance, ShiftTracker
from leapgap.jumping.control.goal_shift_mpc import GoalShiftConfig
from leapgap.jumping.control.shifted_plan import ShiftedPlan
from leapgap.jumping.control.tracking import PhaseGains, Reference
from leapgap.jumping.experiments.goal_directed_jump import (
    AIMING_LIMITS,
    AimConfig,
    JumpPlanner,
    LandingModel,
    LandingSamples,
)
from leapgap.jumping.experiments.goal_shift_jump import (
    Authority,
    FeedbackConfig,
    KickedJumps,
    LandingFeedback,
    learn_calm,
    learn_change,
    shifted_plan,
    stance_slopes,
)
from leapgap.jumping.experiments.method import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup, attempt_task
from leapgap.jumping.export.write import write_controller
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.controller import Command, StateEstimate

UPDATES, FLIGHT_S = 32, 0.4
GOAL, TARGET, STANCE = np.array([0.52, 0.01, 0.02]), np.array([0.5, 0.015, 0.0]), -0.004
TILTS = STANCE + np.linspace(-0.2, 0.2, 9)
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


def landings(count: int, short_m: float, rng: np.random.Generator) -> LandingSamples:
    """Jumps that end ``short_m`` short of their goals, and off by a wave besides."""
    goal = rng.uniform([0.3, 0.0, -0.1], [0.8, 0.1, 0.1], (count, 3))
    landing = goal - [short_m, 0, 0]
    landing[:, 0] += 0.02 * np.sin(8 * goal[:, 0])
    return LandingSamples(goal, rng.uniform(-0.1, 0.1, count), landing)


def calm_deviations(count: int, rng: np.random.Generator) -> np.ndarray:
    """Deviations (count, updates, 10) that stay what they are, but for a little noise."""
    found = rng.standard_normal((count, 1, 10)) + 0.05 * rng.standard_normal((count, UPDATES, 10))
    return found * [0.01, 0.01, 0.04, 0.1, 0.1, 0.4, *[0.01] * 4]


def kicked(count: int, rng: np.random.Generator) -> KickedJumps:
    """Kicked robots that fly on by the velocity that was added, and turn by a fifth of the pitch rate."""
    kicked_s = rng.uniform(0.1, 0.5, count)
    since = 0.3 * rng.standard_normal((count, UPDATES, 10)) * [0.01, 0.01, 0.04, 0.1, 0.1, 0.4, *[0.01] * 4]
    since[np.arange(UPDATES) * 0.025 <= kicked_s[:, None] + 0.01] = np.nan
    last = since[:, -1]
    since += last[:, None] - 0.9 * since
    landing = np.column_stack(
        [FLIGHT_S * last[:, 3], FLIGHT_S * last[:, 4] + last[:, 1], last[:, 2] + 0.2 * last[:, 5]]
    )
    return KickedJumps(since, landing)


@cache
def shifted(robot: Robot) -> ShiftedPlan:
    """The plan to the goal, three more around it and one from another stance, planned once."""
    planner, target = JumpPlanner(planar_robot(robot), limits=AIMING_LIMITS), Target(0.5)
    solution = planner.plan(target, GOAL, STANCE)
    assert solution is not None
    reference = Reference.of(to_jump(solution), robot)
    plan = shifted_plan(planner, solution, reference, robot)
    slopes = stance_slopes(planner, solution, reference, robot)
    assert plan is not None and slopes is not None
    return plan.with_stance(slopes)


def without_stance(plan: ShiftedPlan) -> ShiftedPlan:
    """The plan with its slopes by the goal alone."""
    return ShiftedPlan(plan.reference, {name: slopes[:3] for name, slopes in plan.slopes.items()})


@cache
def learned(own: int) -> LandingFeedback:
    """A model that was learned from so many jumps of a robot, and ten times as many simulated kicks, once."""
    rng, fading = np.random.default_rng(3), 1.6 * (1 - np.arange(UPDATES) / UPDATES) / UPDATES
    near = fading[:, None, None] * (np.eye(3) + 0.1 * rng.standard_normal((UPDATES, 3, 3)))
    far = near * np.linspace(1.3, 0.8, UPDATES)[:, None, None]
    shifts = Authority(np.stack([near, far]), 0.01 * near[None], np.array([0.5, 0.7]))
    config = FeedbackConfig()
    return LandingFeedback(
        LandingModel(landings(3 * own, 0.02, rng), AimConfig()),
        shifts,
        learn_calm(calm_deviations(own, rng), config),
        learn_change(kicked(10 * own, rng), config),
    )


def new_tracker(
    robot: Robot, kind: type[ShiftTracker] = ShiftTracker, own: int = 30, late: bool = False
) -> ShiftTracker:
    """A controller with four plans, and a model whose landings were learned on top of those of another robot.

    ``late``: with a fifth plan from another stance, which it measures; the more the ground rises, the farther it goes.
    """
    plan = shifted(robot) if late else without_stance(shifted(robot))
    goals = GOAL + np.column_stack([-0.6 * TILTS, 0.2 * np.abs(TILTS), 2 * TILTS**2])
    return kind(
        plan,
        robot,
        PhaseGains(),
        GoalShiftConfig(on_rear_feet=True),
        GOAL,
        STANCE,
        TARGET,
        learned(own).planned_to(GOAL),
        late=LateStance(TILTS, goals) if late else None,
    )


@pytest.fixture(scope="session")
def jump(robot: Robot, reference: Log) -> RecordedJump:
    """See ``record_jump``; the same one for all tests."""
    return record_jump(robot, reference)


@pytest.fixture(scope="session")
def late_jump(robot: Robot, reference: Log) -> RecordedJump:
    """The same from blocks that were not seen before; the same one for all tests."""
    return record_jump(robot, reference, late=True)


def record_jump(robot: Robot, reference: Log, late: bool = False) -> RecordedJump:
    """A jump in closed loop with noise and with a kick at 0.3 s; ``late``: from unseen blocks."""
    recorder = new_tracker(robot, Recorder, late=late)
    task = JumpTask("push_50", 0.5, kick_m_s=0.25, disturbed_at_s=(0.3,))
    if late:
        task = replace(task, block_m=(0.05, 0.05), rear_block_m=(0.02, 0.02), stance_is_seen=False)
    attempt_task(task, lambda _: [recorder], reference, (), TrialSetup(robot), np.random.default_rng(2))
    ticks = recorder.__dict__["ticks"]
    commands = np.array([np.concatenate([getattr(command, part) for part in PARTS]) for _, command in ticks])
    return RecordedJump([estimate for estimate, _ in ticks], commands, recorder)


@pytest.fixture(scope="session")
def folder(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of the same controller."""
    return exported(robot, tmp_path_factory.mktemp("export"))


@pytest.fixture(scope="session")
def late_folder(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of the one that measures its stance."""
    return exported(robot, tmp_path_factory.mktemp("late_export"), late=True)


def exported(robot: Robot, out: Path, late: bool = False) -> Path:
    """Export a controller."""
    write_controller(new_tracker(robot, late=late), out, {"robot": robot.name})
    return out


@pytest.fixture(scope="session")
def program(folder: Path) -> Path:
    """The exported ``main.c``, compiled."""
    return compiled(folder)


@pytest.fixture(scope="session")
def late_program(late_folder: Path) -> Path:
    """The same of the controller that measures its stance."""
    return compiled(late_folder)


def compiled(folder: Path) -> Path:
    """The program of an export, compiled without a warning, outside of the folder."""
    if shutil.which("gcc") is None:
        pytest.skip("no gcc")
    out = folder.parent / f"{folder.name}_jump"
    warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"]
    sources = [str(path) for path in sorted(folder.glob("*.c"))]
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


def far_from_plan(estimates: Sequence[StateEstimate], rng: np.random.Generator) -> list[StateEstimate]:
    """The same jump pushed and turned in the air, of a robot that starts elsewhere with another heading."""
    pushed, rate = rng.uniform(-1, 1, 3) * [0.8, 0.0, 0.8], rng.uniform(-3, 3)
    return [
        replace(
            tick,
            base_velocity=tick.base_velocity + pushed * (i > 200),
            base_angular_velocity=tick.base_angular_velocity + np.array([0, rate * (i > 300), 0]),
        )
        for i, tick in enumerate(turned(estimates, rng.uniform(-3, 3)))
    ]


def turned(estimates: Sequence[StateEstimate], yaw: float) -> list[StateEstimate]:
    """The same jump of a robot that starts elsewhere, with another heading."""
    cosine, sine = np.cos(yaw), np.sin(yaw)
    about_z = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    half_c, half_s = np.cos(yaw / 2), np.sin(yaw / 2)
    moved = []
    for tick in estimates:
        w, x, y, z = tick.base_quaternion
        quaternion = [
            half_c * w - half_s * z,
            half_c * x - half_s * y,
            half_c * y + half_s * x,
            half_c * z + half_s * w,
        ]
        moved.append(
            replace(
                tick,
                base_position=about_z @ tick.base_position + np.array([3.0, -2.0, 0.0]),
                base_quaternion=np.array(quaternion),
                base_velocity=about_z @ tick.base_velocity,
            )
        )
    return moved
