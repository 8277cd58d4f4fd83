"""Trials and their results as plain data, which can be sent to other processes and written to files."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.experiments.goal_directed_jump import GoalDirectedJump
from leapgap.jumping.experiments.landing import Landing
from leapgap.jumping.experiments.landing_feedback import ShiftedJumps
from leapgap.jumping.experiments.landing_model import LandingSamples
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.run_metrics import RunMetrics, pair_force
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialOutcome, TrialSetup, attempt_task
from leapgap.jumping.models.rigid_body import GRAVITY
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, PAIR_FORCE_AXES
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of, yaw_of

LEAVES_WITHIN_S = 0.05
"""A foot that touches within this time after the planned take-off has not left the ground yet."""
UPRIGHT_RAD = 0.5
"""A jump that lands with a larger pitch is no sample for the landing model: the robot fell."""


@dataclass(frozen=True)
class TrialSpec:
    """One closed-loop run to make: the method, the task, the simulated robot and the seed."""

    place: str
    """Path of its result, ``<hardware>/<method>/<task>_<number>``; it differs for every trial of an experiment."""
    task: JumpTask
    method: Method
    reference: Log
    """The plan of its jumps from level ground."""
    effects: tuple[Effect, ...]
    world: TrialSetup
    seed: int
    with_log: bool = False

    def run(self) -> "TrialResult":
        """Simulate the run; the same specification gives the same result bit for bit."""
        outcome = attempt_task(
            self.task, self.method, self.reference, self.effects, self.world, np.random.default_rng(self.seed)
        )
        return TrialResult(
            landings=outcome.landings,
            total_error_cm=outcome.total_error_cm,
            fallbacks=outcome.fallbacks,
            substituted=outcome.substituted,
            metrics=outcome.metrics,
            disturbance=", ".join(str(one) for one in outcome.disturbances),
            samples=landing_samples(outcome),
            shifted=shifted_jumps(outcome),
            log=log_of(outcome, self.world.robot, Path(self.place).name) if self.with_log else None,
        )


@dataclass(frozen=True)
class TrialResult:
    """Landings of a trial, what it demanded of the robot, and when its controller fell back."""

    landings: tuple[Landing, ...]
    total_error_cm: float | None
    fallbacks: Mapping[str, int]
    substituted: tuple[tuple[float, str], ...]
    """Time, s, and reason of each fallback command."""
    metrics: RunMetrics
    samples: LandingSamples = field(default_factory=LandingSamples)
    log: Log | None = None
    shifted: ShiftedJumps | None = None
    """What goal-directed jumps did on the way; None for other methods."""
    disturbance: str = ""
    """What acted on the trunk, in words; empty if nothing did."""

    def to_json(self) -> dict[str, Any]:
        """All fields but the log, which is a file of its own."""
        found = {
            "landings": [asdict(one) for one in self.landings],
            "total_error_cm": self.total_error_cm,
            "fallbacks": dict(self.fallbacks),
            "substituted": [list(one) for one in self.substituted],
            "conduct": asdict(self.metrics),
            "disturbance": self.disturbance,
            "tried": {name: values.tolist() for name, values in asdict(self.samples).items()},
        }
        return found if self.shifted is None else found | {"shifted": self.shifted.to_json()}

    @staticmethod
    def from_json(raw: Mapping[str, Any], log: Log | None) -> "TrialResult":
        """The inverse of ``to_json``; numbers in JSON keep all their digits."""
        empty = LandingSamples()
        samples = {n: np.array(v, float).reshape(-1, *getattr(empty, n).shape[1:]) for n, v in raw["tried"].items()}
        return TrialResult(
            landings=tuple(Landing(**one) for one in raw["landings"]),
            total_error_cm=raw["total_error_cm"],
            fallbacks=raw["fallbacks"],
            substituted=tuple((time_s, reason) for time_s, reason in raw["substituted"]),
            metrics=RunMetrics(**raw["conduct"]),
            disturbance=raw["disturbance"],
            samples=LandingSamples(**samples),
            shifted=ShiftedJumps.from_json(raw["shifted"]) if "shifted" in raw else None,
            log=log,
        )


def log_of(outcome: TrialOutcome, robot: Robot, name: str) -> Log:
    """The log with two quantities that only a simulation knows: contacts, and the true ground forces."""
    columns = dict(outcome.run.log.columns)
    columns |= {f"contact/{foot}": outcome.run.touching[:, i].astype(float) for i, foot in enumerate(robot.feet)}
    force = pair_force(outcome.run, robot)
    columns |= {f"ground_force/{axis}": force[:, i] for i, axis in enumerate(PAIR_FORCE_AXES)}
    return replace(outcome.run.log, name=name, columns=columns)


def landing_samples(outcome: TrialOutcome) -> LandingSamples:
    """Goals, stances and landing poses of a run's goal-directed jumps, by the robot's own sensors.

    Jumps without a goal and jumps that fell are left out.
    """
    rows = [(jump.goal, jump.stance_pitch, landing) for jump, landing in upright_jumps(outcome)]
    if not rows:
        return LandingSamples()
    goals, stances, landings = (np.array(column) for column in zip(*rows, strict=True))
    return LandingSamples(goals, stances, landings)


def shifted_jumps(outcome: TrialOutcome) -> ShiftedJumps | None:
    """The same jumps with the shifts of their goals, and the deviations from the plan; None where there are none."""
    rows = [
        (jump.goal, jump.stance_pitch, landing, jump.shifts, jump.deviations)
        for jump, landing in upright_jumps(outcome)
    ]
    if not rows:
        return None
    goal, stance, landing, shift, deviation = (np.array(column) for column in zip(*rows, strict=True))
    return ShiftedJumps(goal, stance, landing, shift, deviation)


def upright_jumps(outcome: TrialOutcome) -> Iterator[tuple[GoalDirectedJump, np.ndarray]]:
    """The goal-directed jumps that did not fall, each with its landing pose."""
    for first, jump in zip(outcome.starts, outcome.controllers, strict=False):  # those never begun have no start
        if isinstance(jump, GoalDirectedJump) and jump.goal is not None:
            landing = landing_pose(outcome, first, jump.reference.schedule, jump.standing_height_m)
            if abs(landing[2]) <= UPRIGHT_RAD:
                yield jump, landing


def landing_pose(outcome: TrialOutcome, first: int, schedule: ContactSchedule, standing_height_m: float) -> np.ndarray:
    """Pose (x, z, pitch; m, m, rad) at the end of the scheduled flight of the jump begun at row ``first``, by its log.

    Where a foot touches earlier, the flight is extrapolated from there as a free one: landings then depend smoothly on
    the goal. x counts from the start along the heading, z from a robot that stands on the floor.
    """
    log, period = outcome.run.log, outcome.run.log.info.sample_period_s
    take_off, end = (first + round(seconds / period) for seconds in (schedule.take_off_s, schedule.landing_s))
    settled = take_off + round(LEAVES_WITHIN_S / period)
    touched = np.flatnonzero(outcome.run.touching[settled:end].any(axis=1))
    row = settled + touched[0] - 1 if len(touched) else end
    left_s = (end - row) * period
    quaternion = log.stack(BASE_QUATERNION)
    yaw = yaw_of(quaternion[first])
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    position, velocity = (log.stack(columns) for columns in (BASE_POSITION, BASE_VELOCITY))
    flown = position[row] + left_s * velocity[row] - np.array([0.0, 0.0, GRAVITY * left_s**2 / 2])
    pitch = pitch_of(quaternion[row]) + left_s * log["base_angvel_y"][row]
    return np.array([(flown - position[first]) @ ahead, flown[2] - standing_height_m, pitch])
