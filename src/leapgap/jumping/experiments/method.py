"""Base class of the landing methods: plain data from which the controllers of a task are made."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from leapgap.effects import effect
from leapgap.effects.base import Effect
from leapgap.jumping.control.mpc import JumpMpc, MpcConfig
from leapgap.jumping.control.shifted_plan import Observation
from leapgap.jumping.control.tracking import (
    Excitation,
    ExcitedController,
    JointPd,
    JumpController,
    PhaseGains,
    Reference,
)
from leapgap.jumping.experiments.goal_directed_jump import (
    GoalChoice,
    GoalDirectedJump,
    JumpPlanner,
    LandingModel,
    LandingSamples,
    best_goal,
)
from leapgap.jumping.models.rigid_body import DeviationModel, PredictionModel
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.logs.pair_force import FORCE_X
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PAIRS
from leapgap.simulation.closed_loop import Disturbance

BLOCK_EDGES_M = (0.24, 0.6)  # Edges of a block on uneven ground along x and y; both feet of a pair fit on one


@dataclass(frozen=True)
class JumpTask:
    """One or several jumps in a row, each from where the last one ended."""

    name: str
    x_m: float
    z_m: float = 0.0
    jumps: int = 1
    block_m: tuple[float, float] = (0.0, 0.0)
    """Range of the height of the block under the front feet at the start, drawn evenly. It should exceed 4 mm:
    soft feet sink in that far, and a foot would stand on block and floor at once."""
    slope_rad: tuple[float, float] = (0.0, 0.0)  # Range of the ground's slope, drawn evenly; positive falls forward
    uneven_m: tuple[float, float] = (0.0, 0.0)
    """Range of the height of the blocks that feet land on between the jumps, drawn evenly; 0: flat ground."""
    rear_block_m: tuple[float, float] = (0.0, 0.0)  # The same as ``block_m`` under the rear feet
    stance_is_seen: bool = True  # Whether a robot can measure its ground before it jumps; else it is taken for level
    crouch_error_rad: float = 0.0
    """Largest error of the joints in the crouch before the jump, drawn evenly for thighs and calves of each pair."""
    kick_m_s: float = 0.0  # Sudden change of the forward velocity, forward or back, once in the jump
    kick_rad_s: float = 0.0  # The same of the pitch rate
    push_n: tuple[float, float] = (0.0, 0.0)  # Range of a horizontal force on the trunk, forward or back, once a jump
    push_s: float = 0.1  # How long that force lasts
    disturbed_at_s: tuple[float, ...] = (0.3, 0.4)  # Times since the start of the jump; one is drawn for a kick or push

    def __post_init__(self) -> None:
        if self.jumps < 1:
            raise ValueError(f"jumps {self.jumps}: 1 or more")

    @property
    def target(self) -> Target:
        """Target of each jump, from its own take-off pose."""
        return Target(self.x_m, self.z_m)

    def start_block(self, rng: np.random.Generator) -> float:
        """Draw the height of the block under the front feet, m."""
        return round(float(rng.uniform(*self.block_m)), 4)

    def rear_start_block(self, rng: np.random.Generator) -> float:
        """Draw the height of the block under the rear feet, m; without one, nothing is drawn."""
        return round(float(rng.uniform(*self.rear_block_m)), 4) if self.rear_block_m[1] > 0 else 0.0

    def crouch_error(self, robot: Robot, rng: np.random.Generator) -> tuple[float, ...]:
        """Draw the error of each joint in the crouch, (joints,), rad, equal left and right; empty without an error."""
        if self.crouch_error_rad == 0:
            return ()
        error = np.zeros(len(robot.joints))
        for pair in PAIRS:
            for group in ("thigh", "calf"):
                joints = np.intersect1d(robot.joints_at(pair), robot.joints_at(group))
                error[joints] = round(float(rng.uniform(-1, 1)) * self.crouch_error_rad, 4)
        return tuple(float(value) for value in error)

    def disturbances(self, rng: np.random.Generator) -> tuple[Disturbance, ...]:
        """Draw one of the kinds of disturbance that the task has, its time and its direction."""
        kinds = [kind for kind in ("kick_m_s", "kick_rad_s") if getattr(self, kind) > 0]
        kinds += ["push_n"] if self.push_n[1] > 0 else []
        if not kinds:
            return ()
        kind, begin_s = str(rng.choice(kinds)), float(rng.choice(self.disturbed_at_s))
        sign = float(rng.choice([-1.0, 1.0]))
        if kind == "push_n":
            force = sign * round(float(rng.uniform(*self.push_n)), 2)
            return (Disturbance(begin_s, force_n=(force, 0.0), duration_s=self.push_s),)
        size = sign * float(getattr(self, kind))
        return (Disturbance(begin_s, velocity=(size, 0.0, 0.0) if kind == "kick_m_s" else (0.0, 0.0, size)),)

    def tilt(self, rng: np.random.Generator) -> tuple[Effect, ...]:
        """Draw the slope of the ground, as an effect; none where it is zero."""
        slope_rad = round(float(rng.uniform(*self.slope_rad)), 5)
        return (effect("ground_slope", pitch_rad=slope_rad),) if slope_rad else ()

    def ground(self, reference: Reference, rng: np.random.Generator) -> tuple[Box, ...]:
        """Draw one block for each landing between the jumps, near the planned place of the front or the rear feet."""
        if self.uneven_m[1] == 0:
            return ()
        front, rear = reference.foot[0, FORCE_X]
        boxes = []
        for jump in range(1, self.jumps):
            height = round(float(rng.uniform(*self.uneven_m)), 4)
            under = float(rng.choice([front, rear]))
            x = round(jump * self.x_m + under + float(rng.uniform(-0.03, 0.03)), 4)
            boxes.append(Box(x, 0.0, (*BLOCK_EDGES_M, height), height))
        return tuple(boxes)


References = Mapping[Target, Log]  # Plans from level ground, by their targets


@dataclass(frozen=True)
class Method(ABC):
    """Makes the controllers of a task. It is plain data, so that it can be sent to worker processes."""

    robot: Robot
    references: References
    gains: PhaseGains = field(default_factory=PhaseGains)

    def __call__(self, task: JumpTask) -> Sequence[JumpController]:
        """New controllers of the task's jumps, in their order."""
        return [self.controller(task, self.reference(task)) for _ in range(task.jumps)]

    def reference(self, task: JumpTask) -> Reference:
        """The plan of one of the task's jumps."""
        return Reference.of(self.references[task.target], self.robot)

    @abstractmethod
    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A new controller of one jump along its plan."""


def shift_target(target: Target, shift_m: float) -> Target:
    """The target moved ``shift_m`` farther away, rounded to the millimetre."""
    return Target(round(target.x_m + shift_m, 3), target.z_m)


def crouch(references: References, robot: Robot) -> np.ndarray:
    """Joint angles in which the plans begin, (joints,), rad."""
    return next(iter(references.values())).per_joint("cmd_pos", robot.joints)[0]


@dataclass(frozen=True)
class JointPdMethod(Method):
    """Joint PD and the planned torques, of a plan that goes ``shift_m`` farther than the target."""

    shift_m: float = 0.0

    def reference(self, task: JumpTask) -> Reference:
        """The plan to the shifted target."""
        return Reference.of(self.references[shift_target(task.target, self.shift_m)], self.robot)

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """Joint PD along the plan, with its torques as feed-forward."""
        return JointPd(reference, self.robot, self.gains)


@dataclass(frozen=True)
class MpcMethod(Method):
    """The paper's MPC with a prediction model."""

    model: PredictionModel | DeviationModel | None = None
    config: MpcConfig = field(default_factory=MpcConfig)
    excitation: Excitation | None = None  # Random forces on top of its own, by ``seed``
    seed: int = 0
    identified: tuple[Effect, ...] | None = None  # Effects that were identified in the robot; None: none looked for

    def excited(self, excitation: Excitation, seed: int) -> Self:
        """The same with random forces, as for practice."""
        return replace(self, excitation=excitation, seed=seed)

    def taught(self, model: DeviationModel, rounds: Sequence[LandingSamples]) -> Self:
        """The same after some rounds of practice: with their model, and where goals were chosen with their landings."""
        del rounds
        return replace(self, model=model)

    def flown(self, jump: Log, plan: Log, samples: LandingSamples) -> tuple[Log, Log] | None:
        """A jump from its begin on, and its plan; None where it is not to be learned from.

        ``plan`` is that from level ground, ``samples`` the goal that was chosen instead, if any.
        """
        del samples
        return jump, plan

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """The MPC along the plan."""
        assert self.model is not None
        return self.with_excitation(JumpMpc(reference, self.robot, self.gains, self.model, self.config))

    def with_excitation(self, controller: JumpController) -> JumpController:
        """A controller with the random forces, if any."""
        if self.excitation is None:
            return controller
        return ExcitedController(controller, self.excitation, np.random.default_rng(self.seed))


@dataclass(frozen=True)
class AimingMethod(Method):
    """Plans from the measured stance to the goal that a landing model says will land on the target."""

    planner: JumpPlanner | None = None
    landing: LandingModel | None = None
    offset: Mapping[str, np.ndarray] = field(default_factory=dict)
    """By name of the task: mean landing − predicted landing of its jumps, (3,), m, m, rad."""
    goal_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))  # Added to each goal, to explore; m, m, rad
    observation: Observation = field(default_factory=Observation)  # When deviations from the plan are kept

    def controller(self, task: JumpTask, reference: Reference) -> JumpController:
        """A jump that is planned after the stance was measured."""
        offset = self.offset.get(task.name)
        choice = goal_choice(task, self.planner, self.landing, self.goal_offset, offset, self.observation)
        return GoalDirectedJump(choice, reference, self.robot, self.gains)


def goal_choice(
    task: JumpTask,
    planner: JumpPlanner | None,
    landing: LandingModel | None,
    goal_offset: np.ndarray,
    farther: np.ndarray | None = None,
    observation: Observation | None = None,
) -> GoalChoice:
    """A task's jump to the goal that a landing model says will land on the target, and ``goal_offset`` (3,) beyond.

    ``farther`` (3,) is how much farther than the model says its jumps have landed.
    """
    assert planner is not None

    def aim(target: Target, stance_pitch: float) -> np.ndarray:
        return best_goal(landing, target, stance_pitch, farther) + goal_offset

    return GoalChoice(task.target, planner, aim, task.stance_is_seen, observation=observation or Observation())
