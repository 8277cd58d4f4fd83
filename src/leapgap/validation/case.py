"""One case of the benchmark: its jump logs, and the truth about what acts in them."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.diagnosis.channels import channel_errors, sensor_noise
from leapgap.diagnosis.experiment_plans import Given
from leapgap.diagnosis.experiments import plans_of
from leapgap.diagnosis.gap import headline_gap, noise_floor
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.localisation import least_noise, phase_names, pieces_of
from leapgap.effects.base import Effect
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.runtime.atomic_io import sha256
from leapgap.simulation.open_loop import Course, MotionPlan
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import SensorNoise
from leapgap.validation.case_draw import Case
from leapgap.validation.generator import (
    USUAL,
    Effects,
    GeneratedJump,
    Generator,
    Nuisance,
    NuisanceSizes,
    Physics,
    generate_jumps,
    physics_of,
)
from leapgap.validation.off_table import family
from leapgap.validation.outcome import CLOCK, DETECTABLE_FLOORS
from leapgap.validation.uneven_rows import ClockFamily, UnevenRows

CLOCK_SEED = 2  # distinguishes the generator of the rows from others of the same case

NOISE = SensorNoise(
    base_pos_m=0.0012,
    base_angle_rad=0.0015,
    base_linvel_m_s=0.012,
    base_angvel_rad_s=0.018,
    joint_pos_rad=0.0006,
    joint_vel_rad_s=0.06,
)
"""Sensor noise of the generator; the simulated hardware that the diagnosis was developed on has another one."""


@dataclass(frozen=True)
class CaseSetup:
    """How the jumps of every case are generated."""

    jumps: int
    proof_jumps: int  # further jumps that stay with the truth; the realised closure of an answer is measured on them
    block_height_m: tuple[float, float]
    step_s: float
    period_scatter: float  # from log to log, of an effect that differs by log, as a share of its departure from nominal
    where_horizon_s: float  # length of the replays that localise the effects
    noise: SensorNoise = NOISE
    course: Course = field(default_factory=Course)
    nuisances: NuisanceSizes = field(default_factory=NuisanceSizes)
    physics: str = USUAL.name  # physics of cases whose kind asks for no other
    log: str = "jump"  # what the logs are called, before their number

    def physics_of_case(self, name: str) -> Physics:
        """The physics that a case is generated with, which itself asks for the physics of this name."""
        return physics_of(self.physics if name == USUAL.name else name)


@dataclass(frozen=True)
class WithheldCase:
    """A generated case: the logs that are diagnosed, and what stays sealed until the score."""

    logs: tuple[Log, ...]
    proof: tuple[Log, ...]  # jumps that stay with the truth
    truth: Mapping[str, Any]  # content of the truth file, without the hashes of the log files; ``write_case`` adds them


def withhold(case: Case, references: Sequence[Log], robot: Robot, setup: CaseSetup) -> WithheldCase:
    """Generate the jumps of a case and measure how much its effects change them."""
    rng = np.random.default_rng(case.seed)
    physics = setup.physics_of_case(case.physics.name)
    nuisance = Nuisance(seed=int(rng.integers(2**31)), sizes=setup.nuisances, physics=physics)
    salt = rng.bytes(16).hex()
    count = setup.jumps + setup.proof_jumps
    chosen = rng.permutation(count) % len(references)
    heights = rng.uniform(*setup.block_height_m, count)
    scatter = 1 + setup.period_scatter * rng.standard_normal(count)
    noise_rng, floor_rng = rng.spawn(2)
    plans = [
        MotionPlan(
            f"{setup.log}_{i}" if i < setup.jumps else f"proof_{i - setup.jumps}", references[c], round(float(h), 4)
        )
        for i, (c, h) in enumerate(zip(chosen, heights, strict=True))
    ]
    generator = Generator(robot, terrain_slots=1, step_s=physics.step_s or setup.step_s)
    own: list[Effects] = [(nuisance, *(scatter_effect(e, s, robot) for e in case.effects)) for s in scatter]
    clock_seed = (case.seed, CLOCK_SEED)
    generated = generate_jumps(plans, own, generator, setup.noise, setup.course, noise_rng, case.clock, clock_seed)
    diagnosed = generated[: setup.jumps]
    rows_of = [() if jump.rows is None else (jump.rows,) for jump in generated]
    own = [(e[0], *rows_of_jump, *e[1:]) for e, rows_of_jump in zip(own, rows_of, strict=True)]
    truth: dict[str, Any] = {
        "salt": salt,
        "half": case.half,
        "kind": case.kind,
        "seed": case.seed,
        "effects": [*clock_to_json(case, diagnosed), *(effect_to_json(e) for e in case.effects)],
        "per_log": {plan.name: [values_of(e) for e in of_log[1:]] for plan, of_log in zip(plans, own, strict=True)},
        **further_truth(case),
        **detectability(case, diagnosed, own, generator, robot, setup, floor_rng),
    }
    return WithheldCase(tuple(g.log for g in diagnosed), tuple(g.log for g in generated[setup.jumps :]), truth)


def values_of(effect: Effect) -> dict[str, float]:
    """Parameters of an effect on one log; of uneven rows their mean length, in claimed periods."""
    return {"scale": mean_length(effect)} if isinstance(effect, UnevenRows) else effect.values


def mean_length(rows: UnevenRows) -> float:
    """True over claimed mean length of a row, the last one left out."""
    return 1.0 if rows.lengths is None else float(rows.lengths[:-1].mean())


def clock_to_json(case: Case, jumps: Sequence[GeneratedJump]) -> list[dict[str, Any]]:
    """Entry of the truth about the rows of a case, under the name that a diagnosis has for it; none if they are even.

    ``scale`` is the median over the jumps.
    """
    if case.clock is None:
        return []
    lengths = [mean_length(jump.rows) for jump in jumps if jump.rows is not None]
    return [{"name": CLOCK, "location": "all", "parameters": {"scale": float(np.median(lengths))}}]


def further_truth(case: Case) -> dict[str, Any]:
    """Entries of the truth that ordinary cases have not: the clock family with its sizes, and the physics."""
    entries: dict[str, Any] = {}
    if case.clock is not None:
        entries["clock"] = {"family": case.clock.name, "sizes": dict(case.clock.sizes)}
    if case.physics != USUAL:
        entries["physics"] = case.physics.name
        entries["accepted"] = list(case.physics.accepted)
    return entries


def scatter_effect(effect: Effect, scatter: float, robot: Robot) -> Effect:
    """The effect on one log: where it differs by log, its departure from nominal is multiplied by ``scatter``."""
    if not effect.differs_per_log:
        return effect
    parameters = effect.parameters(robot, effect.location)
    changed = {p.name: p.nominal + scatter * (getattr(effect, p.name) - p.nominal) for p in parameters}
    return replace(effect, **changed)


def effect_to_json(effect: Effect) -> dict[str, Any]:
    """Entry of an effect in a truth file: name, location and parameters."""
    return {"name": effect.name, "location": effect.location, "parameters": effect.values}


def effect_from_json(entry: Mapping[str, Any]) -> Effect:
    """The effect that an entry of a truth file states; the inverse of ``effect_to_json``."""
    kind = effects.known().get(entry["name"]) or family(entry["name"])
    return kind(location=entry["location"], **entry["parameters"])


@dataclass(frozen=True)
class ChosenCase:
    """A case that is not drawn: its effects as a truth file has them, and its seed."""

    half: str
    kind: str
    seed: int
    effects: list[dict[str, Any]]

    @property
    def case(self) -> Case:
        """The case as one that was drawn."""
        return Case(self.half, self.kind, tuple(effect_from_json(entry) for entry in self.effects), self.seed)


def detectability(
    case: Case,
    generated: Sequence[GeneratedJump],
    own: Sequence[Effects],
    generator: Generator,
    robot: Robot,
    setup: CaseSetup,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Entries of the truth: by how much the effects, together and each, change the judged motion, and where.

    Changes are headline figures, in the units of ``gap_nominal`` and ``noise_floor``. ``changes`` holds, for each of
    several effects, the change that is lost when that effect alone is switched off.
    """
    logs = [g.log for g in generated]
    judged = JudgedLogs.of(logs, robot)
    replayer = Replayer(robot, threads=1)
    floor = headline_gap(noise_floor(judged, replayer, 3, rng), judged)
    nominal = replayer.motions([Rollout(jump) for jump in judged.logs])
    figures: dict[str, Any] = {"noise_floor": floor, "gap_nominal": difference(logs, nominal, judged)}
    if len(own[0]) == 1:
        return figures | {"change": 0.0, "detectable": False, "changes": [], "where": []}
    clean = [g.clean for g in generated]
    changes = []
    acting = len(own[0]) - 1
    for left_out in (None, *range(acting)) if acting > 1 else (None,):
        kept = [
            (e[0], *(x for i, x in enumerate(e[1:]) if left_out is not None and i != left_out))
            for e in own[: len(generated)]
        ]
        trials = [Rollout(jump, of_log) for jump, of_log in zip(clean, kept, strict=True)]
        motions = generator.motions(trials, rows=max(judged.rows))
        changes.append(difference(clean, motions, judged))
    off = [Rollout(jump, e[:1]) for jump, e in zip(clean, own, strict=False)]
    return figures | {
        "change": changes[0],
        "detectable": changes[0] >= DETECTABLE_FLOORS * floor,
        "changes": changes[1:] or changes,
        "where": true_localisation(logs, off, judged, generator, setup.where_horizon_s),
    }


def difference(jumps: Sequence[Log], motions: Sequence[Motion], judged: JudgedLogs) -> float:
    """Headline figure (root mean square in the sizes of the channels) between jumps and motions on the judged rows."""
    total = 0.0
    for jump, motion, rows in zip(jumps, motions, judged.rows, strict=True):
        measured = motion_of(jump.first_rows(rows), judged.robot)
        error = channel_errors(motion[:rows], measured, judged.channels, judged.robot)
        total += float(((error / judged.scales) ** 2).sum())
    return float(np.sqrt(total / judged.value_counts.sum()))


def write_case(withheld: WithheldCase, logs: Path, proof: Path) -> dict[str, Any]:
    """Write the logs and the proof jumps as Parquet files; return the truth with the SHA-256 of each file."""
    hashes = {}
    for key, folder, jumps in (("logs", logs, withheld.logs), ("proof", proof, withheld.proof)):
        for jump in jumps:
            jump_log.write_log(jump, folder / f"{jump.name}.parquet")
        hashes[key] = {f"{jump.name}.parquet": sha256(folder / f"{jump.name}.parquet") for jump in jumps}
    return {**withheld.truth, **hashes}


def published_case(jumps: Sequence[Log], salt_seed: int) -> WithheldCase:
    """A case of published jumps: every other one is diagnosed, and the realised closure is measured on the rest."""
    salt = hashlib.sha256(f"{salt_seed}".encode()).hexdigest()[:32]
    nothing_known = {"effects": [], "detectable": False, "where": [], "change": None}
    truth = {"salt": salt, "half": "published", "kind": "published", **nothing_known}
    return WithheldCase(tuple(jumps[::2]), tuple(jumps[1::2]), truth)


def further_jumps(
    truth: Mapping[str, Any],
    references: Sequence[Log],
    block_height_m: tuple[float, float],
    robot: Robot,
    setup: CaseSetup,
) -> list[Log]:
    """Generate further jumps of a case's robot, with its effects and nuisances: one jump for each reference."""
    rng = np.random.default_rng([truth["seed"], 1])
    heights = rng.uniform(*block_height_m, len(references))
    plans = [
        MotionPlan(f"next_{i}", r, round(float(h), 4)) for i, (r, h) in enumerate(zip(references, heights, strict=True))
    ]
    return further_logs(truth, plans, robot, setup, rng)


def further_logs(
    truth: Mapping[str, Any], plans: Sequence[MotionPlan], robot: Robot, setup: CaseSetup, rng: np.random.Generator
) -> list[Log]:
    """Generate further logs of a case's robot, with its effects and nuisances: one for each plan."""
    seed, physics = truth["seed"], setup.physics_of_case(truth.get("physics", USUAL.name))
    nuisance = Nuisance(seed=int(np.random.default_rng(seed).integers(2**31)), sizes=setup.nuisances, physics=physics)
    clock = truth.get("clock")
    family_of_rows = clock and ClockFamily(clock["family"], clock["sizes"])
    acting = [effect_from_json(entry) for entry in truth["effects"][1 if clock else 0 :]]
    scatter = 1 + setup.period_scatter * rng.standard_normal(len(plans))
    own: list[Effects] = [(nuisance, *(scatter_effect(e, s, robot) for e in acting)) for s in scatter]
    slots = 1 + max((len(plan.reference.info.terrain) for plan in plans), default=0)
    generator = Generator(robot, terrain_slots=slots, step_s=physics.step_s or setup.step_s)
    timing = family_of_rows, (seed, 1, CLOCK_SEED)
    return [jump.log for jump in generate_jumps(plans, own, generator, setup.noise, setup.course, rng, *timing)]


def proposed_logs(
    truth: Mapping[str, Any], proposal: Mapping[str, Any], logs: Sequence[Log], robot: Robot, setup: CaseSetup
) -> list[Log]:
    """Logs of the experiment that a report on some logs proposes, by the robot of a withheld case."""
    given = Given(JudgedLogs.of(logs, robot).logs, robot)
    plans = [MotionPlan(plan.name, plan) for plan in plans_of(proposal, given)]
    return further_logs(truth, plans, robot, setup, np.random.default_rng([truth["seed"], 1]))


def true_localisation(
    logs: Sequence[Log], off: Sequence[Rollout], judged: JudgedLogs, generator: Generator, horizon_s: float
) -> list[dict[str, Any]]:
    """Phases and channels with their share of the squared difference, largest first, without shares below 0.001.

    ``off`` are rollouts of the noise-free jumps without the effect. They restart every ``horizon_s`` from the
    noise-free state, as the diagnosis restarts from the log. Only the second half of each piece counts, in units of
    each channel's noise.
    """
    robot, channels, names = generator.robot, judged.mapped, phase_names(logs)
    square = np.zeros((len(names), len(channels)))
    for log, trial, rows in zip(logs, off, judged.rows, strict=True):
        measured = motion_of(log.first_rows(rows), robot)
        noise = sensor_noise(measured, log.info.sample_period_s, channels, robot)
        scale = np.maximum(noise, [least_noise(c) for c in channels])
        pieces = pieces_of(trial.log.first_rows(rows), names, horizon_s)
        motions = generator.motions([replace(trial, log=piece) for piece, *_ in pieces])
        for (piece, phases, _), motion in zip(pieces, motions, strict=True):
            half = len(piece) // 2
            error = channel_errors(motion, motion_of(piece, robot), channels, robot)
            for phase in np.unique(phases[half:]):
                square[phase] += ((error[half:][phases[half:] == phase] / scale) ** 2).sum(axis=0)
    share = square / max(square.sum(), 1e-300)
    fields: list[dict[str, Any]] = [
        {"phase": names[p], "channel": c.name, "share": round(float(share[p, k]), 5)}
        for p in range(len(names))
        for k, c in enumerate(channels)
    ]
    return sorted((f for f in fields if f["share"] >= 0.001), key=lambda f: -f["share"])
