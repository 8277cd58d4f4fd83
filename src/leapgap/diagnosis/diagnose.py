"""The diagnosis from end to end: logs and a robot in, a report out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.diagnosis import checks as consistency
from leapgap.diagnosis.attribution import Belief, Fit, Found, Plan, find
from leapgap.diagnosis.channels import BASE_UNITS, is_logged
from leapgap.diagnosis.checks import Check
from leapgap.diagnosis.closure import Interval, Yardstick, effects_on, resamples
from leapgap.diagnosis.evidence import Evidence
from leapgap.diagnosis.gap import Judged, misplaced_at_the_end, noise_floor, squares, where
from leapgap.diagnosis.hypotheses import Hypothesis, hypotheses_of
from leapgap.diagnosis.report import Cause, Estimate, Profile, Report
from leapgap.diagnosis.responses import FINE_STEP_S
from leapgap.diagnosis.verdict import Answer, Conclusion, Doubts, concluded, first_shares, probability
from leapgap.diagnosis.whole_jumps import WholeJumps, WholePlan
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.recording.jump import Jump
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Motion, Replayer, Trial

SIGMAS = 1.96
"""Of a 95 % interval."""
OTHER_DISTANCES_M, LOGGED_ALREADY_M = (0.3, 0.5, 0.7), 0.03
"""Of further jumps that may tell causes apart, unless one as far was logged."""
OTHER_BLOCKS_M, MOST_FURTHER_JUMPS = (0.02, 0.08), 8
NOTICEABLE = 0.05
"""A share of the gap; of a smaller one no percentage is told."""


@dataclass(frozen=True)
class Settings:
    """What a diagnosis looks for and when it is convinced."""

    effects: list[str] = field(default_factory=list)
    """Names of the hypotheses; empty: all known effects."""
    folds: int = 4
    horizon_s: float = 0.1
    """Replays start anew from the log so often,"""
    every_s: float = 0.01
    """and are compared so often."""
    pieces_per_log: int = 8
    most_pieces: int = 96
    plan: Plan = field(default_factory=Plan)
    doubts: Doubts = field(default_factory=Doubts)
    tolerances: dict[str, float] = field(default_factory=dict)
    """``effect.parameter`` → standard deviation of what no description of a robot has exactly."""
    model_error: float = 0.03
    """Of a departure from nominal: what a fit in another simulation than the robot's own is off by."""
    where_horizon_s: float = 0.1
    clock_threshold: float = 0.02
    even_threshold: float = 0.03
    whole: WholePlan = field(default_factory=WholePlan)
    """Of the search in whole jumps, where a confirmed cause leaves most of the gap."""
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
    threads: int | None = None,
) -> Diagnosis:
    """Find where the gap lies, which effects cause it, and how far it shrinks on jumps not fitted on.

    ``threads`` (all cores, where it is None) change the time it takes and nothing else.
    """
    names = known_names(settings)
    replayer = Replayer(robot, max(1, *(len(jump.info.terrain) for jump in jumps)) if jumps else 1, threads)
    judged = Judged.of(jumps, robot)
    progress(f"{len(jumps)} logs, {sum(judged.rows)} rows judged")
    yardstick = yardstick_of(judged, replayer, settings)
    gap, floor = yardstick.gap(yardstick.nominal), yardstick.gap(yardstick.floor)
    progress(f"headline gap {gap:.3f}, noise floor {floor:.3f}")
    checks = run_checks(judged, robot, settings)
    hypotheses = hypotheses_of(names, robot, clock_of(checks, judged, robot))
    found = search(yardstick, hypotheses, settings, progress)
    shares = first_shares(found, yardstick.draws) if found.rivals else np.zeros(0)
    shown = shown_fits(found)
    measured = dict(zip(map(id, shown), yardstick.heldout(shown), strict=True)) | {id(found.nominal): yardstick.nominal}
    said = conclude(found, shares, measured[id(found.believed)], hypotheses, yardstick, settings, progress)
    further = [step for step in said.steps if id(step) not in measured]
    measured |= zip(map(id, further), yardstick.heldout(further), strict=True)
    believed = said.steps[-1] if said.steps else found.nominal
    heldout = measured[id(believed)]
    closes = yardstick.closure(heldout) if said.answer else None
    whole = replayer.motions([Trial(jump) for jump in jumps])
    mended = replayer.motions(
        [Trial(jump, effects_on(believed, jump.name, int(f))) for jump, f in zip(jumps, yardstick.folds, strict=True)]
    )
    report = Report(
        verdict=said.verdict,
        sentence=sentence(said, believed, gap, yardstick.gap(heldout), closes, judged),
        gap_nominal=gap,
        gap_corrected=yardstick.gap(heldout),
        noise_floor=floor,
        answer=said.answer,
        closure_of_answer=closes,
        closure_shared=shared_closure(believed, heldout, yardstick),
        where=tuple(where(judged, replayer, settings.where_horizon_s)),
        causes=tuple(causes_of(found, said, shares, measured, yardstick, settings)),
        checks=tuple(checks),
        next_experiment=next_experiment(said.answer, jumps, robot),
        not_judged=tuple(not_judged(jumps, robot)),
        profiles=tuple(profiles_of(found)),
        gap_per_log=yardstick.gap_by_log(heldout),
        landing_misplaced_m=landing(whole, mended, judged),
        provenance={**provenance, "robot": robot.sha256, "config": asdict(settings)},
    )
    logs = [jump.name for jump in jumps]
    return Diagnosis(
        report, dict(zip(logs, whole, strict=True)), dict(zip(logs, mended, strict=True)), typical(believed, logs)
    )


def yardstick_of(judged: Judged, replayer: Replayer, settings: Settings) -> Yardstick:
    """Folds, nominal gap, noise floor and resamples of the logs."""
    rng = np.random.default_rng(settings.seed)
    number = len(judged.jumps)
    return Yardstick(
        judged,
        replayer,
        np.array(folds_of(judged, settings.folds)),
        squares(judged, replayer, [[()] * number])[0],
        noise_floor(judged, replayer, settings.noise_draws, rng),
        resamples(number, settings.bootstrap_draws, rng),
    )


def conclude(
    found: Found,
    shares: np.ndarray,
    heldout: np.ndarray,
    hypotheses: Sequence[Hypothesis],
    yardstick: Yardstick,
    settings: Settings,
    progress: Callable[[str], None],
) -> Conclusion:
    """What the search allows to say; whole jumps are asked where a cause that logs confirm does not explain enough.

    ``shares`` are those of the rivals, ``heldout`` the squares (jumps,) of what the search believes.
    """
    closes = yardstick.closes(heldout) if found.believed.hypotheses else None
    if closes is not None and closes < settings.doubts.enough_closure:
        # The nominal step's own error may hide what a small effect closes.
        finer = yardstick.with_steps(FINE_STEP_S)
        closes = max(closes, finer.closes(finer.heldout([found.believed])[0]))
    said = concluded(found, shares, closes, settings.doubts)
    if said.verdict != "unknown" or not confirmed(found):
        return said
    whole_jumps = WholeJumps(yardstick, settings.whole, progress)
    return whole_jumps.concluded(found.before(1), hypotheses, settings.doubts.rival_share)


def landing(whole: Sequence[Motion], mended: Sequence[Motion], judged: Judged) -> dict[str, dict[str, float]]:
    """Of each log, how far off the simulated trunk is at touch-down, m; nothing for robots without a base."""
    nominal, corrected = misplaced_at_the_end(whole, judged), misplaced_at_the_end(mended, judged)
    if nominal is None or corrected is None:
        return {}
    of_logs = zip(judged.jumps, nominal, corrected, strict=True)
    return {jump.name: {"nominal": before, "corrected": after} for jump, before, after in of_logs}


def folds_of(judged: Judged, folds: int) -> list[int]:
    """Which fold each jump is held out with."""
    number = len(judged.jumps)
    if number < 2:
        raise InputError(
            "diagnose.logs",
            f"{number} jump",
            "two or more: a cause is judged on jumps it was not fitted on",
            "log another jump",
        )
    return (np.arange(number) % min(folds, number)).tolist()


def search(
    yardstick: Yardstick,
    hypotheses: Sequence[Hypothesis],
    settings: Settings,
    progress: Callable[[str], None],
) -> Found:
    """Look for causes in some of the evidence, then in all of it."""
    jumps = yardstick.judged.jumps
    most = min(settings.most_pieces, settings.pieces_per_log * len(jumps))
    whole, coarse = (
        Evidence.of(jumps, yardstick.replayer, settings.horizon_s, settings.every_s, pieces)
        for pieces in (most, (most + 1) // 2)
    )
    return find(whole, coarse, hypotheses, settings.tolerances, yardstick.folds, settings.plan, progress)


def run_checks(judged: Judged, robot: Robot, settings: Settings) -> list[Check]:
    """The consistency checks that the logs have columns for."""
    found = (
        consistency.joint_clock(judged.jumps, robot, settings.clock_threshold),
        consistency.even_clock(consistency.local_clocks(judged.jumps, robot), settings.even_threshold),
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


def clock_of(checks: Sequence[Check], judged: Judged, robot: Robot) -> Mapping[str, tuple[float, ...]] | None:
    """True over claimed period of each log by its joints, where that check failed; several where it changes within.

    The joints are not scored in the headline gap, so this holds on held-out jumps too.
    """
    failed = {check.name: check.per_log for check in checks if not check.passed}
    if "even_clock" in failed:
        local = consistency.local_clocks(judged.jumps, robot) or {}
        return {log: tuple(clock.tolist()) for log, clock in local.items()}
    if "joint_clock" in failed:
        return {log: (value,) for log, value in failed["joint_clock"].items()}
    return None


def shown_fits(found: Found) -> list[Fit]:
    """Fits whose closure the report tells: the believed ones on the way, and the best of each effect alone."""
    shown = [found.before(k + 1) for k in range(len(found.believed.hypotheses))]
    if found.believed.hypotheses:
        shown[-1] = found.believed
    for fit in found.alternatives:
        if not any(fit is other for other in shown):
            shown.append(fit)
    return shown


def causes_of(
    found: Found,
    said: Conclusion,
    shares: np.ndarray,
    measured: Mapping[int, np.ndarray],
    yardstick: Yardstick,
    settings: Settings,
) -> list[Cause]:
    """The believed causes, then those that could stand in their place, then every effect alone, best first.

    ``measured`` holds the held-out squares of every belief by its identity.
    """

    def told(belief: Belief, which: int, step: Belief, sure: float, rivals: tuple[str, ...]) -> Cause:
        heldout = measured[id(step)]
        closes, gap = yardstick.closure(heldout), yardstick.gap(heldout)
        return cause_of(belief, which, sure, rivals, closes, gap, yardstick.judged, settings.model_error)

    believed = said.steps[-1] if said.steps else found.nominal
    causes = [
        told(believed, k, step, sure, names[1:])
        for k, (names, step, sure) in enumerate(zip(said.answer, said.steps, said.sure, strict=True))
    ]
    known, others = {(cause.effect, cause.location) for cause in causes}, []
    for fit in found.alternatives:
        newest = fit.hypotheses[-1]
        if (newest.name, newest.location) not in known:
            known.add((newest.name, newest.location))
            sure = probability(newest.name, found, shares) if newest.name not in believed.names else 0.0
            others.append(told(fit, len(fit.hypotheses) - 1, fit, sure, ()))
    return causes + sorted(others, key=lambda cause: -cause.probability)


def cause_of(
    fit: Belief,
    which: int,
    sure: float,
    rivals: tuple[str, ...],
    closes: Interval,
    gap: float,
    judged: Judged,
    model_error: float,
) -> Cause:
    """One hypothesis of a fit in words of the report."""
    hypothesis, numbers = fit.hypotheses[which], fit.split()[which]
    spread = fit.split(np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)))[which]
    logs = [jump.name for jump in judged.jumps]
    half = SIGMAS * np.hypot(spread, model_error * np.abs(numbers - hypothesis.nominal))

    def typical_value(of: np.ndarray, name: str) -> float:
        return float(np.median([hypothesis.values(log, hypothesis.clipped(of))[name] for log in logs]))

    parameters = {}
    for p in effects.known()[hypothesis.name].parameters():
        ends = sorted(typical_value(numbers + side * half, p.name) for side in (-1, 1))
        parameters[p.name] = Estimate(
            typical_value(numbers, p.name), (ends[0], ends[1]), p.nominal, p.unit, hypothesis.at_bound(numbers)
        )
    per_log = {} if hypothesis.per_log is None else {log: hypothesis.values(log, numbers) for log in logs}
    return Cause(hypothesis.name, hypothesis.location, sure, parameters, per_log, closes, gap, rivals)


def shared_closure(believed: Belief, heldout: np.ndarray, yardstick: Yardstick) -> Interval | None:
    """Closure of the answer where every jump gets the median of the other folds' values instead of its own."""
    if not believed.hypotheses:
        return None
    if not any(h.per_log for h in believed.hypotheses):
        return yardstick.closure(heldout)
    judged, candidate = yardstick.judged, []
    for fold in yardstick.folds.tolist():
        others = [jump.name for jump, f in zip(judged.jumps, yardstick.folds, strict=True) if f != fold]
        candidate.append(typical(believed, others, fold))
    return yardstick.closure(squares(judged, yardstick.replayer, [candidate])[0])


def confirmed(found: Found) -> bool:
    """Whether the first cause is one that the logs contradict themselves about, whatever else there is."""
    return bool(found.believed.hypotheses) and found.believed.hypotheses[0].per_log is not None


def typical(fit: Belief, logs: Sequence[str], fold: int | None = None) -> tuple[Effect, ...]:
    """The effects of a fit at the median of some logs' values."""
    of_logs = [effects_on(fit, log, fold) for log in logs]
    found = []
    for same in zip(*of_logs, strict=True):
        middle = {name: float(np.median([one.values[name] for one in same])) for name in same[0].values}
        found.append(replace(same[0].changing(()), **middle))
    return tuple(found)


def profiles_of(found: Found) -> list[Profile]:
    """Each effect's valley, with its place and unit."""
    profiles = []
    for valley in found.profiles:
        h, parameter = valley.hypothesis, valley.hypothesis.parameters[0]
        label = f"{parameter.name} ({parameter.unit})" if h.per_log is None else "share of the clocks' own estimate"
        where = "" if h.location == "all" else f" at {h.location}"
        profiles.append(Profile(h.name + where, label, tuple(valley.values.tolist()), tuple(valley.loss.tolist())))
    return profiles


def sentence(
    said: Conclusion,
    believed: Belief,
    nominal: float,
    corrected: float,
    closes: Interval | None,
    judged: Judged,
) -> str:
    """The report in one sentence, with numbers."""
    verdict, answer = said.verdict, said.answer
    if verdict == "none":
        return (
            f"The simulation agrees with the {len(judged.jumps)} jumps within sensor noise and the tolerances of the "
            f"model (gap {nominal:.2f})."
        )
    if not answer or closes is None:
        return (
            f"A gap of {nominal:.2f} remains that no known effect explains on jumps it was not fitted on; the map "
            "below says where it lies."
        )
    parts = [
        f"{effects.describe(h.name)} ({sized(h, numbers, judged)})"
        + (f", which cannot be told apart from {' and '.join(names[1:])}," if names[1:] else "")
        for h, numbers, names in zip(believed.hypotheses, believed.split(), answer, strict=True)
    ]
    if closes.value < NOTICEABLE:
        return (
            f"{' and '.join(parts)} show{'' if len(parts) > 1 else 's'} in replays of short pieces, too small to "
            f"shrink the gap of whole jumps, which stays {nominal:.2f}."
        )
    rest = f"; {100 * (1 - closes.value):.0f} % of the gap has another cause" if closes.value < 0.9 else ""
    return (
        f"{' and '.join(parts)} explain{'' if len(parts) > 1 else 's'} {min(100, 100 * closes.value):.0f} % (95 %: "
        f"{100 * closes.low:.0f} to {100 * closes.high:.0f}) of the gap on jumps not fitted on: it shrinks from "
        f"{nominal:.2f} to {corrected:.2f}{rest}."
    )


def sized(hypothesis: Hypothesis, numbers: np.ndarray, judged: Judged) -> str:
    """``joint_damping at RR: damping 0.4``; the median and range where values differ by log."""
    of_logs = [hypothesis.values(jump.name, numbers) for jump in judged.jumps]
    sizes = []
    for name in of_logs[0]:
        values = [of[name] for of in of_logs]
        by_log = f", {min(values):.3g} to {max(values):.3g} by jump" if hypothesis.per_log else ""
        sizes.append(f"{name} {np.median(values):.3g}{by_log}")
    place = "" if hypothesis.location == "all" else f" at {hypothesis.location}"
    return f"{hypothesis.name}{place}: {', '.join(sizes)}"


def next_experiment(answer: Answer, jumps: Sequence[Jump], robot: Robot) -> dict[str, Any] | None:
    """What would tell apart the first causes that these logs cannot: other jumps than were logged.

    ``collect`` holds settings of ``stages.collect`` that make them on simulated hardware.
    """
    separates = next((list(names) for names in answer if len(names) > 1), None)
    if separates is None:
        return None
    trace = f"These jumps leave the same trace for {' and '.join(separates)}: "
    if not robot.has_free_base:
        sentence = f"{trace}log faster and slower motions, and diagnose all logs together."
        return {"sentence": sentence, "separates": separates}
    logged = np.array([jump.info.target.x_m for jump in jumps])
    far = [x for x in OTHER_DISTANCES_M if np.abs(logged - x).min() > LOGGED_ALREADY_M] or list(OTHER_DISTANCES_M)
    number = max(len(far), min(2 * len(jumps), MOST_FURTHER_JUMPS))
    low, high = OTHER_BLOCKS_M
    sentence = (
        f"{trace}log {number} further jumps, to {', '.join(f'{100 * x:g}' for x in far)} cm, with the front feet on "
        f"blocks of {100 * low:g} to {100 * high:g} cm, and diagnose all logs together."
    )
    targets = ",".join(f"[{x:g},0.0]" for x in far)
    collect = [f"collect.targets=[{targets}]", f"collect.jumps={number}", f"collect.block_height_m=[{low:g},{high:g}]"]
    return {"sentence": sentence, "separates": separates, "collect": collect}


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
