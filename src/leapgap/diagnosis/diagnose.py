"""The diagnosis from end to end: logs and a robot in, a report out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from leapgap import effects
from leapgap.diagnosis.candidates import SearchResult
from leapgap.diagnosis.checks import CheckResult, run_checks
from leapgap.diagnosis.checks.clocks import local_clocks
from leapgap.diagnosis.decision import Conclusion, DecisionThresholds, best_set_shares, decide, drop_contradicted_causes
from leapgap.diagnosis.full_rollouts import FullRollouts, FullRolloutSettings
from leapgap.diagnosis.gap import JudgedLogs, final_position_errors, motion_squares, noise_floor
from leapgap.diagnosis.gap_reduction import HeldOutGap, HeldOutReplays, resamples
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.localisation import localise
from leapgap.diagnosis.provenance import Provenance
from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.selection import SearchSettings, find_causes
from leapgap.diagnosis.sensitivities import FINE_STEP_S
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.diagnosis.summary import (
    causes_of,
    next_experiment,
    not_judged,
    profiles_of,
    sentence,
    shared_closure,
    typical,
)
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer, Rollout

TOLERANCES = {
    "armature.inertia": 0.05,
    "joint_friction.torque_nm": 0.05,
    "joint_damping.damping": 0.10,
    "foot_friction.mu": 0.02,
    "foot_compliance.time_constant_s": 0.03,
    "leg_mass.scale": 0.005,
    "com_offset.x_m": 0.0005,
    "com_offset.z_m": 0.0005,
    "payload.mass_kg": 0.005,
    "trunk_inertia.scale": 0.005,
}
"""Tolerances of a robot's model: standard deviations as shares of its own numbers, offsets in m."""


@dataclass(frozen=True)
class Settings:
    """Settings of a diagnosis: effects to look for, evidence, search and thresholds."""

    effects: list[str] = field(default_factory=list)
    """Names of the hypotheses; empty: all known effects."""
    folds: int = 4
    """Parts of the logs; each log is judged with values fitted on the other parts."""
    horizon_s: float = 0.1
    """Length of a piece: replays restart from the log after this time."""
    every_s: float = 0.01
    """Replays are compared with the log at this interval."""
    pieces_per_log: int = 8
    """Number of pieces that are replayed of each log, if that is fewer than ``most_pieces`` in all."""
    most_pieces: int = 48
    """Largest number of pieces that are replayed of all logs together."""
    plan: SearchSettings = field(default_factory=SearchSettings)
    doubts: DecisionThresholds = field(default_factory=DecisionThresholds)
    tolerances: dict[str, float] = field(default_factory=lambda: dict(TOLERANCES))
    """``effect.parameter`` → standard deviation of that number of the model, in units of the model's own value
    (``Parameter.scale``): a share of its armature, friction or mass; m where the model has no such number."""
    model_error: float = 0.03
    """Relative error of a departure from nominal because the simulation differs from the robot."""
    where_horizon_s: float = 0.1
    clock_threshold: float = 0.02
    even_threshold: float = 0.03
    whole: FullRolloutSettings = field(default_factory=FullRolloutSettings)
    """Settings of the search in full rollouts, used where a confirmed cause leaves most of the gap."""
    fall_threshold: float = 0.08
    planted_threshold_m: float = 0.01
    noise_draws: int = 3
    bootstrap_draws: int = 500
    seed: int = 1

    @property
    def check_thresholds(self) -> dict[str, float]:
        """Thresholds of the consistency checks by name."""
        return {
            "joint_clock": self.clock_threshold,
            "base_clock": self.clock_threshold,
            "even_clock": self.even_threshold,
            "free_fall": self.fall_threshold,
            "planted_feet": self.planted_threshold_m,
        }


@dataclass(frozen=True)
class Diagnosis:
    """A report with the replays made for it."""

    report: ReportContent
    nominal: Mapping[str, Motion]
    """Replay of each log by the nominal robot, all rows."""
    corrected: Mapping[str, Motion]
    """Replay of each log with the answer as fitted without it."""
    correction: tuple[Effect, ...]
    """The answer fitted on all logs; the median where values differ by log."""


def diagnose(
    jumps: Sequence[Log],
    robot: Robot,
    settings: Settings,
    provenance: Provenance | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
    own: Sequence[type[Effect]] = (),
) -> Diagnosis:
    """Find where the gap lies, which effects cause it, and how far it shrinks on logs not fitted on.

    ``provenance`` says which files the logs were read from; where it is None their content stands for them.
    ``own`` are a user's effect classes, looked for beside the known ones (or those of them that the settings name).
    ``threads`` (all cores, where it is None) change the time it takes and nothing else.
    """
    kinds = chosen_kinds(settings, own)
    check_tolerances(settings, own)
    replayer = Replayer(robot, max(1, *(len(jump.info.terrain) for jump in jumps)) if jumps else 1, threads)
    judged = JudgedLogs.of(jumps, robot)
    progress(f"{len(jumps)} logs, {sum(judged.rows)} rows judged")
    rng = np.random.default_rng(settings.seed)
    nominal = replayer.motions([Rollout(jump) for jump in jumps])
    heldout_gap = heldout_gap_of(judged, replayer, nominal, settings, rng)
    gap, floor = heldout_gap.gap(heldout_gap.nominal), heldout_gap.gap(heldout_gap.floor)
    progress(f"headline gap {gap:.3f}, noise floor {floor:.3f}")
    checks = run_checks(judged.logs, robot, settings.check_thresholds)
    hypotheses = list_hypotheses(kinds, robot, clock_of(checks, judged, robot))
    result = search(heldout_gap, hypotheses, settings, progress)
    heldout = HeldOutReplays(heldout_gap, jumps, nominal)
    heldout.replays(result.steps)
    result = drop_contradicted_causes(
        result, [heldout_gap.closure_value(of) for of in heldout.squares(result.steps)], settings.doubts
    )
    shares = best_set_shares(result, heldout_gap.draws) if result.rivals else np.zeros(0)
    heldout.squares([*result.steps, *result.alternatives])
    conclusion = conclude(result, shares, heldout, hypotheses, settings, progress)
    selected = conclusion.steps[-1] if conclusion.steps else result.nominal
    (replays,) = heldout.replays([selected])
    (corrected,) = heldout.squares([selected])
    closes = heldout_gap.closure(corrected) if conclusion.answer else None
    # Short steps: what the nominal simulation's own step does is no part of the gap.
    places = localise(judged, replayer.with_steps(FINE_STEP_S), settings.where_horizon_s, settings.noise_draws, rng)
    report = ReportContent(
        verdict=conclusion.verdict,
        sentence=sentence(conclusion, selected, gap, heldout_gap.gap(corrected), closes, judged),
        gap_nominal=gap,
        gap_corrected=heldout_gap.gap(corrected),
        noise_floor=floor,
        answer=conclusion.answer,
        closure_of_answer=closes,
        closure_shared=shared_closure(selected, corrected, heldout_gap),
        where=tuple(places),
        causes=tuple(causes_of(result, conclusion, shares, heldout, settings.model_error)),
        checks=tuple(checks),
        next_experiment=next_experiment(conclusion.answer, jumps, robot),
        not_judged=tuple(not_judged(jumps, robot)),
        profiles=tuple(profiles_of(result)),
        gap_per_log=heldout_gap.gap_by_log(corrected),
        landing_misplaced_m=landing(nominal, replays, judged),
        provenance=provenance or Provenance.of(jumps, robot, asdict(settings)),
    )
    logs = [jump.name for jump in jumps]
    return Diagnosis(
        report, dict(zip(logs, nominal, strict=True)), dict(zip(logs, replays, strict=True)), typical(selected, logs)
    )


def heldout_gap_of(
    judged: JudgedLogs, replayer: Replayer, nominal: Sequence[Motion], settings: Settings, rng: np.random.Generator
) -> HeldOutGap:
    """Folds, nominal gap, noise floor and resamples of the logs; ``nominal`` are their replays by the nominal robot."""
    number = len(judged.logs)
    return HeldOutGap(
        judged,
        replayer,
        np.array(folds_of(judged, settings.folds)),
        motion_squares(nominal, judged, replayer.robot),
        noise_floor(judged, replayer, settings.noise_draws, rng, nominal),
        resamples(number, settings.bootstrap_draws, rng),
    )


def conclude(
    result: SearchResult,
    shares: np.ndarray,
    heldout: HeldOutReplays,
    hypotheses: Sequence[Hypothesis],
    settings: Settings,
    progress: Callable[[str], None],
) -> Conclusion:
    """Conclusion from the search; where a confirmed cause does not explain enough, from a search in full rollouts.

    ``shares`` as in ``answer_of``.
    """
    heldout_gap, closes = heldout.heldout_gap, None
    if result.selected.hypotheses and heldout_gap.has_gap:
        closes = heldout_gap.closure_value(*heldout.squares([result.selected]))
        if closes < settings.doubts.enough_closure:
            # The nominal step's own error may hide what a small effect closes.
            finer = heldout_gap.with_steps(FINE_STEP_S)
            closes = max(closes, finer.closure_value(finer.heldout_squares([result.selected])[0]))
    gap = heldout_gap.gap(heldout_gap.nominal) / heldout_gap.gap(heldout_gap.floor)
    conclusion = decide(result, shares, gap, closes, settings.doubts)
    if conclusion.verdict != "unknown" or not is_first_cause_confirmed(result):
        return conclusion
    full_rollouts = FullRollouts(heldout_gap, settings.whole, progress)
    return full_rollouts.conclude(result.before(1), hypotheses, settings.doubts.rival_share)


def landing(whole: Sequence[Motion], replays: Sequence[Motion], judged: JudgedLogs) -> dict[str, dict[str, float]]:
    """Error of the trunk's x at touch-down for each log, m, nominal and corrected; empty for robots without a base."""
    nominal, corrected = final_position_errors(whole, judged), final_position_errors(replays, judged)
    if nominal is None or corrected is None:
        return {}
    of_logs = zip(judged.logs, nominal, corrected, strict=True)
    return {jump.name: {"nominal": before, "corrected": after} for jump, before, after in of_logs}


def folds_of(judged: JudgedLogs, folds: int) -> list[int]:
    """Which fold each log is held out with."""
    number = len(judged.logs)
    if number < 2:
        raise InputError(
            "diagnose.logs",
            f"{number} jump",
            "two or more: a cause is judged on jumps it was not fitted on",
            "log another jump",
        )
    return (np.arange(number) % min(folds, number)).tolist()


def search(
    heldout_gap: HeldOutGap,
    hypotheses: Sequence[Hypothesis],
    settings: Settings,
    progress: Callable[[str], None],
) -> SearchResult:
    """Search for causes in half of the pieces, then in all of them."""
    jumps = heldout_gap.judged.logs
    most = min(settings.most_pieces, settings.pieces_per_log * len(jumps))
    whole, coarse = (
        ShortRollouts.of(jumps, heldout_gap.replayer, settings.horizon_s, settings.every_s, pieces)
        for pieces in (most, (most + 1) // 2)
    )
    return find_causes(whole, coarse, hypotheses, settings.tolerances, heldout_gap.folds, settings.plan, progress)


def chosen_kinds(settings: Settings, own: Sequence[type[Effect]] = ()) -> list[type[Effect]]:
    """The effects to look for, a user's own classes among them; a name that is none is an ``InputError``."""
    kinds = effects.registry(own)
    unknown = [name for name in settings.effects if name not in kinds]
    if unknown:
        expected = f"names among {', '.join(kinds)}"
        raise InputError("diagnose.settings.effects", ", ".join(unknown), expected, "correct the name")
    names = [*settings.effects, *(kind.name for kind in own)] if settings.effects else kinds
    return [kinds[name] for name in dict.fromkeys(names)]


def check_tolerances(settings: Settings, own: Sequence[type[Effect]] = ()) -> None:
    """Raise ``InputError`` for a tolerance that does not name a parameter of an effect."""
    kinds = effects.registry(own)
    for name in settings.tolerances:
        effect, _, parameter = name.partition(".")
        if effect not in kinds or parameter not in kinds[effect].declarations():
            expected = "<effect>.<parameter>, such as armature.inertia"
            raise InputError("diagnose.settings.tolerances", name, expected, "correct the name")


def clock_of(checks: Sequence[CheckResult], judged: JudgedLogs, robot: Robot) -> Mapping[str, tuple[float, ...]] | None:
    """True over claimed period of each log by its joints, where that check failed; several where it changes within.

    The joints are not scored in the headline gap, so this holds on held-out logs too. A log that is too short or too
    still to have a clock keeps the claimed one.
    """
    claimed = {log.name: (1.0,) for log in judged.logs}
    failed = {check.name: check.per_log for check in checks if not check.passed}
    if "even_clock" in failed:
        local = local_clocks(judged.logs, robot) or {}
        return claimed | {log: tuple(clock.tolist()) for log, clock in local.items()}
    if "joint_clock" in failed:
        return claimed | {log: (value,) for log, value in failed["joint_clock"].items()}
    return None


def is_first_cause_confirmed(result: SearchResult) -> bool:
    """Whether the first cause is one that a consistency check of the logs confirms."""
    return bool(result.selected.hypotheses) and result.selected.hypotheses[0].per_log is not None
