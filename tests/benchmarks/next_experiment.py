"""Does the proposed experiment tell apart what a report leaves open? Each is made by the case's own robot.

A pendulum, a vertical and a horizontal arm with one effect each move in few ways. Where the verdict is ambiguous, the
proposed experiment is simulated with the same robot, and all logs are diagnosed together. Run as
``python -m tests.benchmarks.next_experiment --json <file>``; takes about half an hour.
"""

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.experiment_plans import Given, planned
from leapgap.diagnosis.experiments import LOG_S, plans_of, sine_plan
from leapgap.diagnosis.hypotheses import places, usable
from leapgap.diagnosis.report import round_floats
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.logs.log import Log, LogInfo
from leapgap.reports.revisits import UNMADE
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.open_loop import Course, MotionPlan
from leapgap.simulation.sensors import SensorNoise
from leapgap.validation.case import NOISE
from leapgap.validation.generator import Generator, Nuisance, generate_jumps
from tests.benchmarks import run_benchmark

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
            sizes, length_s = [self.amplitude] * len(self.joints), max(LOG_S, 1 / self.frequency_hz)
            frequency_hz = self.frequency_hz * (0.85 + 0.15 * k)
            plan = sine_plan(given, k, self.joints, sizes, frequency_hz, length_s)
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


PENDULUM = """<mujoco model="pendulum">
  <option timestep="0.0005"/>
  <worldbody>
    <body name="rod" pos="0 0 1">
      <joint name="pivot" axis="0 1 0" damping="0.02" frictionloss="0.05" armature="0.003"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
      <geom type="sphere" pos="0 0 -0.5" size="0.04" mass="0.5" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor joint="pivot" forcerange="-20 20" ctrlrange="-20 20"/></actuator>
</mujoco>
"""
ARM = """<mujoco model="{name}">
  <option timestep="0.0005"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="{axis}" damping="{damping}"
             frictionloss="{friction[0]}" armature="0.01" range="-120 120"/>
      <geom type="capsule" fromto="0 0 0 {ends[0]}" size="0.03" mass="1.5" contype="0" conaffinity="0"/>
      <body name="lower" pos="{ends[0]}">
        <joint name="elbow" axis="{axis}" damping="{damping}"
               frictionloss="{friction[1]}" armature="0.01" range="-150 150"/>
        <geom type="capsule" fromto="0 0 0 {ends[1]}" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="shoulder" forcerange="-60 60" ctrlrange="-60 60"/>
    <motor joint="elbow" forcerange="-60 60" ctrlrange="-60 60"/>
  </actuator>
</mujoco>
"""
VERTICAL = ARM.format(name="arm", axis="0 1 0", damping=0.05, friction=(0.1, 0.05), ends=("0 0 -0.4", "0 0 -0.3"))
HORIZONTAL = ARM.format(
    name="table_arm", axis="0 0 1", damping=0.02, friction=(0.02, 0.02), ends=("0.4 0 0", "0.3 0 0")
)
ROBOTS = {"pendulum": PENDULUM, "arm": VERTICAL, "table_arm": HORIZONTAL}
FAMILIES = (
    ("armature", "leg_mass", "link_com", "torque_gain"),
    ("encoder_bias", "torque_offset"),
    ("joint_damping", "joint_friction", "quadratic_damping", "static_friction"),
    ("command_delay", "motor_lag", "velocity_filter"),
)
"""Effects that leave similar traces. One of a family acts in a case, and the diagnosis looks for all of the family."""
LOGS = 2


def draw_case(robot: Robot, seed: int, family: Sequence[str]) -> OpenCase:
    """A case with an effect, joints that move, gains, amplitude, frequency and rate of its own."""
    rng = np.random.default_rng(seed)
    effect = draw_effect(robot, rng, family)
    moving = {str(joint) for joint in rng.choice(robot.joints, rng.integers(1, len(robot.joints) + 1), replace=False)}
    return OpenCase(
        robot,
        effect,
        seed,
        tuple(joint for joint in robot.joints if joint in moving),
        kp=float(rng.choice([15, 30, 60])),
        kd=1.0,
        amplitude=float(rng.uniform(0.2, 0.5)),
        frequency_hz=float(rng.uniform(0.6, 1.2)),
        period_s=float(rng.choice([0.001, 0.002, 0.004])),
        logs=LOGS,
    )


def diagnosed(logs: list[Log], robot: Robot, family: Sequence[str]) -> Diagnosis:
    """The diagnosis of some logs by the default settings and the effects of one family."""
    return diagnose(logs, robot, Settings(effects=list(family)), threads=1)


def run(case: OpenCase, family: Sequence[str]) -> dict[str, Any] | None:
    """The row of one case; None where its verdict is not ambiguous, or leaves out the truth."""
    logs = case.make(case.plans())
    found = diagnosed(logs, case.robot, family)
    told = {name for names in found.report.answer for name in names}
    print(f"{case.seed} {case.robot.name} {case.effect}: {found.report.verdict} {found.report.answer}", flush=True)
    if found.report.verdict != "ambiguous":
        return None
    after = follow(case, logs, found, partial(diagnosed, family=family))
    proposal = after.proposal or {}
    print(f"    {proposal.get('sentence')}\n    -> {after.verdict} {after.after} resolved={after.resolved}", flush=True)
    return {
        **asdict(after),
        "seed": case.seed,
        "robot": case.robot.name,
        "effect": str(case.effect),
        "truth_told": case.effect.name in told,
        "made": "settings" in proposal,
        "resolved": after.resolved,
    }


def main() -> None:
    """Run cases of one range of seeds until enough experiments were made."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--first", type=int, default=9000)
    parser.add_argument("--cases", type=int, default=300)
    parser.add_argument("--robot", choices=(*ROBOTS, "all"), default="all")
    parser.add_argument("--families", type=int, nargs="+", default=list(range(len(FAMILIES))))
    parser.add_argument("--tiny", action="store_true", help="one case, to see that it runs")
    settings = parser.parse_args()
    number = 1 if settings.tiny else settings.cases
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        robots = []
        for robot, text in ROBOTS.items():
            path = Path(name) / f"{robot}.xml"
            path.write_text(text, encoding="utf-8")
            robots += [Robot.load(path)] if settings.robot in (robot, "all") else []
        for seed in range(settings.first, settings.first + number):
            family = FAMILIES[settings.families[seed // len(robots) % len(settings.families)]]
            row = run(draw_case(robots[seed % len(robots)], seed, family), family)
            rows += [] if row is None else [row]
            made = [one for one in rows if one["made"]]
            figures = {
                "cases": seed + 1 - settings.first,
                "ambiguous": len(rows),
                "made": len(made),
                "resolved": sum(one["resolved"] for one in made),
                "rows": rows,
            }
            write_json(settings.json, round_floats(figures))


if __name__ == "__main__":
    run_benchmark(main)
