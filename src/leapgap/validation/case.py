"""One withheld case: its logs, and the truth about them."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.atomic_io import sha256
from leapgap.diagnosis.channels import HEADLINE, logged_values
from leapgap.diagnosis.gap import JudgedLogs, headline_gap, noise_floor, value_counts
from leapgap.effects.base import Effect
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan
from leapgap.simulation.replay import Replayer, Rollout
from leapgap.simulation.sensors import SensorNoise
from leapgap.validation.case_draw import Case
from leapgap.validation.generator import Effects, Generator, Made, Nuisance, NuisanceSizes, make
from leapgap.validation.off_table import family
from leapgap.validation.true_localisation import places

DETECTABLE_FLOORS = 2.0
"""A motion that an effect changes by so many noise floors is detectable (contract)."""


NOISE = SensorNoise(
    base_pos_m=0.0012,
    base_angle_rad=0.0015,
    base_linvel_m_s=0.012,
    base_angvel_rad_s=0.018,
    joint_pos_rad=0.0006,
    joint_vel_rad_s=0.06,
)
"""Of the generating side's sensors: other than those of the simulated hardware that the diagnosis was developed on."""


@dataclass(frozen=True)
class CaseSetup:
    """What the generating side is, for every case."""

    jumps: int
    proof_jumps: int
    """Further jumps that stay with the truth: what an answer must close."""
    block_height_m: tuple[float, float]
    step_s: float
    period_scatter: float
    """Of an effect that differs from log to log: standard deviation of its departure, as a share of it."""
    where_horizon_s: float
    noise: SensorNoise = NOISE
    course: Course = field(default_factory=Course)
    nuisances: NuisanceSizes = field(default_factory=NuisanceSizes)


@dataclass(frozen=True)
class Withheld:
    """The two sides of a case."""

    logs: tuple[Log, ...]
    proof: tuple[Log, ...]
    truth: Mapping[str, Any]
    """Without the hashes of the files, which are known once they are written."""


def withhold(case: Case, references: Sequence[Log], robot: Robot, world: CaseSetup) -> Withheld:
    """Make a case's jumps and find out what its effects do to them."""
    rng = np.random.default_rng(case.seed)
    nuisance = Nuisance(seed=int(rng.integers(2**31)), sizes=world.nuisances)
    salt = rng.bytes(16).hex()
    count = world.jumps + world.proof_jumps
    chosen = rng.permutation(count) % len(references)
    heights = rng.uniform(*world.block_height_m, count)
    scatter = 1 + world.period_scatter * rng.standard_normal(count)
    noise_rng, floor_rng = rng.spawn(2)
    plans = [
        MotionPlan(f"jump_{i}" if i < world.jumps else f"proof_{i - world.jumps}", references[c], round(float(h), 4))
        for i, (c, h) in enumerate(zip(chosen, heights, strict=True))
    ]
    generator = Generator(robot, terrain_slots=1, step_s=world.step_s)
    own: list[Effects] = [(nuisance, *(on_log(e, s, robot) for e in case.effects)) for s in scatter]
    made = make(plans, own, generator, world.noise, world.course, noise_rng)
    seen = made[: world.jumps]
    truth: dict[str, Any] = {
        "salt": salt,
        "half": case.half,
        "kind": case.kind,
        "seed": case.seed,
        "effects": [described(e) for e in case.effects],
        "per_log": {plan.name: [e.values for e in of_log[1:]] for plan, of_log in zip(plans, own, strict=True)},
        **what_shows(case, seen, own, generator, robot, world, floor_rng),
    }
    return Withheld(tuple(m.log for m in seen), tuple(m.log for m in made[world.jumps :]), truth)


def on_log(effect: Effect, scatter: float, robot: Robot) -> Effect:
    """The effect on one log: some differ from log to log."""
    if not effect.differs_per_log:
        return effect
    parameters = effect.parameters(robot, effect.location)
    changed = {p.name: p.nominal + scatter * (getattr(effect, p.name) - p.nominal) for p in parameters}
    return replace(effect, **changed)


def described(effect: Effect) -> dict[str, Any]:
    """An effect as a truth states it."""
    return {"name": effect.name, "location": effect.location, "parameters": effect.values}


def restored(entry: Mapping[str, Any]) -> Effect:
    """The inverse of ``described``."""
    kind = effects.known().get(entry["name"]) or family(entry["name"])
    return kind(location=entry["location"], **entry["parameters"])


def what_shows(
    case: Case,
    made: Sequence[Made],
    own: Sequence[Effects],
    generator: Generator,
    robot: Robot,
    world: CaseSetup,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """How much the effects, together and each, change the judged motion, in noise floors; and where."""
    judged = JudgedLogs.of([m.log for m in made], robot)
    replayer = Replayer(robot, threads=1)
    floor = headline_gap(noise_floor(judged, replayer, 3, rng), judged)
    nominal = replayer.motions([Rollout(jump) for jump in judged.logs])
    shown: dict[str, Any] = {
        "noise_floor": floor,
        "gap_nominal": difference([m.log for m in made], nominal, judged, robot),
    }
    if not case.effects:
        return shown | {"change": 0.0, "detectable": False, "changes": [], "where": []}
    clean = [m.clean for m in made]
    changes = []
    for left_out in (None, *range(len(case.effects))) if len(case.effects) > 1 else (None,):
        kept = [
            (e[0], *(x for i, x in enumerate(e[1:]) if left_out is not None and i != left_out))
            for e in own[: len(made)]
        ]
        trials = [Rollout(jump, of_log) for jump, of_log in zip(clean, kept, strict=True)]
        motions = generator.motions(trials, rows=max(judged.rows))
        changes.append(difference(clean, motions, judged, robot))
    off = [Rollout(jump, e[:1]) for jump, e in zip(clean, own, strict=False)]
    return shown | {
        "change": changes[0],
        "detectable": changes[0] >= DETECTABLE_FLOORS * floor,
        "changes": changes[1:] or changes,
        "where": places([m.log for m in made], off, judged, generator, world.where_horizon_s),
    }


def difference(jumps: Sequence[Log], motions: Sequence[Any], judged: JudgedLogs, robot: Robot) -> float:
    """Headline figure between jumps and motions over the judged rows."""
    total = 0.0
    for jump, motion, rows in zip(jumps, motions, judged.rows, strict=True):
        for c in judged.channels:
            missed = c.values(motion, robot)[:rows] - logged_values(jump, c.name)[:rows]
            total += float(((missed / HEADLINE[c.name]) ** 2).sum())
    return float(np.sqrt(total / value_counts(judged).sum()))


def write_case(withheld: Withheld, logs: Path, proof: Path) -> dict[str, Any]:
    """Write logs and proof jumps; the truth with their hashes."""
    hashes = {}
    for key, folder, jumps in (("logs", logs, withheld.logs), ("proof", proof, withheld.proof)):
        for jump in jumps:
            jump_log.write_log(jump, folder / f"{jump.name}.parquet")
        hashes[key] = {f"{jump.name}.parquet": sha256(folder / f"{jump.name}.parquet") for jump in jumps}
    return {**withheld.truth, **hashes}


def real_case(jumps: Sequence[Log], salt_seed: int) -> Withheld:
    """Real jumps split by jump: every other one is diagnosed, the rest is what the answer must close."""
    salt = hashlib.sha256(f"{salt_seed}".encode()).hexdigest()[:32]
    nothing_known = {"effects": [], "detectable": False, "where": [], "change": None}
    truth = {"salt": salt, "half": "real", "kind": "real", **nothing_known}
    return Withheld(tuple(jumps[::2]), tuple(jumps[1::2]), truth)


def further_jumps(
    truth: Mapping[str, Any],
    references: Sequence[Log],
    block_height_m: tuple[float, float],
    robot: Robot,
    world: CaseSetup,
) -> list[Log]:
    """More jumps of a case's own robot, nuisances included: one to each reference."""
    nuisance = Nuisance(seed=int(np.random.default_rng(truth["seed"]).integers(2**31)), sizes=world.nuisances)
    rng = np.random.default_rng([truth["seed"], 1])
    acting = [restored(entry) for entry in truth["effects"]]
    heights = rng.uniform(*block_height_m, len(references))
    plans = [
        MotionPlan(f"next_{i}", r, round(float(h), 4)) for i, (r, h) in enumerate(zip(references, heights, strict=True))
    ]
    scatter = 1 + world.period_scatter * rng.standard_normal(len(plans))
    own: list[Effects] = [(nuisance, *(on_log(e, s, robot) for e in acting)) for s in scatter]
    generator = Generator(robot, terrain_slots=1, step_s=world.step_s)
    return [made.log for made in make(plans, own, generator, world.noise, world.course, rng)]
