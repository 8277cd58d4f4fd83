"""The diagnosis from end to end: logs and a robot in, a report out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from leapgap import effects
from leapgap.diagnosis.candidates import Found
from leapgap.diagnosis.checks import CheckResult, run_checks
from leapgap.diagnosis.checks.clocks import local_clocks
from leapgap.diagnosis.decision import Conclusion, DecisionThresholds, concluded, confirmed_by_jumps, first_shares
from leapgap.diagnosis.full_rollouts import FullRollouts, FullRolloutSettings
from leapgap.diagnosis.gap import Judged, misplaced_at_the_end, noise_floor, squares_of
from leapgap.diagnosis.gap_reduction import HeldOutGap, HeldOutReduction, resamples
from leapgap.diagnosis.hypotheses import Hypothesis, hypotheses_of
from leapgap.diagnosis.localisation import where
from leapgap.diagnosis.provenance import Provenance
from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.selection import SearchSettings, find
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
"""How exactly the description of a robot is known: standard deviations as shares of its own numbers, offsets in m."""


@dataclass(frozen=True)
class Settings:
    """What a diagnosis looks for and when it is convinced."""

    effects: list[str] = field(default_factory=list)
    """Names of the hypotheses; empty: all known effects."""
    folds: int = 4
    """Parts of the logs; each log is judged with values fitted on the other parts."""
    horizon_s: float = 0.1
    """Replays start anew from the log so often."""
    every_s: float = 0.01
    """Replays are compared with the log so often."""
    pieces_per_log: int = 8
    """Pieces of each log that are replayed, where the logs are few."""
    most_pieces: int = 48
    """Pieces of all logs together that are replayed."""
    plan: SearchSettings = field(default_factory=SearchSettings)
    doubts: DecisionThresholds = field(default_factory=DecisionThresholds)
    tolerances: dict[str, float] = field(default_factory=lambda: dict(TOLERANCES))
    """``effect.parameter`` → standard deviation of what no description of a robot has exactly, in units of the model's
    own (``Parameter.scale``): a share of its armature, friction or mass; m where the model has no such number."""
    model_error: float = 0.03
    """Of a departure from nominal: what a fit in another simulation than the robot's own is off by."""
    where_horizon_s: float = 0.1
    clock_threshold: float = 0.02
    even_threshold: float = 0.03
    whole: FullRolloutSettings = field(default_factory=FullRolloutSettings)
    """Of the search in whole jumps, where a confirmed cause leaves most of the gap."""
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
    """A report with what was simulated for it."""

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
    """Find where the gap lies, which effects cause it, and how far it shrinks on jumps not fitted on.

    ``provenance`` says which files the logs were read from; where it is None their content stands for them.
    ``own`` are a user's effect classes, looked for beside the known ones (or those of them that the settings name).
    ``threads`` (all cores, where it is None) change the time it takes and nothing else.
    """
    kinds = chosen_kinds(settings, own)
    check_tolerances(settings, own)
    replayer = Replayer(robot, max(1, *(len(jump.info.terrain) for jump in jumps)) if jumps else 1, threads)
    judged = Judged.of(jumps, robot)
    progress(f"{len(jumps)} logs, {sum(judged.rows)} rows judged")
    rng = np.random.default_rng(settings.seed)
    nominal = replayer.motions([Rollout(jump) for jump in jumps])
    yardstick = yardstick_of(judged, replayer, nominal, settings, rng)
    gap, floor = yardstick.gap(yardstick.nominal), yardstick.gap(yardstick.floor)
    progress(f"headline gap {gap:.3f}, noise floor {floor:.3f}")
    checks = run_checks(judged.jumps, robot, settings.check_thresholds)
    hypotheses = hypotheses_of(kinds, robot, clock_of(checks, judged, robot))
    found = search(yardstick, hypotheses, settings, progress)
    heldout = HeldOutReduction(yardstick, jumps, nominal)
    heldout.replays(found.steps)
    found = confirmed_by_jumps(found, [yardstick.closes(of) for of in heldout.of(found.steps)], settings.doubts)
    shares = first_shares(found, yardstick.draws) if found.rivals else np.zeros(0)
    heldout.of([*found.steps, *found.alternatives])
    said = conclude(found, shares, heldout, hypotheses, settings, progress)
    believed = said.steps[-1] if said.steps else found.nominal
    (replays,) = heldout.replays([believed])
    (corrected,) = heldout.of([believed])
    closes = yardstick.closure(corrected) if said.answer else None
    # Short steps: what the nominal simulation's own step does is no part of the gap.
    places = where(judged, replayer.with_steps(FINE_STEP_S), settings.where_horizon_s, settings.noise_draws, rng)
    report = ReportContent(
        verdict=said.verdict,
        sentence=sentence(said, believed, gap, yardstick.gap(corrected), closes, judged),
        gap_nominal=gap,
        gap_corrected=yardstick.gap(corrected),
        noise_floor=floor,
        answer=said.answer,
        closure_of_answer=closes,
        closure_shared=shared_closure(believed, corrected, yardstick),
        where=tuple(places),
        causes=tuple(causes_of(found, said, shares, heldout, settings.model_error)),
        checks=tuple(checks),
        next_experiment=next_experiment(said.answer, jumps, robot),
        not_judged=tuple(not_judged(jumps, robot)),
        profiles=tuple(profiles_of(found)),
        gap_per_log=yardstick.gap_by_log(corrected),
        landing_misplaced_m=landing(nominal, replays, judged),
        provenance=provenance or Provenance.of(jumps, robot, asdict(settings)),
    )
    logs = [jump.name for jump in jumps]
    return Diagnosis(
        report, dict(zip(logs, nominal, strict=True)), dict(zip(logs, replays, strict=True)), typical(believed, logs)
    )


def yardstick_of(
    judged: Judged, replayer: Replayer, nominal: Sequence[Motion], settings: Settings, rng: np.random.Generator
) -> HeldOutGap:
    """Folds, nominal gap, noise floor and resamples of the logs; ``nominal`` are their replays by the nominal robot."""
    number = len(judged.jumps)
    return HeldOutGap(
        judged,
        replayer,
        np.array(folds_of(judged, settings.folds)),
        squares_of(nominal, judged, replayer.robot),
        noise_floor(judged, replayer, settings.noise_draws, rng, nominal),
        resamples(number, settings.bootstrap_draws, rng),
    )


def conclude(
    found: Found,
    shares: np.ndarray,
    heldout: HeldOutReduction,
    hypotheses: Sequence[Hypothesis],
    settings: Settings,
    progress: Callable[[str], None],
) -> Conclusion:
    """What the search allows to say; whole jumps are asked where a cause that logs confirm does not explain enough.

    ``shares`` are those of the rivals.
    """
    yardstick, closes = heldout.yardstick, None
    if found.believed.hypotheses and yardstick.shows:
        closes = yardstick.closes(*heldout.of([found.believed]))
        if closes < settings.doubts.enough_closure:
            # The nominal step's own error may hide what a small effect closes.
            finer = yardstick.with_steps(FINE_STEP_S)
            closes = max(closes, finer.closes(finer.heldout([found.believed])[0]))
    gap = yardstick.gap(yardstick.nominal) / yardstick.gap(yardstick.floor)
    said = concluded(found, shares, gap, closes, settings.doubts)
    if said.verdict != "unknown" or not confirmed(found):
        return said
    whole_jumps = FullRollouts(yardstick, settings.whole, progress)
    return whole_jumps.concluded(found.before(1), hypotheses, settings.doubts.rival_share)


def landing(whole: Sequence[Motion], replays: Sequence[Motion], judged: Judged) -> dict[str, dict[str, float]]:
    """Of each log, how far off the simulated trunk is at touch-down, m; nothing for robots without a base."""
    nominal, corrected = misplaced_at_the_end(whole, judged), misplaced_at_the_end(replays, judged)
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
    yardstick: HeldOutGap,
    hypotheses: Sequence[Hypothesis],
    settings: Settings,
    progress: Callable[[str], None],
) -> Found:
    """Look for causes in some of the evidence, then in all of it."""
    jumps = yardstick.judged.jumps
    most = min(settings.most_pieces, settings.pieces_per_log * len(jumps))
    whole, coarse = (
        ShortRollouts.of(jumps, yardstick.replayer, settings.horizon_s, settings.every_s, pieces)
        for pieces in (most, (most + 1) // 2)
    )
    return find(whole, coarse, hypotheses, settings.tolerances, yardstick.folds, settings.plan, progress)


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
    """A tolerance of something that is no parameter of an effect is an ``InputError``."""
    kinds = effects.registry(own)
    for name in settings.tolerances:
        effect, _, parameter = name.partition(".")
        if effect not in kinds or parameter not in kinds[effect].declared():
            expected = "<effect>.<parameter>, such as armature.inertia"
            raise InputError("diagnose.settings.tolerances", name, expected, "correct the name")


def clock_of(checks: Sequence[CheckResult], judged: Judged, robot: Robot) -> Mapping[str, tuple[float, ...]] | None:
    """True over claimed period of each log by its joints, where that check failed; several where it changes within.

    The joints are not scored in the headline gap, so this holds on held-out jumps too.
    """
    failed = {check.name: check.per_log for check in checks if not check.passed}
    if "even_clock" in failed:
        local = local_clocks(judged.jumps, robot) or {}
        return {log: tuple(clock.tolist()) for log, clock in local.items()}
    if "joint_clock" in failed:
        return {log: (value,) for log, value in failed["joint_clock"].items()}
    return None


def confirmed(found: Found) -> bool:
    """Whether the first cause is one that the logs contradict themselves about, whatever else there is."""
    return bool(found.believed.hypotheses) and found.believed.hypotheses[0].per_log is not None
