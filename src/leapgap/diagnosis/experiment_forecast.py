"""What an experiment would show, by simulating it.

The answer's robot makes each experiment in simulation. Its logs are cut to the short pieces that a diagnosis fits, and
each rival is replayed in them. A rival may adapt its numbers as far as today's logs leave them open, and the model's
tolerances may move too; what then remains of the difference is what a further diagnosis could see.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from leapgap import effects
from leapgap.diagnosis.candidates import Candidate, Rival, inward
from leapgap.diagnosis.channels import displaced
from leapgap.diagnosis.experiment_plans import Given, is_possible
from leapgap.diagnosis.experiments import Experiment
from leapgap.diagnosis.hypotheses import Hypothesis, places, tolerance, usable
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.robust_least_squares import Products
from leapgap.diagnosis.settings import Settings
from leapgap.diagnosis.short_rollouts import FINE, Effects, ShortRollouts
from leapgap.effects.base import Effect, overrides
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
    settings: Settings  # Tolerances of the model, and the pieces that a further diagnosis would cut
    name: str  # Name of the cause that is taken for true
    answer: Candidate
    rivals: tuple[Rival, ...] = ()
    foretold: dict[Experiment, Forecast | None] = field(default_factory=dict)

    @cached_property
    def given(self) -> Given:
        """What experiments start from."""
        fits = (self.answer, *(rival.fit for rival in self.rivals))
        at = dict.fromkeys(h.location for fit in fits for h in fit.hypotheses)
        return Given(tuple(states.log for states in self.judged.states), self.robot, tuple(at))

    @property
    def robot(self) -> Robot:
        """The nominal robot of the judged logs."""
        return self.judged.robot

    @cached_property
    def acting(self) -> Effects:
        """The answer's effects, in a log yet to be made."""
        return self.answer.effects_on("", None)

    def plans(self, experiment: Experiment) -> list[Log]:
        """The first parts of the first logs of an experiment."""
        return [plan.first_rows(min(len(plan), plan.info.rows(MOST_S) + 1)) for plan in experiment.plans[:MOST_LOGS]]

    def forecast(self, experiment: Experiment) -> Forecast | None:
        """What an experiment would show; None where the robot could not make it."""
        if experiment not in self.foretold:
            self.foretold[experiment] = self._forecast(experiment)
        return self.foretold[experiment]

    def _forecast(self, experiment: Experiment) -> Forecast | None:
        replayer, horizon_s = self.replayer, self.settings.horizon_s
        if experiment.sensors:
            columns = (*replayer.sensors, *experiment.sensors)
            replayer = Replayer(self.robot, replayer.slots, replayer.threads, sensors=columns)
        plans = self.plans(experiment)
        logs = self.simulate(plans, replayer)
        if logs is None or max(len(log) * log.info.sample_period_s for log in logs) <= 2 * horizon_s:
            return None
        states = [States.of(log, self.robot, replayer.sensors) for log in logs]
        pieces = min(PIECES, max(LEAST_PIECES, STATES // self.robot.model.nv))
        short = ShortRollouts.of(states, replayer, horizon_s, self.settings.every_s, pieces)
        short, nuisances = with_nuisances(short, self.answer, self.settings.tolerances)
        slopes = slopes_of(short, self.answer)
        times = experiment.number / len(plans)
        separations = tuple(self.separation(rival, short, nuisances, times) for rival in self.rivals)
        return Forecast(experiment, separations, self.spread_after(slopes[:, :, 1:], nuisances))

    def forecast_possible(self, experiment: Experiment) -> Forecast | None:
        """What an experiment would show, made smaller until the robot can make it; None where it cannot."""
        tried: Experiment | None = experiment
        for _ in range(GENTLER_STEPS):
            found = None if tried is None else self.forecast(tried)
            if tried is None or found is not None:
                return found
            tried = tried.gentler and tried.gentler()
        return None

    def simulate(self, plans: Sequence[Log], replayer: Replayer) -> list[Log] | None:
        """Logs of the plans by the answer's robot, with the noise of the given logs; None where it cannot follow."""
        pairs = list(zip(plans, replayer.motions([Rollout(plan, self.acting) for plan in plans]), strict=True))
        if not all(is_possible(plan, motion, self.robot) for plan, motion in pairs):
            return None
        rng = np.random.default_rng(self.settings.seed)
        return [self.measured(plan, motion, replayer, rng) for plan, motion in pairs]

    def measured(self, plan: Log, motion: Motion, replayer: Replayer, rng: np.random.Generator) -> Log:
        """The log of a plan in which a robot moves so, with the noise and the columns that every given log has."""
        log = replayer.as_log(self.disturb(motion, replayer, rng), plan)
        names = {channel.name for channel in self.judged.logged} | set(BASE_QUATERNION)
        columns = {
            name: values
            for name, values in log.columns.items()
            if name == "time"
            or name.startswith(("cmd_", "imu_acc", "foot_force"))
            or (all(name in one for one in self.given.logs) and (name in names or name.startswith("base_")))
        }
        return replace(log, columns=columns)

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

    def separation(self, rival: Rival, short: ShortRollouts, nuisances: np.ndarray, times: float) -> Separation:
        """How far a rival is from the answer in an experiment of so many times the logs in which it is foretold."""
        (truth,) = errors_of(short, [self.acting])
        columns = slopes_of(short, rival.fit)
        columns[:, :, 0] -= truth
        products = Products.of(np.concatenate([columns, nuisances], axis=2))
        free = np.ones(nuisances.shape[2])
        prior = np.concatenate([1 / np.maximum(np.diag(rival.fit.covariance), 1e-300), free])
        weights = products.fit(prior)
        chi2, values = products.chi2(weights), products.values
        loss = float((values * np.log1p(chi2 / (2 * values))).sum() + 0.5 * (prior * weights[1:] ** 2).sum())
        own = np.concatenate([columns[:, :, :1], nuisances], axis=2)
        channel, noises = largest_difference(own @ Products.of(own).fit(free), short)
        return Separation(self.name, rival.name, times * loss, channel, noises)

    def spread_after(self, slopes: np.ndarray, nuisances: np.ndarray) -> np.ndarray:
        """Standard deviation of the answer's numbers once the experiment is fitted too, (numbers,)."""
        numbers, both = slopes.shape[2], np.concatenate([slopes, nuisances], axis=2)
        columns = both.reshape(-1, both.shape[2])
        normal = columns.T @ columns
        normal[numbers:, numbers:] += np.eye(len(normal) - numbers)
        made_up = np.linalg.solve(normal[numbers:, numbers:], normal[numbers:, :numbers])
        told = normal[:numbers, :numbers] - normal[:numbers, numbers:] @ made_up
        before = np.linalg.pinv(self.answer.covariance)
        return np.sqrt(np.maximum(np.diag(np.linalg.pinv(before + told)), 0.0))


def errors_of(short: ShortRollouts, sets: list[Effects]) -> list[np.ndarray]:
    """Whitened errors of the pieces of all logs with several sets of effects, (pieces, values) each."""
    return [np.concatenate(of_logs) for of_logs in short.residuals([short.on_every_log(one) for one in sets])]


def slopes_of(short: ShortRollouts, fit: Candidate) -> np.ndarray:
    """Whitened errors of a fit, then their derivatives by its numbers, (pieces, values, 1 + numbers)."""
    by = STEP * np.concatenate([h.moderate for h in fit.hypotheses])
    by = inward(fit.hypotheses, fit.numbers, by) * by
    moved = (replace(fit, numbers=fit.numbers + step) for step in np.diag(by))
    base, *changed = errors_of(short, [one.effects_on("", None) for one in (fit, *moved)])
    return np.stack([base, *((one - base) / step for one, step in zip(changed, by, strict=True))], axis=2)


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


def with_nuisances(
    short: ShortRollouts, answer: Candidate, tolerances: Mapping[str, float]
) -> tuple[ShortRollouts, np.ndarray]:
    """Pieces whose errors are whitened for the answer's robot, and what one deviation of each nuisance changes there.

    Changes of the whitened errors, (pieces, values, nuisances), by replays of a moderate departure of each tolerance
    (``Settings.tolerances``) at each single place. The first nuisance is the error of the steps, unless some effect
    acts on these.
    """
    robot, acting = short.state.robot, answer.effects_on("", None)
    short = short.whiten_for(short.on_every_log(acting))
    further, sizes, kinds = list[Effect](), list[float](), {h.kind for h in answer.hypotheses}
    for there, number, deviation in tolerated(robot, tolerances):
        if there.name in answer.names and not keeps_tolerance(there.kind, robot):
            continue
        kinds.add(there.kind)
        by = np.eye(len(there.nominal))[number] * there.moderate
        further.append(there.on("", there.nominal + by))
        sizes.append(deviation / by[number])
    start, *changed = errors_of(short, [acting, *((*acting, one) for one in further)])
    found = [size * (errors - start) for size, errors in zip(sizes, changed, strict=True)]
    if not any(overrides(kind, "change_step") for kind in kinds):
        (stepped,) = errors_of(short.with_steps(FINE * short.replayer.largest_step_s), [acting])
        found.insert(0, stepped - start)
    return short, np.stack(found, axis=2) if found else np.zeros((*start.shape, 0))


def tolerated(robot: Robot, tolerances: Mapping[str, float]) -> Iterator[tuple[Hypothesis, int, float]]:
    """What a model has within a tolerance, at each single place: effect, index of its number, and its deviation."""
    kinds = effects.known()
    for name, share in tolerances.items():
        effect, _, parameter = name.partition(".")
        if effect in kinds and usable(kinds[effect], robot):
            for place in places(kinds[effect], robot)["all"]:
                there = Hypothesis(kinds[effect], robot, place)
                number = [p.name for p in there.effect_parameters].index(parameter)
                yield there, number, tolerance(there.kind, robot, place, parameter, share)


def keeps_tolerance(kind: type[Effect], robot: Robot) -> bool:
    """Whether what each place is off by stays in question where an effect of that kind acts.

    One number for all joints leaves what each of them is off by. It does so where none of the effect's numbers stands
    in place of the model's, and on held robots alone: in short pieces of jumps it would hide what acts slowly.
    """
    return not robot.has_free_base and all(own.nominal is not None for own in kind.declarations().values())
