"""What stage collect simulates: hardware, targets and controller of each jump."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.jumping.control.mpc import MpcConfig
from leapgap.jumping.control.tracking import Excitation, ExcitedController, JumpController, PhaseGains
from leapgap.jumping.experiments.method import JointPdMethod, JumpTask, Method, MpcMethod, References, crouch
from leapgap.jumping.experiments.trial import TrialSetup, attempt_task
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.models.rigid_body import RigidBody, RigidBodyModel, planner_body
from leapgap.jumping.planning.reference import read_targets, reference_to
from leapgap.jumping.task import Target
from leapgap.logs.log import Log, write_log
from leapgap.robot.model import Robot
from leapgap.runtime.executor import Executor
from leapgap.simulation.closed_loop import Sensing
from leapgap.simulation.open_loop import Course
from leapgap.simulation.presets import Variant


@dataclass(frozen=True)
class CollectionSpec:
    """One jump to make. It is plain data, so that it can be sent to worker processes."""

    name: str
    task: JumpTask
    method: Method
    effects: tuple[Effect, ...]
    world: TrialSetup
    seed: int
    excitation: Excitation = field(default_factory=Excitation)

    def run(self) -> tuple[Log, str]:
        """Simulate the jump in closed loop: its log, and where it landed in words; equal seeds give equal results."""
        rng = np.random.default_rng(self.seed)

        def controllers(task: JumpTask) -> list[JumpController]:
            plain = list(self.method(task))
            if self.excitation.force_n == 0:
                return plain
            return [ExcitedController(one, self.excitation, rng) for one in plain]

        level = self.method.references[self.task.target]
        outcome = attempt_task(self.task, controllers, level, self.effects, self.world, rng)
        landing, count = outcome.landings[0], sum(outcome.fallbacks.values())
        begins = f"{self.task.x_m:.2f} m from a {100 * self.task.block_m[0]:.1f} cm block"
        lands = f"{landing_in_words(landing.error_cm)}, pitched {landing.pitch_deg:+.0f} degrees"
        says = f"{self.name}: {begins}, lands {lands}" + (f", {count} fallbacks" if outcome.fallbacks else "")
        return Log(self.name, outcome.run.log.columns, outcome.run.log.info), says


@dataclass(frozen=True)
class CollectSettings:
    """Section ``collect`` of the configuration."""

    references: str
    robot: str | None
    hardware: str
    hardware_seed: int
    controller: str
    jumps: int
    target: Any
    targets: Any
    distance_m: tuple[float, float]
    block_height_m: tuple[float, float]
    seed: int
    out: str | None
    variants: dict[str, Any]
    gains: PhaseGains = field(default_factory=PhaseGains)
    mpc: MpcConfig = field(default_factory=MpcConfig)
    body: Any = None
    excitation: Excitation = field(default_factory=Excitation)
    sensing: Sensing = field(default_factory=Sensing)
    course: Course = field(default_factory=Course)

    def __post_init__(self) -> None:
        if self.jumps < 1:
            raise ValueError(f"jumps {self.jumps}: 1 or more")


def targets_of(settings: CollectSettings, rng: np.random.Generator) -> list[Target]:
    """The target of each jump: the one configured, those listed in turn, or random flat ones, rounded to 1 mm."""
    listed = settings.targets if settings.target is None else [settings.target]
    if listed is None:
        return [Target(round(float(rng.uniform(*settings.distance_m)), 3), 0.0) for _ in range(settings.jumps)]
    targets = read_targets(listed, "collect.targets")
    return [targets[i % len(targets)] for i in range(settings.jumps)]


def plan_jumps(
    settings: CollectSettings,
    robot: Robot,
    corrections: Sequence[Effect],
    body: RigidBody | None,
    rounded: RigidBody | None,
) -> list[CollectionSpec]:
    """The jumps to make, on a robot with ``corrections`` that its controller knows and effects that it does not.

    ``body``: what controllers assume; None: the robot's own with mass and inertia of ``rounded``, where there is one.
    """
    if settings.hardware not in settings.variants:
        expected = f"one of {', '.join(settings.variants)}"
        raise InputError("collect.hardware", settings.hardware, expected, "choose a known variant")
    hidden = Variant(**settings.variants[settings.hardware]).draw(settings.hardware_seed)
    effects = (*corrections, *hidden)
    rng = np.random.default_rng(settings.seed)
    targets = targets_of(settings, rng)
    references = {target: reference_to(target, Path(settings.references), planar_robot(robot)) for target in targets}
    body = body or planner_body(robot, crouch(references, robot), rounded)
    method = method_of(settings, robot, references, body)
    world = TrialSetup(robot, settings.sensing, course=settings.course, body=body)
    planned = []
    for i, target in enumerate(targets):
        block = round(float(rng.uniform(*settings.block_height_m)), 4)
        task = JumpTask("collect", target.x_m, target.z_m, block_m=(block, block))
        name, seed = f"{settings.hardware}_{i:02d}", int(rng.integers(2**31))
        planned.append(CollectionSpec(name, task, method, effects, world, seed, settings.excitation))
    return planned


def method_of(settings: CollectSettings, robot: Robot, references: References, body: RigidBody) -> Method:
    """The landing method that ``collect.controller`` names."""
    if settings.controller == "joint_pd":
        return JointPdMethod(robot, references, settings.gains)
    if settings.controller == "nominal_mpc":
        return MpcMethod(robot, references, settings.gains, RigidBodyModel(body), settings.mpc)
    raise InputError("collect.controller", settings.controller, "joint_pd or nominal_mpc", "choose one")


def collect_jumps(planned: Sequence[CollectionSpec], executor: Executor, folder: Path) -> None:
    """Make the jumps, write their logs into a folder, and print where each landed."""
    for log, says in executor.map(CollectionSpec.run, planned):
        write_log(log, folder / f"{log.name}.parquet")
        print(says, flush=True)


def landing_in_words(error_cm: float) -> str:
    """How far from its target a jump lands, cm; a positive error is short of it (``Landing``)."""
    size = f"{abs(error_cm):.1f}"
    if size == "0.0":
        return "on target"
    return f"{size} cm {'short' if error_cm > 0 else 'too far'}"
