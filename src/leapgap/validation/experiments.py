"""Proposed experiments, made: the case's own robot does what a report asks for, and all logs are diagnosed together."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.diagnosis.diagnose import Diagnosis
from leapgap.diagnosis.experiments import plans_of
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import planned
from leapgap.diagnosis.experiments.sines import Sines
from leapgap.diagnosis.hypotheses import places, usable
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.base import Effect
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan
from leapgap.simulation.sensors import SensorNoise
from leapgap.validation.case import NOISE, CaseSetup, further_logs
from leapgap.validation.generator import Generator, Nuisance, generate_jumps

UNMADE = ("sensor", "jumps")
"""Kinds of experiments that ``make`` cannot make: the generator has no sensors beside the state, and plans no jumps."""
COURSE = Course(settle_s=0.5, after_landing_s=0.0)
SIZES = (0.4, 2.5)
"""Least and most departure from nominal of a drawn effect, in moderate departures; its logarithm is drawn evenly."""


@dataclass(frozen=True)
class OpenCase:
    """A robot with one effect that moves in too few ways to tell all causes apart."""

    robot: Robot
    effect: Effect
    seed: int
    joints: tuple[str, ...]
    """Joints that move in its logs; the others are held."""
    kp: float
    kd: float
    amplitude: float
    """Of the motion of each joint, rad."""
    frequency_hz: float
    period_s: float
    logs: int = 3
    length_s: float = 0.8
    noise: SensorNoise = NOISE

    @property
    def nuisance(self) -> Nuisance:
        """The small errors of this case's model."""
        return Nuisance(seed=int(np.random.default_rng([self.seed, 1]).integers(2**31)))

    def plans(self) -> list[Log]:
        """Sines of slightly different frequency."""
        robot, count = self.robot, round(2.0 / self.period_s) + 1
        pose = robot.model.key_qpos[0] if robot.model.nkey else robot.model.qpos0
        start = np.concatenate([pose, np.zeros(robot.model.nv)])
        hold = {f"{name}/{joint}": np.zeros(count) for joint in robot.joints for name in ("cmd_tau", "cmd_vel")}
        for joint, at in zip(robot.joints, robot.joint_qpos, strict=True):
            hold |= {f"cmd_pos/{joint}": np.full(count, start[at])}
            hold |= {f"cmd_kp/{joint}": np.full(count, self.kp), f"cmd_kd/{joint}": np.full(count, self.kd)}
        info = LogInfo(robot.name, self.period_s, "a withheld case")
        given = Given((planned("hold", hold, start, info, robot),), robot)
        found = []
        for k in range(self.logs):
            sines = Sines(self.joints, (self.amplitude,) * len(self.joints), self.frequency_hz)
            plan = sines.plan(k, self.frequency_hz * (0.85 + 0.15 * k), given)
            found.append(replace(plan.first_rows(round(self.length_s / self.period_s) + 1), name=f"log_{k}"))
        return found

    def make(self, plans: Sequence[Log], stream: int = 2) -> list[Log]:
        """Logs of plans by the case's own robot."""
        generator = Generator(self.robot, terrain_slots=1, step_s=min(0.00025, self.robot.model.opt.timestep))
        rng = np.random.default_rng([self.seed, stream])
        motions = [MotionPlan(plan.name, plan) for plan in plans]
        own = (self.nuisance, self.effect)
        made = generate_jumps(motions, [own] * len(plans), generator, self.noise, COURSE, rng)
        return [one.log for one in made]


def draw_effect(robot: Robot, rng: np.random.Generator, names: Sequence[str]) -> Effect:
    """One effect of random size at a random place, on either side of nominal where its range has two."""
    kinds = [effects.known()[name] for name in names if usable(effects.known()[name], robot)]
    kind = kinds[rng.integers(len(kinds))]
    locations = list(places(kind, robot))
    location = locations[rng.integers(len(locations))]
    values = {}
    for p in kind.parameters(robot, location):
        least, most = SIZES
        departure = (p.moderate - p.nominal) * least * (most / least) ** rng.uniform()
        sign = -1.0 if p.lower < p.nominal < p.upper and not p.lower_is_physical and rng.random() < 0.3 else 1.0
        values[p.name] = float(f"{np.clip(p.nominal + sign * departure, p.lower, p.upper):.4g}")
    return kind(location=location, **values)


@dataclass(frozen=True)
class Resolution:
    """What became of a proposed experiment."""

    truth: str
    before: tuple[tuple[str, ...], ...]
    proposal: dict[str, Any] | None
    verdict: str
    after: tuple[tuple[str, ...], ...]

    @property
    def resolved(self) -> bool:
        """Whether exactly the true effect is named."""
        return self.verdict == "named" and self.after == ((self.truth,),)


def follow(
    case: OpenCase, logs: Sequence[Log], found: Diagnosis, diagnose_again: Callable[[list[Log], Robot], Diagnosis]
) -> Resolution:
    """Make the experiment that a diagnosis proposes, and diagnose again."""
    report = found.report
    proposal = report.next_experiment
    settings, truth = proposal and proposal.get("settings"), case.effect.called(case.robot)
    if proposal is None or settings is None or settings["kind"] in UNMADE:
        return Resolution(truth, report.answer, dict(proposal or {}), report.verdict, report.answer)
    given = Given(tuple(found.logs), case.robot)
    further = case.make(plans_of(settings, given), stream=3)
    again = diagnose_again([*logs, *further], case.robot).report
    return Resolution(truth, report.answer, dict(proposal), again.verdict, again.answer)


def proposed_logs(
    truth: Mapping[str, Any], proposal: Mapping[str, Any], logs: Sequence[Log], robot: Robot, setup: CaseSetup
) -> list[Log]:
    """Logs of the experiment that a report on some logs proposes, by the robot of a withheld case."""
    given = Given(JudgedLogs.of(logs, robot).logs, robot)
    plans = [MotionPlan(plan.name, plan) for plan in plans_of(proposal, given)]
    return further_logs(truth, plans, robot, setup, np.random.default_rng([truth["seed"], 1]))
