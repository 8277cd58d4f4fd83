"""A referee for anybody's correction: which of its changes logs support that it was not fitted on.

Each change of the corrected model to the nominal one is an effect with one number, the share of it that acts: 0 is the
nominal robot, 1 the correction. The engine's evidence gives the share, while all other changes have shares of their own
and further effects may act that the correction lacks.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import split_numbers
from leapgap.diagnosis.diagnose import chosen_kinds, kinds_by_evidence, tolerances_on
from leapgap.diagnosis.engine.points import ABSENT, Acting, Bench, Point
from leapgap.diagnosis.engine.screening import few_of_each, screen
from leapgap.diagnosis.engine.search import LEAST_GAIN, MOST_CAUSES, UNNAMED, Found, Search
from leapgap.diagnosis.gap import folds_of, scaled_errors
from leapgap.diagnosis.horizons import gap_of, horizons_of, replayer_at, unmoved_errors
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses, places
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.effects import label_words, parameter_words
from leapgap.effects.base import Effect, Parameter
from leapgap.effects.drive import Drive
from leapgap.effects.model_change import FIELDS, MOST, StatedChange
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer

SUPPORTED, ANOTHER, UNSUPPORTED, UNTOLD = "supported", "another number", "not supported", "undecided"
MODEL_ERROR = 0.1  # Standard deviation of a share that no logs make smaller: simulations differ from robots
SURE = 3.0  # Standard deviations by which a share differs from 0 and from 1
MADE_UP = 2.0  # A change compensates for an effect without which it is worth this many times more
CLOSELY = 3  # Number of further effects that are replayed in each round


@dataclass(frozen=True)
class AtHorizon:
    """Errors of replays that start anew from the log after a time, in units of the headline gap."""

    horizon_s: float | None  # None: whole logs
    nominal: float
    corrected: float
    frozen: float  # Of a robot that does not move from each start (baseline)


@dataclass(frozen=True)
class RefereedLogs:
    """Logs with the bench of the engine."""

    judged: JudgedLogs
    bench: Bench
    folds: np.ndarray  # Fold of each log

    @staticmethod
    def of(where: str, logs: Sequence[Log], robot: Robot, settings: Settings, threads: int | None) -> "RefereedLogs":
        """Cut the logs; ``where`` names the command in errors."""
        if len(logs) < 2:
            expected = "two or more: what acts is judged on logs it was not fitted on"
            raise InputError(where, f"{len(logs)} log", expected, "name more logs of the same robot")
        judged = JudgedLogs.of(logs, robot, settings.sizes)
        slots = max((len(log.info.terrain) for log in logs), default=0)
        replayer = Replayer(robot, max(1, slots), threads, sensors=judged.sensors.columns)
        hypotheses = list_hypotheses(kinds_by_evidence(chosen_kinds(settings), settings), robot, None)
        bench = Bench(hypotheses, tolerances_on(robot, settings), judged.states, replayer)
        return RefereedLogs(judged, bench, folds_of(len(logs), settings.folds))

    def errors_left(self, correction: tuple[Effect, ...]) -> tuple[dict[str, float], tuple[AtHorizon, ...]]:
        """Shares of the channels in what a correction leaves at the shortest horizon, the largest first, and errors.

        Errors are those at several horizons, the longest first.
        """
        judged, rows, left = self.judged, list[AtHorizon](), np.zeros(len(self.judged.channels))
        sets = [[one for _ in judged.logs] for one in ((), correction)]
        for horizon in horizons_of(judged):
            nominal, corrected = scaled_errors(judged, replayer_at(self.bench.replayer, horizon), sets)
            still = unmoved_errors(judged, horizon)
            rows.append(AtHorizon(horizon, gap_of(nominal), gap_of(corrected), gap_of(still)))
            left = np.sum([(error**2).sum(axis=0) for error in corrected], axis=0)
        shares = left / max(left.sum(), 1e-300)
        order = np.argsort(-shares, kind="stable")
        return {judged.channels[k].name: float(shares[k]) for k in order}, tuple(rows)


@dataclass(frozen=True)
class Change(Hypothesis):
    """A change as a hypothesis, whose one number is the share of it that acts."""

    stated: StatedChange | None = field(default=None, compare=False)

    @staticmethod
    def of(stated: StatedChange, robot: Robot) -> "Change":
        """The hypothesis of a change."""
        return Change(type(stated.effect), robot, stated.effect.location, None, stated)

    @property
    def name(self) -> str:
        """The title of the change, so that it hides no effect."""
        assert self.stated is not None
        return self.stated.title

    @property
    def label(self) -> str:
        """The title of the change."""
        return self.name

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is fitted: the share of the change that acts, 1 where all of it does."""
        return (Parameter("share", "1", 0.0, 0.0, MOST, 1.0),)

    def values(self, log: str, numbers: np.ndarray) -> dict[str, float]:
        """Values of the effect at a share."""
        assert self.stated is not None
        own = self.stated.effect.values
        return {
            p.name: p.nominal + float(numbers[0]) * (own.get(p.name, p.nominal) - p.nominal)
            for p in self.effect_parameters
        }


@dataclass(frozen=True)
class JudgedChange:
    """What logs say of one change."""

    title: str
    says: str
    verdict: str  # ``supported``, ``another number`` of it, ``not supported`` or ``undecided`` by these logs
    share: float  # Share of the change that the logs support, 1 if all of it
    share_ci95: tuple[float, float]
    gain: float  # Evidence of the whole change over none of it, nats, beside the other changes and what else acts
    instead: str | None  # The effect that takes its place better: what the change compensates for


@dataclass(frozen=True)
class Judgement:
    """What logs say of a correction."""

    changes: tuple[JudgedChange, ...]
    further: tuple[str, ...]  # Effects that act besides, with their numbers
    unnamed: float  # Evidence of a force without a name beside all that, nats for each 0.1 s
    horizons: tuple[AtHorizon, ...]
    remains: Mapping[str, float]
    """Channels with their shares of the squared gap that the correction leaves, the largest first."""
    logs: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON."""
        return asdict(self)

    def __str__(self) -> str:
        """Lines for a person."""
        width = max((len(one.title) for one in self.changes), default=0)
        lines = [*self.notes, f"judged on {len(self.logs)} logs:"]
        for one in self.changes:
            low, high = one.share_ci95
            wanted = f"the logs support {one.share:.2f} (95 %: {low:.2f} to {high:.2f}) of it"
            told = f"{one.verdict}; {wanted}, evidence {one.gain:+.0f} nats"
            lines.append(f"  {one.title:<{width}}  {one.says}: {told}")
            if one.instead:
                lines.append(f"  {'':<{width}}  compensates for {one.instead}")
        lines += [] if self.changes else ["  the two models do not differ in anything that is judged"]
        lines.append(f"also acts: {', '.join(self.further) or 'no known effect'}")
        if self.unnamed > UNNAMED:
            lines.append(f"an unmodelled cause acts, too ({self.unnamed:.0f} nats for each 0.1 s)")
        lines += ["error        nominal  corrected  frozen robot"]
        for at in self.horizons:
            when = "whole logs" if at.horizon_s is None else f"after {at.horizon_s:g} s"
            lines.append(f"{when:<11}  {at.nominal:7.3f}  {at.corrected:9.3f}  {at.frozen:12.3f}")
        shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in [*self.remains.items()][:3])
        return "\n".join([*lines, f"the remaining error is in {shares}"])


def change_of_effect(effect: Effect, robot: Robot) -> StatedChange:
    """An effect of a report as a change."""
    own = effect.values
    told = [
        f"{p.name} {p.nominal:.4g} → {own.get(p.name, p.nominal):.4g}"
        for p in effect.parameters(robot, effect.location)
    ]
    return StatedChange(Hypothesis(type(effect), robot, effect.location).label, ", ".join(told), effect)


def judge_correction(
    logs: Sequence[Log],
    robot: Robot,
    stated: Sequence[StatedChange],
    settings: Settings | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
    notes: Sequence[str] = (),
) -> Judgement:
    """Judge the changes that somebody's correction makes to a nominal robot, on logs it was not fitted on."""
    progress(f"step 1 of 2, changes: {len(logs)} logs, {len(stated)} changes")
    logs_of = RefereedLogs.of("judge", logs, robot, settings or Settings(), threads)
    changes = [Change.of(one, robot) for one in stated]
    taken = frozenset(one for change in changes for one in touched(change, robot))
    search = SearchBeside(logs_of.bench, logs_of.folds, progress, taken=taken)
    start = logs_of.bench.nominal()
    if changes:
        start = logs_of.bench.moved(start.intervals, start.basis, tuple((change, np.ones(1)) for change in changes))
    found, others = search.with_further(search.settle(search.judge(start)))
    told = [judge_change(search, found, len(changes), k) for k in range(len(changes))]
    numbers = split_numbers(found.members, found.numbers)
    further = zip(found.members[len(changes) :], numbers[len(changes) :], others, strict=True)
    whole = tuple(one.effect for one in stated)
    progress("step 2 of 2, errors of replays")
    remains, horizons = logs_of.errors_left(whole)
    return Judgement(
        tuple(told),
        tuple(", or ".join([numbered(h, own), *map(label_words, like)]) for h, own, like in further),
        found.unnamed / len(found.point.evidence.levels),
        horizons,
        remains,
        tuple(log.name for log in logs),
        tuple(notes),
    )


@dataclass(frozen=True)
class SearchBeside(Search):
    """A search for what acts beside changes, whatever share of each acts."""

    taken: frozenset[tuple[str, int | str]] = frozenset()
    """Numbers of the robot that changes touch: the share of a change stands for an effect that touches one."""

    def with_further(self, found: Found) -> tuple[Found, list[list[str]]]:
        """A set with the further effects that act; of each the labels of others that would do as well."""
        others: list[list[str]] = []
        while len(others) < MOST_CAUSES:
            worth = [h for gain, h in screen(found.point) if gain > LEAST_GAIN and self.is_free(h)]
            linear = self.judge_each(found.point, few_of_each(worth, 2)[: 2 * CLOSELY])
            tried = [one for one in self.promising(found, linear) if one.departs(-1)]
            best = max(tried, key=lambda one: one.worth, default=found)
            if best.worth <= found.worth:
                break
            self.progress(f"also acts: {best.members[-1].label}")
            like = [one.members[-1] for one in tried if one is not best and one.worth > best.worth - LEAST_GAIN]
            others.append([h.label for h in few_of_each(like, 1) if h.name != best.members[-1].name])
            found = best
        return found, others

    def far(self, part: Point, looked: Sequence[str]) -> list[Acting]:
        """Effects in the drives far from nominal, without those that touch what a change touches."""
        return [pair for pair in super().far(part, looked) if self.is_free(pair[0][0])]

    def is_free(self, hypothesis: Hypothesis) -> bool:
        """Whether no change stands for an effect."""
        return not self.taken & touched(hypothesis, hypothesis.robot)


def touched(hypothesis: Hypothesis, robot: Robot) -> set[tuple[str, int | str]]:
    """Which numbers of the robot an effect changes: fields of the model and of the motors, with their rows."""
    numbers = hypothesis.moderate + hypothesis.nominal
    effect = hypothesis.on("", numbers)
    single = places(hypothesis.kind, robot).get(hypothesis.location, (hypothesis.location,))
    kind = hypothesis.kind.name
    found: set[tuple[str, int | str]] = {(kind, place) for place in single if hypothesis.kind.places != "none"}
    found |= changed_numbers(effect, robot)
    return found or {(kind, "all")}


def changed_numbers(effect: Effect, robot: Robot) -> set[tuple[str, int | str]]:
    """Fields of the compiled model and of the motors that an effect changes, with their rows."""
    found: set[tuple[str, int | str]] = set()
    if effect.structure is None:
        model = copy.copy(robot.model)
        effect.change_model(model, robot)
        for name in ("body_mass", "body_ipos", "body_inertia", *FIELDS):
            if name.startswith("opt."):
                own, other = (np.atleast_1d(getattr(m.opt, name.removeprefix("opt."))) for m in (robot.model, model))
                found |= {(name, 0)} if (own != other).any() else set()
                continue
            own, other = getattr(robot.model, name), getattr(model, name)
            rows = (own != other).reshape(len(own), -1).any(axis=1)
            found |= {(name, int(row)) for row in np.flatnonzero(rows)}
    ideal = Drive.ideal(len(robot.joints))
    drive = effect.change_drive(ideal, robot)
    for name, own in vars(ideal).items():
        other = getattr(drive, name)
        found |= {(name, int(j)) for j in np.flatnonzero((own != other) & ~(np.isnan(own) & np.isnan(other)))}
    return found


def evidence_at(
    found: Found, member: int, value: float | None, without: Sequence[int] = ()
) -> tuple[float, float, float]:
    """Evidence of a set with the share of one change at a value (None: free), and the share's mean and deviation.

    The other numbers of the set are free; members ``without`` are at nominal.
    """
    deviation, centre = found.point.priors((), without)
    first = found.point.nuisances + sum(len(h.parameters) for h in found.members[:member])
    at = found.point.acting[member][1][0]
    if value is not None:
        deviation[first], centre[first] = ABSENT, value - at
    posterior = found.point.evidence.posterior(deviation, centre)
    return posterior.evidence, at + posterior.mean[first], float(np.sqrt(posterior.covariance[first, first]))


def gain_of(found: Found, member: int, share: float | None = 1.0, without: Sequence[int] = ()) -> float:
    """Evidence of a share of a change, of its likeliest one where that is None, over none of it, nats."""
    return evidence_at(found, member, share, without)[0] - evidence_at(found, member, 0.0, without)[0]


def judge_change(search: Search, found: Found, changes: int, k: int) -> JudgedChange:
    """What the logs say of one change, beside the others and what else acts."""
    change = found.members[k]
    assert isinstance(change, Change)
    free, share, deviation = evidence_at(found, k, None)
    none, gain = evidence_at(found, k, 0.0)[0], gain_of(found, k)
    spread = float(np.hypot(deviation, MODEL_ERROR))
    if free - none < LEAST_GAIN:
        verdict = UNSUPPORTED if 1 - share > SURE * spread else UNTOLD
    elif abs(share - 1) <= SURE * spread and gain > LEAST_GAIN:
        verdict = SUPPORTED
    else:
        verdict = ANOTHER if share > SURE * spread else UNSUPPORTED
    instead = None
    if verdict in (ANOTHER, UNSUPPORTED):
        worth = {
            m: gain_of(search.judge(found.point, (), [m]), k, None, [m]) for m in range(changes, len(found.members))
        }
        most = max(worth, key=lambda m: worth[m], default=-1)
        if most >= 0 and worth[most] > max(LEAST_GAIN, MADE_UP * (free - none)):
            instead = numbered(found.members[most], split_numbers(found.members, found.numbers)[most])
    assert change.stated is not None
    interval = (share - 1.96 * spread, share + 1.96 * spread)
    return JudgedChange(change.name, change.stated.says, verdict, share, interval, gain, instead)


def numbered(hypothesis: Hypothesis, numbers: np.ndarray) -> str:
    """``joint Coulomb friction at elbow (torque 1.02 N·m)``"""
    own = hypothesis.clip(numbers)
    pairs = zip(hypothesis.parameters, own, strict=True)
    told = [f"{parameter_words(p.name)} {n:.3g} {p.unit}".removesuffix(" 1") for p, n in pairs]
    return f"{label_words(hypothesis.label)} ({', '.join(told)})"
