"""What an experiment would show, by simulating it.

The answer's robot makes each experiment in simulation. Its logs are cut to the short pieces that a diagnosis fits, and
each rival is replayed in them. A rival may adapt its numbers as far as today's logs leave them open, and the model's
tolerances may move too; what then remains of the difference is what a further diagnosis could see.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.channels import displaced
from leapgap.diagnosis.experiment_nuisances import Nuisances, errors_of
from leapgap.diagnosis.experiments.base import Experiment
from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import is_possible
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.rival_fits import Rival
from leapgap.diagnosis.robust_least_squares import Products
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_QUATERNION
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

MOST_LOGS, MOST_S = 3, 4.0  # An experiment is foretold from so many of its logs, and from this long a part of each, s
PIECES, LEAST_PIECES, STATES = 12, 4, 100
"""Number of short pieces in which an experiment is foretold; a diagnosis takes more, so that its gain is larger.

Robots of many degrees of freedom take fewer, so that pieces times degrees are at most about ``STATES``."""
STEP = 0.1  # Step of finite differences, as a share of the moderate departure
GENTLER_STEPS = 4  # Number of sizes in which each experiment is tried
SENSOR_NOISE = {"imu_acc": 0.3, "foot_force": 5.0}  # Noise of a sensor that nobody has read yet, m/s² and N


@dataclass(frozen=True)
class Separation:
    """How far a rival's prediction is from the answer's in one experiment, with its numbers and tolerances adapted."""

    truth: str  # The cause of the robot that makes the experiment
    rival: str
    loss: float  # Expected loss of its log likelihood, over pieces of all logs of the experiment
    channel: str  # Channel in which the two differ most
    noises: float
    """Root mean square of that difference, in standard deviations of the channel's noise, with today's numbers."""


@dataclass(frozen=True)
class Forecast:
    """What an experiment would show."""

    experiment: Experiment
    separations: tuple[Separation, ...]
    spread: np.ndarray  # Standard deviation of the answer's numbers after the experiment, (numbers,)

    @property
    def least(self) -> float:
        """Expected loss of the rival that is told apart worst."""
        return min((one.loss for one in self.separations), default=0.0)


@dataclass(frozen=True)
class Forecaster:
    """Simulates experiments of the answer's robot, and what rivals make of them."""

    judged: JudgedLogs
    replayer: Replayer
    name: str  # Name of the cause that is taken for true
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
        seen = Nuisances.of(short, self.answer, self.tolerances)
        slopes = self.slopes(seen.short, self.answer)
        times = experiment.number(self.given) / len(plans)
        separations = tuple(self.separation(rival, seen, times) for rival in self.rivals)
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
        acting = self.answer.effects_on("", None)
        motions = replayer.motions([Rollout(plan, acting) for plan in plans])
        pairs = list(zip(plans, motions, strict=True))
        if not all(is_possible(plan, motion, self.robot) for plan, motion in pairs):
            return None
        rng = np.random.default_rng(self.seed)
        return [self.measured(plan, motion, replayer, rng) for plan, motion in pairs]

    def measured(self, plan: Log, motion: Motion, replayer: Replayer, rng: np.random.Generator) -> Log:
        """The log of a plan in which a robot moves so, with the columns and the noise of the given logs."""
        return self.noisy(replayer.as_log(self.disturb(motion, replayer, rng), plan))

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

    def slopes(self, short: ShortRollouts, fit: Candidate) -> np.ndarray:
        """Whitened errors of a fit, then their derivatives by its numbers, (pieces, values, 1 + numbers)."""
        steps = differences(fit.hypotheses, fit.numbers)
        moved = (replace(fit, numbers=fit.numbers + by) for by in steps)
        base, *changed = errors_of(short, [one.effects_on("", None) for one in (fit, *moved)])
        by_number = [(one - base) / by.sum() for one, by in zip(changed, steps, strict=True)]
        return np.stack([base, *by_number], axis=2)

    def separation(self, rival: Rival, seen: Nuisances, times: float) -> Separation:
        """How far a rival is from the answer in an experiment of so many times the logs in which it is foretold."""
        short = seen.short
        (truth,) = errors_of(short, [self.answer.effects_on("", None)])
        columns = self.slopes(short, rival.fit)
        columns[:, :, 0] -= truth
        both = np.concatenate([columns, seen.columns], axis=2)
        variance = np.maximum(np.diag(rival.fit.covariance), 1e-300)
        prior = np.concatenate([1 / variance, np.ones(seen.columns.shape[2])])
        products = Products.of(both)
        weights = products.fit(prior)
        chi2, values = products.chi2(weights), products.values
        loss = float((values * np.log1p(chi2 / (2 * values))).sum() + 0.5 * (prior * weights[1:] ** 2).sum())
        own = np.concatenate([columns[:, :, :1], seen.columns], axis=2)
        of_tolerances = Products.of(own).fit(np.ones(seen.columns.shape[2]))
        channel, noises = largest_difference(own @ of_tolerances, short)
        return Separation(self.name, rival.name, times * loss, channel, noises)

    def spread_after(self, slopes: np.ndarray, seen: Nuisances) -> np.ndarray:
        """Standard deviation of the answer's numbers once the experiment is fitted too, (numbers,)."""
        numbers = slopes.shape[2] - 1
        columns = np.concatenate([slopes[:, :, 1:], seen.columns], axis=2).reshape(
            -1, slopes.shape[2] - 1 + seen.columns.shape[2]
        )
        normal = columns.T @ columns
        normal[numbers:, numbers:] += np.eye(len(normal) - numbers)
        told = normal[:numbers, :numbers] - normal[:numbers, numbers:] @ np.linalg.solve(
            normal[numbers:, numbers:], normal[numbers:, :numbers]
        )
        before = np.linalg.pinv(self.answer.covariance)
        return np.sqrt(np.maximum(np.diag(np.linalg.pinv(before + told)), 0.0))


def differences(hypotheses: Sequence[Hypothesis], numbers: np.ndarray) -> list[np.ndarray]:
    """A small step in each number within its range, (numbers,) each."""
    steps = STEP * np.concatenate([h.moderate for h in hypotheses])
    lower, upper = (np.concatenate([h.bounds[side] for h in hypotheses]) for side in (0, 1))
    inside = (numbers + steps <= upper) & (numbers + steps >= lower)
    return list(np.diag(np.where(inside, steps, -steps)))


def largest_difference(whitened: np.ndarray, short: ShortRollouts) -> tuple[str, float]:
    """Channel with the largest root mean square error over its noise, from whitened errors (pieces, values).

    Of few pieces none may be of some log.
    """
    squares, first = [], 0
    for own, whitening in zip(short.pieces, short.whitening, strict=True):
        pieces = whitened[first : first + len(whitening)]
        first += len(whitening)
        shape = (len(pieces), len(own.ages), len(own.noise))
        raw = np.linalg.solve(whitening, pieces[:, :, None]).reshape(shape)
        squares.append(((raw / own.noise) ** 2).mean(axis=1))
    of_channels = np.sqrt(np.concatenate(squares).mean(axis=0))
    worst = int(of_channels.argmax())
    return short.state.channels[worst].name, float(of_channels[worst])


def short_plan(plan: Log) -> Log:
    """The first part of a plan."""
    return plan.first_rows(min(len(plan), plan.info.rows(MOST_S) + 1))
