"""The headline gap of replays: of the nominal robot, of noise alone, and of candidates with effects on held-out logs.

The share of it above its noise floor that is closed has an interval over resampled logs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.channels import channel_errors
from leapgap.diagnosis.horizons import (
    HorizonError,
    RestartedReplayer,
    gap_of,
    horizons_of,
    longest_informative,
    replayer_at,
    unmoved_errors,
)
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

LEAST_ABOVE = 0.05  # Smallest gap above the noise floor, as a share of the floor, of which a reduction can be stated
SIGMAS = 1.96  # Half width of a 95 % interval in standard deviations
DIVERGED_ERROR = 100.0  # Error assigned to diverged (non-finite) rollouts, and the bound of all scaled errors
EXACT = 0.25  # Share of the own steps' length by which replays are nearly exact
STABLE = 0.7
"""A horizon is stable where a right answer would close this share of the gap, by the noise of its own replays."""


def noise_floor(
    judged: JudgedLogs,
    replayer: Replayer | RestartedReplayer,
    draws: int,
    rng: np.random.Generator,
    motions: Sequence[Motion] | None = None,
    effects: Sequence[tuple[Effect, ...]] | None = None,
) -> np.ndarray:
    """Mean sum of squares that sensor noise alone gives for each log, (logs,), summed over rows and channels.

    The motion of the nominal robot, or of one with ``effects`` on each log, plus noise of each channel is taken as
    measured, and replayed from its noisy first row, or rows where the replayer restarts. ``motions`` are those of that
    robot, where they are known already.
    """
    total, restarted = np.zeros(len(judged.logs)), isinstance(replayer, RestartedReplayer)
    of_rows = judged.noise_in(judged.channels)
    trials = judged.trials(effects)
    motions = motions or replayer.motions(trials)
    true = [motion[:rows] for motion, rows in zip(motions, judged.rows, strict=True)]
    for _ in range(draws):
        for j, motion in enumerate(noisy_replays(judged, replayer, trials, rng)):
            error = channel_errors(motion, true[j], judged.channels, judged.robot)
            of_draw = rng.standard_normal(error.shape if restarted else error.T.shape)
            error -= (of_draw if restarted else of_draw.T) * of_rows[j]
            total[j] += sum(float((column**2).sum()) for column in (error / judged.scales).T)
    return total / draws


def noisy_replays(
    judged: JudgedLogs, replayer: Replayer | RestartedReplayer, trials: Sequence[Rollout], rng: np.random.Generator
) -> list[Motion]:
    """Replays of the judged rows from starts with noise."""
    if isinstance(replayer, Replayer):
        starts = [replayer.first_state(trial) for trial in trials]
        noisy = [start + rng.standard_normal(len(start)) * judged.start_noise(log) for log, start in enumerate(starts)]
        return replayer.motions([replace(trial, first_state=state) for trial, state in zip(trials, noisy, strict=True)])
    of_state = [channel for channel in judged.mapped if channel.is_state]
    steps, entries = [], [channel.entry for channel in of_state]
    for states, sigma, trial in zip(judged.states, judged.noise_in(of_state), trials, strict=True):
        pieces, share = replayer.starts(trial)
        by = states.deviation[list(pieces.rows)]
        by[:, entries] = sigma * share[:, None]
        steps.append(by * rng.standard_normal(by.shape))
    return replayer.motions(trials, steps)


@dataclass(frozen=True)
class Interval:
    """A value with its 95 % interval over resampled logs."""

    value: float
    low: float
    high: float

    @property
    def capped_at_one(self) -> "Interval":
        """The interval of a share, clipped to at most 1, with the value inside: the form for texts.

        A corrected gap may be below the noise floor by chance, which gives a share above 1.
        """
        value = min(self.value, 1.0)
        return Interval(value, min(self.low, value), max(min(self.high, 1.0), value))

    def to_json(self) -> dict[str, Any]:
        """A share of the gap in the form of ``report.json``."""
        return {"heldout": self.value, "ci95": [self.low, self.high]}


def above_noise(gap: float, floor: float) -> bool:
    """Whether a headline gap is above its noise floor."""
    return gap - floor > LEAST_ABOVE * floor


def resamples(logs: int, draws: int, rng: np.random.Generator) -> np.ndarray:
    """Bootstrap resamples of logs: indices (draws, logs)."""
    return rng.integers(0, logs, size=(draws, logs))


def closure(
    nominal: np.ndarray,
    corrected: np.ndarray,
    floor: np.ndarray,
    counts: np.ndarray,
    draws: Sequence[np.ndarray] | np.ndarray,
    of_nominal: np.ndarray | None = None,
) -> Interval:
    """Share of the headline gap above its noise floor that is closed; 0 where the gap is not above that floor.

    Arguments are sums of squares (logs,) and the ``counts`` of their values, those ``of_nominal`` where they differ.
    """
    first = counts if of_nominal is None else of_nominal

    def of(chosen: np.ndarray) -> float:
        sums = ((nominal, first), (corrected, counts), (floor, counts))
        before, after, least = (np.sqrt(s[chosen].sum() / number[chosen].sum()) for s, number in sums)
        return float((before - after) / (before - least)) if above_noise(before, least) else 0.0

    sample = [of(chosen) for chosen in draws]
    return Interval(of(np.arange(len(counts))), float(np.percentile(sample, 2.5)), float(np.percentile(sample, 97.5)))


def scaled_errors(
    judged: JudgedLogs, replayer: Replayer | RestartedReplayer, candidates: Sequence[Sequence[tuple[Effect, ...]]]
) -> list[list[np.ndarray]]:
    """Simulated − measured, scaled, of every candidate on every log: ``[candidate][log]`` (rows, channels).

    ``candidates[c][j]`` are the effects of candidate c on log j; all of them roll out as one batch.
    """
    trials = [trial for of_candidate in candidates for trial in judged.trials(of_candidate)]
    motions = iter(replayer.motions(trials))
    return [[scaled_error(next(motions), judged, log) for log in range(len(judged.logs))] for _ in candidates]


def scaled_error(motion: Motion, judged: JudgedLogs, log: int) -> np.ndarray:
    """Simulated − measured, scaled, in the judged rows of a log, (rows, channels); ``motion`` may go on longer."""
    measured = judged.motions[log]
    error = channel_errors(motion[: len(measured)], measured, judged.channels, judged.robot) / judged.scales
    bounded = np.clip(np.nan_to_num(error, nan=DIVERGED_ERROR), -DIVERGED_ERROR, DIVERGED_ERROR)
    return bounded * np.sqrt(judged.row_weights[log]) if judged.row_weights else bounded


def motion_squares(motions: Sequence[Motion], judged: JudgedLogs) -> np.ndarray:
    """Sum of squared scaled errors of one motion for each log, (logs,)."""
    errors = (scaled_error(motion, judged, log) for log, motion in enumerate(motions))
    return np.array([float((error**2).sum()) for error in errors])


def candidate_squares(
    judged: JudgedLogs, replayer: Replayer | RestartedReplayer, candidates: Sequence[Sequence[tuple[Effect, ...]]]
) -> np.ndarray:
    """Sum of squared scaled errors of each candidate on each log, (candidates, logs)."""
    return np.array([[float((e**2).sum()) for e in of_logs] for of_logs in scaled_errors(judged, replayer, candidates)])


def gap_of_motions(motions: Sequence[Motion], judged: JudgedLogs) -> float:
    """The headline gap of one motion for each log."""
    return gap_of([scaled_error(motion, judged, log) for log, motion in enumerate(motions)])


def headline_gap(sum_of_squares: np.ndarray, judged: JudgedLogs) -> float:
    """The headline gap: root mean square over rows, channels and logs."""
    return float(np.sqrt(sum_of_squares.sum() / judged.value_counts.sum()))


def final_position_errors(motions: Sequence[Motion], judged: JudgedLogs) -> list[float]:
    """Error of the trunk's x in the last judged row of each replay, m; nothing where it is not judged."""
    if all(channel.name != "base_pos_x" for channel in judged.channels):
        return []
    return [
        float(motion.qpos[rows - 1, 0] - log["base_pos_x"][rows - 1])
        for motion, log, rows in zip(motions, judged.logs, judged.rows, strict=True)
    ]


def folds_of(logs: int, folds: int) -> np.ndarray:
    """Which fold each log is held out with, (logs,)."""
    if logs < 2:
        expected = "two or more: a cause is judged on logs it was not fitted on"
        raise InputError("logs", f"{logs} log", expected, "log another motion")
    return np.arange(logs) % min(folds, logs)


@dataclass(frozen=True)
class HeldOutFigures:
    """What a candidate makes of the headline gap on held-out logs."""

    squares: np.ndarray  # Sums of squares, (logs,)
    gap: float
    closure: Interval


@dataclass(frozen=True)
class HeldOutGap:
    """The headline gap of candidates on held-out logs, in replays of whole logs; each candidate is replayed once."""

    judged: JudgedLogs
    replayer: Replayer | RestartedReplayer  # Of whole logs, or of pieces of the horizon that is judged
    folds: np.ndarray  # Index of the fold of each log, (logs,)
    nominal: np.ndarray  # Sums of squares of the nominal robot, (logs,)
    floor: np.ndarray  # Sums of squares of noise alone, (logs,)
    draws: np.ndarray  # Bootstrap resamples of logs, (draws, logs)
    nominal_motions: Sequence[Motion] = ()  # Their replays by the nominal robot
    horizons: Sequence[HorizonError] = ()  # The nominal robot's gap at several horizons
    claimed: "HeldOutGap | None" = None
    """The same of the logs as they claim to be, where they are judged by their own clock."""
    cache: dict[int, tuple[Candidate, np.ndarray]] = field(default_factory=dict)
    """Sums of squares by identity of the candidate, whose arrays cannot be hashed."""
    motions: dict[int, Sequence[Motion]] = field(default_factory=dict)
    """Replays of all rows, by identity of the candidate."""

    @staticmethod
    def of(
        judged: JudgedLogs,
        base: Replayer,
        folds: int,
        noise_draws: int,
        draws: int,
        rng: np.random.Generator,
    ) -> "HeldOutGap":
        """Replay the logs by the nominal robot, and measure the gap and its noise floor.

        The gap of jumps is that of whole logs; of other motions, at the longest horizon that is informative.
        """
        fold_of_log = folds_of(len(judged.logs), folds)
        trials = judged.whole_trials()
        at_horizons = [(horizon, replayer_at(base, horizon).motions(trials)) for horizon in horizons_of(judged)]
        gaps = []
        for horizon, motions in at_horizons:
            own = gap_of_motions(motions, judged)
            gaps.append(HorizonError(horizon, own, own, gap_of(unmoved_errors(judged, horizon))))
        chosen = longest_informative(gaps)
        motions, replayer = at_horizons[gaps.index(chosen)][1], replayer_at(base, chosen.horizon_s)
        nominal = motion_squares(motions, judged)
        floor = noise_floor(judged, replayer, noise_draws, rng, motions)
        resampled = resamples(len(judged.logs), draws, rng)
        return HeldOutGap(judged, replayer, fold_of_log, nominal, floor, resampled, motions, gaps)

    def by_own_clock(self, judged: JudgedLogs, noise_draws: int, rng: np.random.Generator) -> "HeldOutGap":
        """The same logs by their own clock; what it makes of the gap is closed by whatever is judged from here on."""
        motions = self.replayer.motions(judged.whole_trials())
        floor = noise_floor(judged, self.replayer, noise_draws, rng, motions)
        return self._replayed(judged, self.replayer, motions, floor=floor, claimed=self)

    def _replayed(
        self, judged: JudgedLogs, replayer: Replayer | RestartedReplayer, motions: Sequence[Motion], **further: Any
    ) -> "HeldOutGap":
        """The same by other replays of the nominal robot."""
        nominal = motion_squares(motions, judged)
        told = {"judged": judged, "replayer": replayer, "nominal": nominal, "nominal_motions": motions, **further}
        return replace(self, cache={}, motions={}, **told)

    @property
    def before(self) -> np.ndarray:
        """Sums of squares, (logs,), of the simulation as it was given: nominal robot, claimed clock."""
        return self.nominal if self.claimed is None else self.claimed.nominal

    def at_stable_horizon(self, answer: Candidate, noise_draws: int, rng: np.random.Generator) -> "HeldOutGap":
        """The same at the longest horizon, up to this one, at which a right answer would show to be right.

        Noise of the start alone may send a corrected robot into another limit cycle, so that a replay over a long time
        is far from the log however right the correction is. The floor of the robot with ``answer`` says what gap a
        right one leaves. Where no horizon is stable, the one at which it closes most is taken.
        """
        shorter = [gap.horizon_s for gap in self.horizons]
        if not answer.hypotheses or not self.has_gap or len(shorter) == 1:
            return self
        effects, best, most = self.effects_on_logs([answer])[0], self, -np.inf
        for horizon_s in shorter[shorter.index(self.horizon_s) :]:
            at = self if horizon_s == self.horizon_s else self.at(horizon_s, noise_draws, rng)
            floor = noise_floor(at.judged, at.replayer, noise_draws, rng, effects=effects)
            closes = at.closure_value(floor) if at.has_gap else -np.inf
            if closes > most:
                best, most = at, closes
            if most >= STABLE:
                break
        return best

    def at(self, horizon_s: float | None, noise_draws: int, rng: np.random.Generator) -> "HeldOutGap":
        """The same at another horizon."""
        replayer = replayer_at(self.base, horizon_s)
        motions = replayer.motions(self.judged.whole_trials())
        floor = noise_floor(self.judged, replayer, noise_draws, rng, motions)
        claimed = self.claimed and self.claimed.at(horizon_s, noise_draws, rng)
        return self._replayed(self.judged, replayer, motions, floor=floor, claimed=claimed)

    @property
    def names(self) -> list[str]:
        """Names of the logs."""
        return [log.name for log in self.judged.logs]

    def effects_on_logs(self, candidates: Sequence[Candidate]) -> list[list[tuple[Effect, ...]]]:
        """Effects ``[candidate][log]``, each log with the numbers fitted without its fold."""
        return [
            [candidate.effects_on(log, fold) for log, fold in zip(self.names, self.folds.tolist(), strict=True)]
            for candidate in candidates
        ]

    def replays(self, candidates: Sequence[Candidate]) -> list[Sequence[Motion]]:
        """Replays of all rows by several candidates, each log with the numbers fitted without its fold."""
        new = list({id(c): c for c in candidates if id(c) not in self.motions and c.hypotheses}.values())
        trials = [
            trial
            for effects in self.effects_on_logs(new)
            for trial in self.judged.whole_trials(
                [
                    tuple(effect.extend_to(rows, len(states.log)) for effect in own)
                    for own, rows, states in zip(effects, self.judged.rows, self.judged.whole, strict=True)
                ]
            )
        ]
        found = iter(self.replayer.motions(trials))
        for candidate in new:
            motions = [next(found) for _ in self.names]
            self.motions[id(candidate)] = motions
            self.cache[id(candidate)] = candidate, motion_squares(motions, self.judged)
        return [
            self.motions[id(candidate)] if candidate.hypotheses else self.nominal_motions for candidate in candidates
        ]

    def squares(self, candidates: Sequence[Candidate]) -> list[np.ndarray]:
        """Sums of squares (logs,) on held-out logs; candidates that are not in the cache are replayed as one batch."""
        new = list({id(c): c for c in candidates if id(c) not in self.cache and c.hypotheses}.values())
        for candidate, found in zip(new, self.squares_with(self.effects_on_logs(new)), strict=True):
            self.cache[id(candidate)] = candidate, found
        return [self.cache[id(candidate)][1] if candidate.hypotheses else self.nominal for candidate in candidates]

    def squares_with(self, effect_sets: Sequence[Sequence[tuple[Effect, ...]]]) -> np.ndarray:
        """Sums of squares with effects ``[set][log]``, (sets, logs)."""
        return candidate_squares(self.judged, self.replayer, effect_sets)

    def shared_closure(self, candidate: Candidate) -> Interval:
        """Closure where each log gets the median of the values of other folds instead of its own."""
        if not any(hypothesis.per_log for hypothesis in candidate.hypotheses):
            return self.closure(*self.squares([candidate]))
        effects = []
        for fold in self.folds.tolist():
            others = [log for log, own in zip(self.names, self.folds, strict=True) if own != fold]
            effects.append(candidate.typical_effects(others, fold))
        return self.closure(self.squares_with([effects])[0])

    def figures(self, candidates: Sequence[Candidate]) -> list[HeldOutFigures]:
        """Gap and closure of several candidates on held-out logs."""
        return [HeldOutFigures(s, self.gap(s), self.closure(s)) for s in self.squares(candidates)]

    def closure(self, corrected: np.ndarray) -> Interval:
        """Share of the gap that is closed where sums of squares (logs,) remain, with its interval."""
        return closure(self.before, corrected, self.floor, self.judged.value_counts, self.draws)

    def closure_value(self, corrected: np.ndarray) -> float:
        """Share of the gap that is closed, without an interval."""
        return closure(self.before, corrected, self.floor, self.judged.value_counts, self.draws[:1]).value

    def errors_at_horizons(self, candidate: Candidate) -> tuple[HorizonError, ...]:
        """The nominal gap at each horizon, and that of a candidate on held-out logs."""
        if not candidate.hypotheses:
            return tuple(self.horizons)
        trials, found = self.judged.trials(*self.effects_on_logs([candidate])), []
        for one in self.horizons:
            if one.horizon_s == self.horizon_s:
                own = self.gap(*self.squares([candidate]))
            else:
                own = gap_of_motions(replayer_at(self.base, one.horizon_s).motions(trials), self.judged)
            found.append(replace(one, corrected=own))
        return tuple(found)

    @property
    def horizon_s(self) -> float | None:
        """The horizon that is judged; None: whole logs."""
        return self.replayer.horizon_s if isinstance(self.replayer, RestartedReplayer) else None

    @property
    def unmoved(self) -> float:
        """Headline gap of a robot that does not move, at this horizon."""
        return next(one.unmoved for one in self.horizons if one.horizon_s == self.horizon_s)

    @property
    def has_gap(self) -> bool:
        """Whether replays of whole logs have a gap above noise."""
        return above_noise(self.gap(self.before), self.gap(self.floor))

    @cached_property
    def of_steps(self) -> float:
        """Headline gap that the steps of the simulation make: of their error, steps of half the length leave half."""
        motions = self._replayer_of_steps(0.5).motions(self.judged.whole_trials())
        pairs = enumerate(zip(motions, self.nominal_motions, strict=True))
        errors = [scaled_error(a, self.judged, log) - scaled_error(b, self.judged, log) for log, (a, b) in pairs]
        return 2 * gap_of(errors)

    @property
    def by_exact_steps(self) -> "HeldOutGap":
        """The same by short steps, where the own ones may make all of the gap, as under feet that slip."""
        if above_noise(self.gap(self.before), float(np.hypot(self.gap(self.floor), self.of_steps))):
            return self
        replayer = self._replayer_of_steps(EXACT)
        return self._replayed(self.judged, replayer, replayer.motions(self.judged.whole_trials()))

    def _replayer_of_steps(self, share: float) -> Replayer | RestartedReplayer:
        """The replayer by steps of a share of the own ones' length."""
        return replayer_at(self.base.with_steps(share * self.base.largest_step_s), self.horizon_s)

    @property
    def base(self) -> Replayer:
        """The replayer of whole logs."""
        return self.replayer.replayer if isinstance(self.replayer, RestartedReplayer) else self.replayer

    def gap(self, corrected: np.ndarray) -> float:
        """Headline gap from sums of squares (logs,)."""
        return headline_gap(corrected, self.judged)

    def gap_by_log(self, corrected: np.ndarray) -> dict[str, dict[str, float]]:
        """Headline gap of each log, nominal and corrected."""
        both = np.sqrt(np.stack([self.before, corrected]) / self.judged.value_counts)
        return {n: {"nominal": float(a), "corrected": float(b)} for n, a, b in zip(self.names, *both, strict=True)}

    def misplaced_by_log(self, corrected: Sequence[Motion]) -> dict[str, dict[str, float]]:
        """Error of the trunk's x in the last judged row of each log, m, nominal and corrected; empty without a base."""
        given = self.claimed or self
        before = final_position_errors(given.nominal_motions, given.judged)
        after = final_position_errors(corrected, self.judged)
        of_logs = zip(self.names, before, after, strict=False)
        return {log: {"nominal": nominal, "corrected": own} for log, nominal, own in of_logs}

    def share_better(self, squares: np.ndarray, others: np.ndarray) -> float:
        """Share of the resamples of logs in which sums of squares (logs,) are smaller than others."""
        return float((others[self.draws].sum(axis=1) > squares[self.draws].sum(axis=1)).mean())
