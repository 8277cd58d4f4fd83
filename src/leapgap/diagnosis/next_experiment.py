"""The next experiment: the one that would tell apart what these logs cannot, by simulating what each cause foretells.

The answer's robot makes each experiment in simulation. Its logs are cut to the short pieces that a diagnosis fits, and
each rival is replayed in them. A rival may adapt its numbers as far as today's logs leave them open, and the model's
tolerances may move too; what then remains of the difference is what a further diagnosis could see.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.channels import displaced
from leapgap.diagnosis.decision import Judgement
from leapgap.diagnosis.experiments import candidates_for
from leapgap.diagnosis.experiments.base import REPEATS, Experiment, Repetition
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.jumps import OtherJumps
from leapgap.diagnosis.experiments.plans import is_possible
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.robust_least_squares import Products
from leapgap.diagnosis.selection import differences
from leapgap.diagnosis.sensitivities import Sensitivities, concatenate_logs
from leapgap.diagnosis.short_rollouts import Effects, ShortRollouts
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_QUATERNION
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer, Rollout

MOST_LOGS, MOST_S = 3, 4.0
"""An experiment is foretold from so many of its logs, and from this long a part of each, s."""
PIECES, LEAST_PIECES, STATES = 12, 4, 100
"""Number of short pieces in which an experiment is foretold; a diagnosis takes more, so that its gain is larger.

Robots of many degrees of freedom take fewer, so that pieces times degrees are at most about ``STATES``."""
ENOUGH = 60.0
"""Loss of log likelihood of the best rival that tells it apart: what a diagnosis asks of a further cause."""
MOST_REPEATS, LEAST_TIMES = 6, 2.0
"""How many times an experiment is made at most, so that its losses add up to enough; and by what factor its loss must
exceed today's."""
UNSURE, SHRINKS = 0.25, 2.0
"""A number is unsure where its standard deviation is this share of its departure from nominal.

An experiment for it must shrink that deviation by this factor."""
MOST_CANDIDATES, GENTLER_STEPS = 18, 4
"""Number of experiments that are simulated at most, and number of sizes of each."""
PLACES, NEAR, CHECKED, CHECKED_FLOATING = 2, 10.0, 5, 2
"""Places at which each open cause is tried, how near to its best held-out loss; experiments foretold for all truths."""
LEAST_NOISES = 0.01
"""Smallest difference, in units of noise, that is told as a number."""
SENSOR_NOISE = {"imu_acc": 0.3, "foot_force": 5.0}
"""Noise of a sensor that nobody has read yet, m/s² and N."""


@dataclass(frozen=True)
class Rival:
    """A set of causes that could be true."""

    name: str
    """Name of the effect that may be the one."""
    fit: Candidate


@dataclass(frozen=True)
class Separation:
    """How far a rival's prediction is from the answer's in one experiment, with its numbers and tolerances adapted."""

    truth: str
    """The cause of the robot that makes the experiment."""
    rival: str
    loss: float
    """Expected loss of its log likelihood, over the pieces in which the experiment was foretold."""
    channel: str
    """Channel in which the two differ most."""
    noises: float
    """Root mean square of that difference, in standard deviations of the channel's noise, with today's numbers."""


@dataclass(frozen=True)
class Forecast:
    """What an experiment would show."""

    experiment: Experiment
    separations: tuple[Separation, ...]
    spread: np.ndarray
    """Standard deviation of the answer's numbers after the experiment, (numbers,)."""

    @property
    def least(self) -> float:
        """Expected loss of the rival that is told apart worst."""
        return min((one.loss for one in self.separations), default=0.0)


@dataclass(frozen=True)
class Forecaster:
    """Simulates experiments of the answer's robot, and what rivals make of them."""

    judged: JudgedLogs
    replayer: Replayer
    name: str
    """Name of the cause that is taken for true."""
    answer: Candidate
    rivals: tuple[Rival, ...]
    tolerances: Mapping[str, float]
    horizon_s: float
    every_s: float
    seed: int

    @cached_property
    def given(self) -> Given:
        """What experiments start from."""
        fits = (self.answer, *(rival.fit for rival in self.rivals))
        places = dict.fromkeys(h.location for fit in fits for h in fit.hypotheses)
        return Given(tuple(states.log for states in self.judged.states), self.robot, tuple(places))

    @property
    def robot(self) -> Robot:
        """The nominal robot of the judged logs."""
        return self.judged.robot

    def forecast(self, experiment: Experiment) -> Forecast | None:
        """What an experiment would show; None where the robot could not make it."""
        replayer = self.replayer
        if experiment.sensors:
            columns = (*replayer.sensors, *experiment.sensors)
            replayer = Replayer(self.robot, replayer.slots, replayer.threads, sensors=columns)
        plans = [short_plan(plan) for plan in experiment.plans(self.given)[:MOST_LOGS]]
        logs = self.simulate(plans, replayer)
        if logs is None or max(len(log) * log.info.sample_period_s for log in logs) <= 2 * self.horizon_s:
            return None
        states = [States.of(log, self.robot, replayer.sensors) for log in logs]
        pieces = min(PIECES, max(LEAST_PIECES, STATES // self.robot.model.nv))
        short = ShortRollouts.of(states, replayer, self.horizon_s, self.every_s, pieces)
        around = [(h, n) for h, n in zip(self.answer.hypotheses, self.answer.split(), strict=True)]
        seen = Sensitivities.of(short, (), self.tolerances, around)
        slopes = self.slopes(seen.evidence, self.answer)
        separations = tuple(self.separation(rival, seen) for rival in self.rivals)
        return Forecast(experiment, separations, self.spread_after(slopes, seen))

    def forecast_possible(self, experiment: Experiment) -> Forecast | None:
        """What an experiment would show, made smaller until the robot can make it; None where it cannot."""
        tried: Experiment | None = experiment
        for _ in range(GENTLER_STEPS):
            found = None if tried is None else self.forecast(tried)
            if tried is None or found is not None:
                return found
            tried = tried.gentler()
        return None

    def simulate(self, plans: Sequence[Log], replayer: Replayer) -> list[Log] | None:
        """Logs of the plans by the answer's robot, with the noise of the given logs; None where it cannot follow."""
        acting = self.effects_of(self.answer, self.answer.numbers)
        motions = replayer.motions([Rollout(plan, acting) for plan in plans])
        pairs = list(zip(plans, motions, strict=True))
        if not all(is_possible(plan, motion, self.robot) for plan, motion in pairs):
            return None
        rng = np.random.default_rng(self.seed)
        return [self.noisy(replayer.as_log(self.disturb(motion, replayer, rng), plan)) for plan, motion in pairs]

    def disturb(self, motion: Motion, replayer: Replayer, rng: np.random.Generator) -> Motion:
        """The motion with the noise of the given logs."""
        by = np.zeros((len(motion), 2 * self.robot.model.nv))
        for channel in (channel for channel in self.judged.logged if channel.is_state):
            sigma = float(np.median([of_log[channel.name] for of_log in self.judged.noise]))
            by[:, channel.entry] = sigma * rng.standard_normal(len(motion))
        noisy = displaced(motion, by, self.robot)
        if motion.sensors is None:
            return noisy
        sizes = np.array([next(s for name, s in SENSOR_NOISE.items() if c.startswith(name)) for c in replayer.sensors])
        return replace(noisy, sensors=motion.sensors + sizes * rng.standard_normal(motion.sensors.shape))

    def noisy(self, log: Log) -> Log:
        """The log with the measured columns that every given log has."""
        measured = {channel.name for channel in self.judged.logged}
        measured |= set(BASE_QUATERNION)
        given = self.given.logs
        columns = {
            name: values
            for name, values in log.columns.items()
            if name == "time"
            or name.startswith(("cmd_", "imu_acc", "foot_force"))
            or (all(name in one for one in given) and (name in measured or name.startswith("base_")))
        }
        return replace(log, columns=columns)

    def effects_of(self, fit: Candidate, numbers: np.ndarray) -> Effects:
        """Effects of a fit with some numbers."""
        return tuple(h.on("", own) for h, own in zip(fit.hypotheses, fit.split(numbers), strict=True))

    def residuals(self, short: ShortRollouts, effects: Sequence[Effects]) -> list[np.ndarray]:
        """Whitened errors (pieces, values) of several robots."""
        found = short.residuals([short.on_every_log(one) for one in effects])
        return [concatenate_logs(one) for one in found]

    def slopes(self, short: ShortRollouts, fit: Candidate) -> np.ndarray:
        """Whitened errors of a fit, then their derivatives by its numbers, (pieces, values, 1 + numbers)."""
        steps = differences(fit.hypotheses, fit.numbers)
        tried = [fit.numbers, *(fit.numbers + by for by in steps)]
        base, *changed = self.residuals(short, [self.effects_of(fit, numbers) for numbers in tried])
        by_number = [(one - base) / by.sum() for one, by in zip(changed, steps, strict=True)]
        return np.stack([base, *by_number], axis=2)

    def separation(self, rival: Rival, seen: Sensitivities) -> Separation:
        """How far a rival is from the answer."""
        short = seen.evidence
        (truth,) = self.residuals(short, [self.effects_of(self.answer, self.answer.numbers)])
        columns = self.slopes(short, rival.fit)
        columns[:, :, 0] -= truth
        both = np.concatenate([columns, seen.nuisances], axis=2)
        variance = np.maximum(np.diag(rival.fit.covariance), 1e-300)
        prior = np.concatenate([1 / variance, np.ones(seen.nuisances.shape[2])])
        products = Products.of(both)
        weights = products.fit(prior, np.ones(len(both), bool))
        chi2, values = products.chi2(weights), products.values
        loss = float((values * np.log1p(chi2 / (2 * values))).sum() + 0.5 * (prior * weights[1:] ** 2).sum())
        own = np.concatenate([columns[:, :, :1], seen.nuisances], axis=2)
        of_tolerances = Products.of(own).fit(np.ones(seen.nuisances.shape[2]), np.ones(len(own), bool))
        channel, noises = largest_difference(own @ of_tolerances, short)
        return Separation(self.name, rival.name, loss, channel, noises)

    def spread_after(self, slopes: np.ndarray, seen: Sensitivities) -> np.ndarray:
        """Standard deviation of the answer's numbers once the experiment is fitted too, (numbers,)."""
        numbers = slopes.shape[2] - 1
        columns = np.concatenate([slopes[:, :, 1:], seen.nuisances], axis=2).reshape(
            -1, slopes.shape[2] - 1 + seen.nuisances.shape[2]
        )
        normal = columns.T @ columns
        normal[numbers:, numbers:] += np.eye(len(normal) - numbers)
        told = normal[:numbers, :numbers] - normal[:numbers, numbers:] @ np.linalg.solve(
            normal[numbers:, numbers:], normal[numbers:, :numbers]
        )
        before = np.linalg.pinv(self.answer.covariance)
        return np.sqrt(np.maximum(np.diag(np.linalg.pinv(before + told)), 0.0))


def largest_difference(whitened: np.ndarray, short: ShortRollouts) -> tuple[str, float]:
    """Channel with the largest root mean square error over its noise, from whitened errors (pieces, values)."""
    squares, first = [], 0
    for own, whitening in zip(short.pieces, short.whitening, strict=True):
        pieces = whitened[first : first + len(whitening)]
        first += len(whitening)
        raw = np.linalg.solve(whitening, pieces[:, :, None])[:, :, 0].reshape(len(pieces), len(own.ages), -1)
        squares.append(((raw / own.noise) ** 2).mean(axis=1))
    of_channels = np.sqrt(np.concatenate(squares).mean(axis=0))
    worst = int(of_channels.argmax())
    return short.state.channels[worst].name, float(of_channels[worst])


def short_plan(plan: Log) -> Log:
    """The first part of a plan."""
    return plan.first_rows(min(len(plan), plan.info.rows(MOST_S) + 1))


def open_fits(judgement: Judgement) -> tuple[Rival, ...]:
    """What may be true where the answer leaves names open: the answer, and fits with the other names in its place.

    Each name stands with its fits at the best few places: a cause at one joint may be told from its rival where the
    same cause at all joints is not.
    """
    found = [Rival(judgement.selected.names[0], judgement.selected)] if judgement.selected.hypotheses else []
    for own, *others in judgement.conclusion.answer:
        if not others or own not in judgement.selected.names:
            continue
        found[0] = Rival(own, judgement.selected)
        found += [Rival(own, fit) for fit in near_fits(judgement, own, own)[:PLACES]]
        for other in others:
            found += [Rival(other, fit) for fit in near_fits(judgement, own, other)[:PLACES]]
        break
    return tuple(Rival(one.name, without_clocks(one.fit)) for one in found)


def near_fits(judgement: Judgement, own: str, name: str) -> list[Candidate]:
    """Fits of the answer's causes with ``name`` in place of ``own``, best first, the answer itself left out."""
    selected, result = judgement.selected, judgement.result
    wanted = sorted({*selected.names, name} - ({own} - {name}))
    fits = [fit for fit in result.rivals if sorted(fit.names) == wanted and fit.hypotheses != selected.hypotheses]
    best = min((float(fit.heldout.sum()) for fit in fits), default=0.0)
    near: list[Candidate] = [fit for fit in fits if fit.heldout.sum() < best + NEAR]
    if near or name == own:
        return near
    singles = [fit for fit in result.alternatives if fit.names == (name,)]
    return [in_place_of(selected, own, fit) for fit in singles[:1]]


def in_place_of(answer: Candidate, own: str, single: Candidate) -> Candidate:
    """The answer with the one cause of another fit in place of one of its own."""
    kept = [k for k, name in enumerate(answer.names) if name != own]
    parts, spreads = answer.split(), answer.split(np.diag(answer.covariance))
    hypotheses = (*(answer.hypotheses[k] for k in kept), single.hypotheses[-1])
    numbers = np.concatenate([*(parts[k] for k in kept), single.split()[-1]])
    variances = np.concatenate([*(spreads[k] for k in kept), single.split(np.diag(single.covariance))[-1]])
    return Candidate(hypotheses, numbers, np.diag(variances), np.tile(numbers, (1, 1)))


def without_clocks(fit: Candidate) -> Candidate:
    """The fit without causes whose values are those of single logs: they are the same in every experiment."""
    kept = [k for k, h in enumerate(fit.hypotheses) if h.per_log is None]
    if len(kept) == len(fit.hypotheses):
        return fit
    which = np.array(fit.indices(kept), int)
    covariance = fit.covariance[np.ix_(which, which)]
    return Candidate(tuple(fit.hypotheses[k] for k in kept), fit.numbers[which], covariance, fit.fold_numbers[:, which])


@dataclass(frozen=True)
class NextExperiment:
    """A proposal, with the figures that speak for it."""

    sentence: str
    separates: tuple[str, ...]
    experiment: Experiment | None = None
    """None where none tells the causes apart, or none could be foretold."""
    repeats: int = 1
    """How many times each of its logs is to be made."""
    expected: tuple[Mapping[str, Any], ...] = ()
    """For each rival what the experiment would show, beside what the logs show today."""
    tried: tuple[Mapping[str, Any], ...] = ()
    """Every experiment that was foretold, with its smallest loss over the rivals."""
    collect: tuple[str, ...] = ()
    """Settings of ``stages.collect``, where these make it."""

    def to_json(self) -> dict[str, Any]:
        """The entry of ``report.json``."""
        entry: dict[str, Any] = {"sentence": self.sentence, "separates": list(self.separates)}
        if self.experiment is not None:
            entry["settings"] = self.experiment.settings | ({REPEATS: self.repeats} if self.repeats > 1 else {})
        if self.collect:
            entry["collect"] = list(self.collect)
        entry["expected"] = [dict(one) for one in self.expected]
        entry["tried"] = [dict(one) for one in self.tried]
        return entry


def propose(
    judgement: Judgement,
    judged: JudgedLogs,
    replayer: Replayer,
    tolerances: Mapping[str, float],
    horizon_s: float,
    every_s: float,
    seed: int,
    progress: Callable[[str], None] = lambda _: None,
) -> NextExperiment | None:
    """The next experiment of a diagnosis; None where nothing is open.

    ``horizon_s`` and ``every_s`` are those of the short rollouts that a further diagnosis would make.
    """
    open_names = next((names for names in judgement.conclusion.answer if len(names) > 1), None)
    if not judgement.conclusion.answer:
        return None
    fits = open_fits(judgement)
    if not fits or not fits[0].fit.hypotheses:
        return None if open_names is None else by_experience(open_names, Given(judged.logs, judged.robot))
    by_truth = [
        Forecaster(
            judged,
            replayer,
            truth.name,
            truth.fit,
            tuple(rival for rival in fits if rival.name != truth.name),
            tolerances,
            horizon_s,
            every_s,
            seed,
        )
        for truth in fits
    ]
    if open_names is None:
        return sharpen(by_truth[0], progress)
    if not by_truth[0].rivals:
        return by_experience(open_names, by_truth[0].given)
    return separate(open_names, by_truth, progress)


def by_experience(names: Sequence[str], given: Given) -> NextExperiment:
    """A proposal without figures, where no rival has a fit that could be simulated."""
    trace = f"These logs leave the same trace for {' and '.join(names)}: "
    jumps = OtherJumps.candidates(given)
    if not jumps:
        return NextExperiment(f"{trace}log faster and slower motions, and diagnose all logs together.", tuple(names))
    (jump,) = jumps
    sentence = f"{trace}{jump.words(given)}, and diagnose all logs together."
    return NextExperiment(sentence, tuple(names), jump, collect=tuple(OtherJumps().collect(given)))


def forecasts_of(forecaster: Forecaster, progress: Callable[[str], None]) -> list[Forecast]:
    """What each possible experiment would show, the least effort first."""
    found = []
    for experiment in candidates_for(forecaster.given)[:MOST_CANDIDATES]:
        forecast = forecaster.forecast_possible(experiment)
        if forecast is not None:
            found.append(forecast)
            progress(f"next experiment {experiment.short}: least loss {forecast.least:.0f}")
    return found


def separate(names: Sequence[str], by_truth: Sequence[Forecaster], progress: Callable[[str], None]) -> NextExperiment:
    """The experiment that tells the open causes apart, whichever is true, or the statement that none does.

    All experiments are foretold for the answer's robot, the most promising ones for the robots of its rivals too.
    """
    answer, *others = by_truth
    given, today = answer.given, answer.forecast(Repetition())
    found = forecasts_of(answer, progress)
    trace = f"These logs leave the same trace for {' and '.join(names)}: "
    least = today.least if today else 0.0
    enough = max(ENOUGH, LEAST_TIMES * least)
    promising = sorted(
        found, key=lambda one: (one.least < enough, one.experiment.cost * (one.least >= enough), -one.least)
    )
    best: Forecast | None = None
    for one in promising[: CHECKED_FLOATING if given.robot.has_free_base else CHECKED]:
        whole = with_other_truths(one, others)
        best = whole if best is None or whole.least > best.least else best
        if best.least >= enough:
            break
    tried = tuple({"experiment": one.experiment.short, "least_loss": one.least} for one in found)
    if best is None or best.least < max(ENOUGH / MOST_REPEATS, LEAST_TIMES * least):
        sentence = (
            f"{trace}none of {len(found)} experiments that were simulated tells them apart beyond noise and the "
            "tolerances of the model."
        )
        return NextExperiment(sentence, tuple(names), tried=tried)
    expected = expected_of(best, today)
    worst = min(expected, key=lambda one: float(one["loss"]))
    was = "" if worst["noises_today"] is None else f"; today by {in_noises(worst['noises_today'])}"
    differ = f"There {names[0]} and {worst['rival']} differ by {in_noises(worst['noises'])} times the noise"
    repeats = 1 if collect_of(best.experiment, given) else max(1, math.ceil(ENOUGH / best.least))
    times = f", each {repeats} times" if repeats > 1 else ""
    sentence = (
        f"{trace}{best.experiment.words(given)}{times}, and diagnose all logs together. {differ} in "
        f"{worst['channel']}{was}."
    )
    collect = collect_of(best.experiment, given)
    return NextExperiment(sentence, tuple(names), best.experiment, repeats, expected, tried, collect)


def in_noises(size: float) -> str:
    """A difference in units of noise to two digits: ``6.3``, ``less than 0.01``."""
    return f"{size:.2g}" if size >= LEAST_NOISES else f"less than {LEAST_NOISES:g}"


def with_other_truths(forecast: Forecast, others: Sequence[Forecaster]) -> Forecast:
    """The forecast with the separations that it has where another cause is true."""
    found = [other.forecast(forecast.experiment) for other in others]
    if any(one is None for one in found):
        return replace(forecast, separations=tuple(replace(one, loss=0.0) for one in forecast.separations))
    more = [one for of in found if of is not None for one in of.separations]
    return replace(forecast, separations=(*forecast.separations, *more))


def collect_of(experiment: Experiment, given: Given) -> tuple[str, ...]:
    """Settings of ``stages.collect`` for an experiment; empty where it cannot make it."""
    return tuple(experiment.collect(given)) if isinstance(experiment, OtherJumps) else ()


def expected_of(best: Forecast, today: Forecast | None) -> tuple[dict[str, Any], ...]:
    """Each rival's smallest separation in an experiment beside today's."""

    def smallest(of: Forecast | None) -> dict[str, Separation]:
        by_size = sorted(of.separations if of else (), key=lambda one: -one.loss)
        first = best.separations[0].truth
        return {one.rival if one.rival != first else one.truth: one for one in by_size}

    before = smallest(today)
    return tuple(
        {
            "rival": name,
            "channel": one.channel,
            "noises": one.noises,
            "loss": one.loss,
            "noises_today": before[name].noises if name in before else None,
            "loss_today": before[name].loss if name in before else None,
        }
        for name, one in sorted(smallest(best).items())
    )


def sharpen(forecaster: Forecaster, progress: Callable[[str], None]) -> NextExperiment | None:
    """The experiment that shrinks the interval of the least sure number of the answer most; None where all are sure."""
    answer = forecaster.answer
    spread = np.sqrt(np.maximum(np.diag(answer.covariance), 0.0))
    nominal = np.concatenate([h.nominal for h in answer.hypotheses])
    unsure = spread / np.maximum(np.abs(answer.numbers - nominal), 1e-12)
    which = int(unsure.argmax())
    if unsure[which] < UNSURE:
        return None
    found = forecasts_of(forecaster, progress)
    enough = [one for one in found if spread[which] >= SHRINKS * one.spread[which]]
    if not enough:
        return None
    best = min(
        (one for one in enough if one.experiment.cost == enough[0].experiment.cost), key=lambda one: one.spread[which]
    )
    labels = [(h.name, p) for h in answer.hypotheses for p in h.parameters]
    name, parameter = labels[which]
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    given, value = forecaster.given, f"{answer.numbers[which]:.3g} ± {spread[which]:.2g}{unit}"
    sentence = (
        f"The least sure number is {parameter.name} of {name}, {value}: "
        f"{best.experiment.words(given)}. That should leave ± {best.spread[which]:.2g}{unit}."
    )
    tried = tuple({"experiment": one.experiment.short, "spread": float(one.spread[which])} for one in found)
    expected = (
        {
            "number": f"{name}.{parameter.name}",
            "spread": float(best.spread[which]),
            "spread_today": float(spread[which]),
        },
    )
    return NextExperiment(sentence, (), best.experiment, 1, expected, tried, collect_of(best.experiment, given))
