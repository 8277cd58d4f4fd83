"""The diagnosis from end to end: logs and a robot in, a report out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.diagnosis import checks as consistency
from leapgap.diagnosis.attribution import (
    Belief,
    Fit,
    Hypothesis,
    Interval,
    Search,
    closure,
    first_shares,
    number_interval,
    resamples,
    search_forward,
)
from leapgap.diagnosis.channels import BASE_UNITS, is_logged
from leapgap.diagnosis.checks import Check
from leapgap.diagnosis.gap import Judged, counts, noise_floor, pooled, squares, where
from leapgap.diagnosis.report import Cause, Estimate, Profile, Report
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.recording.jump import Jump
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Motion, Replayer, Trial


@dataclass(frozen=True)
class Settings:
    """What a diagnosis looks for and when it is convinced."""

    effects: list[str] = field(default_factory=list)
    """Names of the hypotheses; empty: all known effects."""
    folds: int = 4
    grid_points: int = 5
    """Values tried between nominal and each bound, before refining."""
    most_causes: int = 2
    least_gain: float = 0.02
    """A further cause must remove this share of the nominal gap on held-out jumps."""
    none_below_floors: float = 1.5
    """A nominal gap of at most this many noise floors is no gap."""
    rival_share: float = 0.1
    """A rival that is best in this share of the resamples cannot be told apart."""
    where_horizon_s: float = 0.1
    clock_threshold: float = 0.02
    fall_threshold: float = 0.08
    planted_threshold_m: float = 0.01
    noise_draws: int = 3
    bootstrap_draws: int = 500
    seed: int = 1


@dataclass(frozen=True)
class Diagnosis:
    """A report with what was simulated for it."""

    report: Report
    nominal: Mapping[str, Motion]
    """Replay of each log by the nominal robot, all rows."""
    corrected: Mapping[str, Motion]
    """Replay of each log with the answer as fitted without it."""
    correction: tuple[Effect, ...]
    """The answer fitted on all logs; the median where values differ by log."""


def diagnose(
    jumps: Sequence[Jump],
    robot: Robot,
    settings: Settings,
    provenance: Mapping[str, Any],
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find where the gap lies, which effects cause it, and how far it shrinks on jumps not fitted on."""
    names = known_names(settings)
    replayer = Replayer(robot, terrain_slots=max(1, *(len(jump.info.terrain) for jump in jumps)) if jumps else 1)
    judged = Judged.of(jumps, robot)
    rng = np.random.default_rng(settings.seed)
    progress(f"{len(jumps)} logs, {sum(judged.rows)} rows judged")
    nominal = squares(judged, replayer, [[()] * len(jumps)])[0]
    floor = noise_floor(judged, replayer, settings.noise_draws, rng)
    progress(f"headline gap {pooled(nominal, judged):.3f}, noise floor {pooled(floor, judged):.3f}")
    places = where(judged, replayer, settings.where_horizon_s)
    checks = run_checks(judged, robot, settings)
    search = Search(judged, replayer, settings.folds, settings.grid_points, progress=progress)
    hypotheses = hypotheses_of(names, checks)
    belief, rounds = search_forward(search, hypotheses, nominal, settings.least_gain, settings.most_causes)
    draws = resamples(len(jumps), settings.bootstrap_draws, rng)
    verdict, answer = judge(belief, rounds, nominal, floor, judged, draws, settings)
    if not answer:  # nothing is believed where nothing is answered
        belief = Belief()
    heldout = belief.fits[-1].heldout if belief.fits else nominal
    closes = closure(nominal, heldout, floor, judged, draws) if belief.fits else None
    shared = shared_closure(search, belief, nominal, floor, draws)
    causes = tuple(causes_of(rounds, belief, nominal, floor, judged, draws, settings))
    folds = {jump.name: int(f) for jump, f in zip(jumps, search.fold_of, strict=True)}
    whole = replayer.motions([Trial(jump) for jump in jumps])
    mended = replayer.motions([Trial(jump, belief.effects(jump.name, folds[jump.name])) for jump in jumps])
    numbers = counts(judged)
    report = Report(
        verdict=verdict,
        sentence=sentence(verdict, answer, belief, pooled(nominal, judged), pooled(heldout, judged), closes, judged),
        gap_nominal=pooled(nominal, judged),
        gap_corrected=pooled(heldout, judged),
        noise_floor=pooled(floor, judged),
        answer=answer,
        closure_of_answer=closes,
        closure_shared=shared,
        where=tuple(places),
        causes=causes,
        checks=tuple(checks),
        next_experiment=next_experiment(answer),
        not_judged=tuple(not_judged(jumps, robot)),
        profiles=tuple(profile(fit, judged) for fit in rounds[0]),
        gap_per_log={
            jump.name: {"nominal": float(np.sqrt(a / n)), "corrected": float(np.sqrt(b / n))}
            for jump, a, b, n in zip(jumps, nominal, heldout, numbers, strict=True)
        },
        provenance={**provenance, "robot": robot.sha256, "config": asdict(settings)},
    )
    logs = [jump.name for jump in jumps]
    correction = tuple(typical(fit, logs) for fit in belief.fits)
    return Diagnosis(report, dict(zip(logs, whole, strict=True)), dict(zip(logs, mended, strict=True)), correction)


def run_checks(judged: Judged, robot: Robot, settings: Settings) -> list[Check]:
    """The consistency checks that the logs have columns for."""
    found = (
        consistency.joint_clock(judged.jumps, robot, settings.clock_threshold),
        consistency.base_clock(judged.jumps, robot, settings.clock_threshold),
        consistency.free_fall(judged.jumps, robot, settings.fall_threshold),
        consistency.planted_feet(judged.jumps, robot, settings.planted_threshold_m),
    )
    return [check for check in found if check is not None]


def known_names(settings: Settings) -> list[str]:
    """The effects to look for; a name that is none is an ``InputError``."""
    unknown = [name for name in settings.effects if name not in effects.known()]
    if unknown:
        expected = f"names among {', '.join(effects.known())}"
        raise InputError("diagnose.settings.effects", ", ".join(unknown), expected, "correct the name")
    return settings.effects or list(effects.known())


def hypotheses_of(names: Sequence[str], checks: Sequence[Check]) -> list[Hypothesis]:
    """One hypothesis for each parameter of each effect; one that differs by log gets its values from the joints' clock.

    The joints are not scored in the headline gap, so this holds on held-out jumps too.
    """
    clock = next((check.per_log for check in checks if check.name == "joint_clock"), None)
    return [
        Hypothesis(
            name, per_log=clock if effects.known()[name].differs_per_log and clock else None, fitted=parameter.name
        )
        for name in names
        for parameter in effects.known()[name].parameters()
    ]


def judge(
    belief: Belief,
    rounds: Sequence[Sequence[Fit]],
    nominal: np.ndarray,
    floor: np.ndarray,
    judged: Judged,
    draws: np.ndarray,
    settings: Settings,
) -> tuple[str, tuple[tuple[str, ...], ...]]:
    """Verdict and answer from held-out errors: each believed cause with the rivals it cannot be told apart from."""
    if pooled(nominal, judged) <= settings.none_below_floors * pooled(floor, judged):
        return "none", ()
    believed = [fit for fit in belief.fits if closure(nominal, fit.heldout, floor, judged, draws).low > 0]
    if not believed:
        return "unknown", ()
    answer = []
    taken = {fit.hypothesis.name for fit in belief.fits}
    for fit, fits in zip(belief.fits, rounds, strict=False):
        shares: dict[str, float] = {}
        for f, share in zip(fits, first_shares(fits, draws), strict=True):
            shares[f.hypothesis.name] = shares.get(f.hypothesis.name, 0.0) + float(share)
        rivals = [name for name, share in shares.items() if name not in taken and share >= settings.rival_share]
        answer.append((fit.hypothesis.name, *sorted(rivals)))
    return ("named" if all(len(names) == 1 for names in answer) else "ambiguous"), tuple(answer)


def causes_of(
    rounds: Sequence[Sequence[Fit]],
    belief: Belief,
    nominal: np.ndarray,
    floor: np.ndarray,
    judged: Judged,
    draws: np.ndarray,
    settings: Settings,
) -> list[Cause]:
    """Every hypothesis, in the round that decided on it: believed ones first, then as single causes."""
    causes = []
    for number, fits in enumerate(rounds):
        shares = first_shares(fits, draws)
        for fit, share in zip(fits, shares, strict=True):
            chosen = number < len(belief.fits) and fit is belief.fits[number]
            if not chosen and (number > 0 or fit.hypothesis.key in (f.hypothesis.key for f in belief.fits)):
                continue
            rivals = tuple(
                other.hypothesis.name
                for other, s in zip(fits, shares, strict=True)
                if other.hypothesis.name != fit.hypothesis.name and chosen and s >= settings.rival_share
            )
            causes.append((not chosen, number, cause_of(fit, float(share), rivals, nominal, floor, judged, draws)))
    return [cause for _, _, cause in sorted(causes, key=lambda c: (c[0], c[1], -c[2].probability, c[2].gap))]


def cause_of(
    fit: Fit,
    probability: float,
    rivals: tuple[str, ...],
    nominal: np.ndarray,
    floor: np.ndarray,
    judged: Judged,
    draws: np.ndarray,
) -> Cause:
    """One fitted hypothesis in words of the report."""
    hypothesis, parameter = fit.hypothesis, fit.hypothesis.parameter
    logs = [jump.name for jump in judged.jumps]
    interval = number_interval(fit, draws)

    def typical_value(number: float) -> float:
        return float(np.median([hypothesis.value(log, number) for log in logs]))

    estimate = Estimate(
        typical_value(interval.value),
        (typical_value(interval.low), typical_value(interval.high)),
        parameter.nominal,
        parameter.unit,
        fit.at_bound,
    )
    per_log = (
        {} if hypothesis.per_log is None else {log: {parameter.name: hypothesis.value(log, fit.number)} for log in logs}
    )
    return Cause(
        hypothesis.name,
        hypothesis.location,
        probability,
        {parameter.name: estimate},
        per_log,
        closure(nominal, fit.heldout, floor, judged, draws),
        pooled(fit.heldout, judged),
        rivals,
    )


def shared_closure(
    search: Search, belief: Belief, nominal: np.ndarray, floor: np.ndarray, draws: np.ndarray
) -> Interval | None:
    """Closure of the answer with one value for all logs, where the answer has values that differ by log."""
    if not any(fit.hypothesis.per_log for fit in belief.fits):
        return closure(nominal, belief.fits[-1].heldout, floor, search.judged, draws) if belief.fits else None
    shared = Belief()
    for fit in belief.fits:
        alone = search.fit(replace(fit.hypothesis, per_log=None), shared)
        shared = Belief((*shared.fits, alone))
    return closure(nominal, shared.fits[-1].heldout, floor, search.judged, draws)


def typical(fit: Fit, logs: Sequence[str]) -> Effect:
    """The effect as fitted on all logs, at the median of the logs' values."""
    values = [fit.hypothesis.value(log, fit.number) for log in logs]
    kind = effects.known()[fit.hypothesis.name]
    return kind(location=fit.hypothesis.location, **{fit.hypothesis.parameter.name: float(np.median(values))})


def profile(fit: Fit, judged: Judged) -> Profile:
    """The headline gap over a hypothesis's fitted number, on all logs."""
    label = (
        f"{fit.hypothesis.parameter.name} ({fit.hypothesis.parameter.unit})"
        if fit.hypothesis.per_log is None
        else "share of the clocks' own estimate"
    )
    gap = np.sqrt(fit.curve.sum(axis=1) / counts(judged).sum())
    return Profile(fit.hypothesis.name, label, tuple(map(float, fit.numbers)), tuple(map(float, gap)))


def sentence(
    verdict: str,
    answer: tuple[tuple[str, ...], ...],
    belief: Belief,
    nominal: float,
    corrected: float,
    closes: Interval | None,
    judged: Judged,
) -> str:
    """The report in one sentence, with numbers."""
    if verdict == "none":
        return f"The simulation agrees with the {len(judged.jumps)} jumps within sensor noise (gap {nominal:.2f})."
    if not belief.fits or closes is None:
        return (
            f"A gap of {nominal:.2f} remains that no known effect explains on jumps it was not fitted on; the map "
            "below says where it lies."
        )
    logs = [jump.name for jump in judged.jumps]
    parts = []
    for fit, names in zip(belief.fits, answer, strict=True):
        parameter = fit.hypothesis.parameter
        values = [fit.hypothesis.value(log, fit.number) for log in logs]
        size = f"{parameter.name} {np.median(values):.3g}" + (
            f", {min(values):.3g} to {max(values):.3g} by jump" if fit.hypothesis.per_log else ""
        )
        rivals = f", which cannot be told apart from {' and '.join(names[1:])}," if names[1:] else ""
        parts.append(f"{effects.describe(fit.hypothesis.name)} ({fit.hypothesis.name}: {size}){rivals}")
    rest = f"; {100 * (1 - closes.value):.0f} % of the gap has another cause" if closes.value < 0.9 else ""
    return (
        f"{' and '.join(parts)} explain{'' if len(parts) > 1 else 's'} {min(100, 100 * closes.value):.0f} % (95 %: "
        f"{100 * closes.low:.0f} to {100 * closes.high:.0f}) of the gap on jumps not fitted on: it shrinks from "
        f"{nominal:.2f} to {corrected:.2f}{rest}."
    )


def next_experiment(answer: tuple[tuple[str, ...], ...]) -> dict[str, Any] | None:
    """What would tell apart the first causes that these logs cannot."""
    for names in answer:
        if len(names) > 1:
            return {
                "sentence": f"These jumps leave the same trace for {' and '.join(names)}: log jumps to other "
                "distances and with other joint gains, and diagnose all logs together.",
                "separates": list(names),
            }
    return None


def not_judged(jumps: Sequence[Jump], robot: Robot) -> list[str]:
    """Columns some log lacks, and what cannot be said without them."""
    wanted = [*BASE_UNITS, *(f"base_angvel_{axis}" for axis in "xz")] if robot.has_free_base else []
    wanted += [f"{quantity}/{robot.joints[0]}" for quantity in ("joint_pos", "joint_vel", "tau")]
    wanted += ["imu_acc_z", "supply_voltage"]
    lacking = [name for name in wanted if not all(is_logged(jump, name) for jump in jumps)]
    meaning = {
        "tau": "the torque the motors delivered",
        "base_angvel_x": "roll rate (taken as zero at the start)",
        "base_angvel_z": "yaw rate (taken as zero at the start)",
        "imu_acc_z": "the IMU's accelerations",
        "supply_voltage": "sag of the supply",
    }
    return [meaning.get(name.split("/")[0], name.split("/")[0]) for name in lacking]
