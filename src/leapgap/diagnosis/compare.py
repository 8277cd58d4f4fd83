"""What changed between two sets of logs of one robot: before and after a load, a repair, a specimen.

First one search looks for each effect twice, in all logs and as a difference in the later set alone, so that all is
linear about a robot near the true one. Then whatever the model may be wrong by is a column that both sets share, with
its prior, and cancels: a difference stays, or is found, where nothing shared can explain it.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import split_numbers
from leapgap.diagnosis.engine.evidence import Posterior, Whitened
from leapgap.diagnosis.engine.intervals import Intervals
from leapgap.diagnosis.engine.points import ABSENT, Acting, Basis, Bench, Point, prior_of
from leapgap.diagnosis.engine.responses import Columns
from leapgap.diagnosis.engine.screening import Projection, few_of_each, screen
from leapgap.diagnosis.engine.search import (
    ALIKE,
    CLOSELY,
    LEAST_GAIN,
    MOST_CAUSES,
    UNNAMED,
    Found,
    Search,
)
from leapgap.diagnosis.engine.whitening import Chunks
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judge import RefereedLogs, numbered
from leapgap.diagnosis.settings import Settings
from leapgap.effects import effect_words, label_words, parameter_words
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

SURE = 0.99  # Probability that a difference is no chance of logs that differ among themselves
LEAST = 1e-9  # Share of a difference that acts before, where it needs further parts of the model
SHARE = 3.0  # Prior standard deviation of the share of a difference that acts in a log
BEFORE, AFTER = "before", "after"
MODEL_ERROR = 0.08  # Relative error of a difference because the simulation differs from the robot, in its interval
SHOWN = 8  # Number of smallest changes that are reported


@dataclass(frozen=True)
class Difference(Hypothesis):
    """An effect that acts on the later logs alone, beside what acts in all."""

    after: frozenset[str] = field(default=frozenset(), compare=False)  # Names of the later logs

    @staticmethod
    def of(hypothesis: Hypothesis, after: frozenset[str]) -> "Difference":
        """The difference by a hypothesis."""
        return Difference(hypothesis.kind, hypothesis.robot, hypothesis.location, None, after)

    @property
    def name(self) -> str:
        """Name of the difference, which is not that of the effect in all logs."""
        return f"change of {super().name}"

    def on(self, log: str, numbers: np.ndarray) -> Effect:
        """The effect on one log: before nominal, or so little that the model has the same parts in all logs."""
        after = super().on(log, numbers)
        if log in self.after:
            return after
        share = 0.0 if after.structure is None else LEAST
        return super().on(log, self.nominal + share * (numbers - self.nominal))


def effect_of(hypothesis: Hypothesis) -> Hypothesis:
    """The effect of a difference, in all logs; any other hypothesis as it is."""
    return Hypothesis(hypothesis.kind, hypothesis.robot, hypothesis.location)


@dataclass(frozen=True)
class PairedColumns(Columns):
    """Columns, of which each stands a second time, for the later set alone."""

    apart: int = 0  # How far a column of the later set alone is behind that of all logs

    def at(self, hypothesis: Hypothesis, number: int) -> list[int]:
        """Indices of the columns whose sum is the derivative by a number of a hypothesis."""
        if not isinstance(hypothesis, Difference):
            return super().at(hypothesis, number)
        return [self.apart + i for i in super().at(effect_of(hypothesis), number)]


@dataclass(frozen=True)
class PairedBench(Bench):
    """A bench of two sets of logs."""

    effects: Sequence[Hypothesis] = ()  # What may act in all logs
    after: frozenset[str] = frozenset()  # Names of the later logs
    cancels: bool = False
    """Whether the model may be wrong by anything in all logs, so that differences alone are looked for."""

    @cached_property
    def kinds(self) -> dict[str, Hypothesis]:
        """A hypothesis of every effect that has columns."""
        return Bench(self.effects, self.tolerances, self.states, self.replayer).kinds

    def moved(self, intervals: Intervals, basis: Basis, acting: Acting) -> Point:
        """The point of a robot with other effects or numbers."""
        return super().moved(intervals, self.paired(basis, intervals), acting)

    def paired(self, basis: Basis, intervals: Intervals) -> Basis:
        """A basis with its columns a second time, for the later set alone, and the numbers that are off in each.

        What is off a little in every robot is so in both sets, and by a little more after. Where errors of the model
        cancel, each number may be off by anything in both sets.
        """
        columns, whitened = basis.columns, basis.whitened
        width = whitened[0].shape[3]
        is_paired = isinstance(columns, PairedColumns) and width == 2 * columns.apart
        if is_paired and self.hypotheses is basis.hypotheses:
            return basis  # by this bench
        apart = width // 2 if is_paired else width
        both = [own[..., :apart] for own in whitened]
        late = self.late_alone(both, intervals)
        narrow, deviation = self.nuisances(columns)
        of_all, sizes = narrow, deviation
        if self.cancels:
            wide = [prior_of(replace(self.kinds[key.effect], location=key.place))[key.number] for key in columns.keys]
            tail = narrow >= len(wide)
            of_all = np.concatenate([np.arange(len(wide)), narrow[tail]])
            sizes = np.concatenate([wide, deviation[tail]])
        return replace(
            basis,
            hypotheses=self.hypotheses,
            columns=PairedColumns(columns.keys, columns.values, columns.members, apart),
            whitened=[np.concatenate(pair, axis=3) for pair in zip(both, late, strict=True)],
            nuisances=np.concatenate([of_all, apart + narrow]),
            deviation=np.concatenate([sizes, deviation]),
        )

    def far(self, near: Point, looked: Sequence[str]) -> Iterator[tuple[list[tuple[Hypothesis, np.ndarray]], Whitened]]:
        """Effects in the drives far from nominal: in all logs, if these are looked for, and as differences."""
        for found, columns in super().far(near, looked):
            if not self.cancels:
                yield found, columns
            yield (
                [(Difference.of(h, self.after), numbers) for h, numbers in found],
                self.late_alone(columns, near.intervals),
            )

    def late_alone(self, columns: Whitened, intervals: Intervals) -> Whitened:
        """Columns as those of a difference: zero before."""
        of_log = np.array([own.states.log.name in self.after for own in intervals.courses])
        later = of_log[Chunks.of(intervals).log, None, None, None]
        return [np.where(later, own, own.dtype.type(0)) for own in columns]


@dataclass(frozen=True)
class PairedSearch(Search):
    """A search on two sets of logs in which errors that both share cancel."""

    def predicted(
        self, gram: np.ndarray, constant: float, nuisances: np.ndarray, rest: Posterior, whole: Posterior
    ) -> float:
        """Log probability of a fold by the rest, which tells as well what the model is wrong by in all logs, nats."""
        del gram, constant, nuisances
        return whole.evidence - rest.evidence

    def without_idle(self, found: Found) -> Found:
        """The set without differences that the others have made needless; what acts in all logs stays."""
        while len(own := differences(found)) > 1:
            members = range(len(found.members))
            fewer = [self.settle(found.with_members([k for k in members if k != m])) for m in own]
            best = max(fewer, key=lambda one: one.worth)
            if best.worth < found.worth:
                break
            found = best
        return found

    def ascend(self, now: Found) -> Found:
        """The answer from a set on, with one difference in place of two where that says as much."""
        found = super().ascend(now)
        while (better := self.merged(found)) is not found:
            found = better
        return found

    def merged(self, found: Found) -> Found:
        """The set with one difference in place of two, such as at one joint in place of all and, reversed, another."""
        for pair in combinations(differences(found), 2):
            known = {found.members[m].name for m in pair}
            kept = [k for k in range(len(found.members) + 1) if k not in pair]
            order = few_of_each([h for _, h in screen(found.point, pair)], ALIKE)
            same = [h for h in order if h.name in known]
            for h in [*same, *(h for h in order if h not in same)][:CLOSELY]:
                fewer = self.settle(self.judge(found.point, [h], pair).with_members(kept))
                if fewer.worth > found.worth:
                    self.progress(f"{h.label} in place of two changes")
                    return fewer
        return found

    def is_steady(self, found: Found, member: int) -> bool:
        """Whether a difference is larger than what it differs by from log to log within each set.

        Student's test of the share of it that acts in each log, while all that both sets share is free.
        """
        point, difference = found.point, found.members[member]
        assert isinstance(difference, Difference)
        first = sum(len(h.parameters) for h in found.members[:member])
        at = slice(first, first + len(difference.parameters))
        of_all = [
            own @ (found.numbers[at] - difference.nominal) for own in point.basis.of_hypothesis(effect_of(difference))
        ]
        courses = point.intervals.courses
        by_log = np.eye(len(courses))[Chunks.of(point.intervals).log][:, None, None, :]
        evidence = point.evidence.extended(point.whitened, [own[..., None] * by_log for own in of_all])
        (deviation, centre), acting = point.priors(), np.concatenate([n for _, n in point.acting])
        deviation[point.nuisances :][at] = ABSENT
        centre[point.nuisances :][at] = (found.numbers - acting)[at]
        wider = np.append(deviation, np.full(len(courses), SHARE)), np.append(centre, np.zeros(len(courses)))
        shares = evidence.posterior(*wider).mean[-len(courses) :]
        later = np.array([own.states.log.name in difference.after for own in courses])
        return stands_out(shares[~later], shares[later] + 1)  # the difference acts already


def stands_out(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether two sets of numbers, one a log, differ by more than each scatters, by Student's test."""
    from scipy.stats import t as student  # takes as long to import as a check takes

    freedom = len(before) + len(after) - 2
    squares = sum(float(((own - own.mean()) ** 2).sum()) for own in (before, after))
    error = np.sqrt(squares / freedom * (1 / len(before) + 1 / len(after)))
    return bool(abs(after.mean() - before.mean()) > student.ppf(0.5 + SURE / 2, freedom) * error)


def differences(found: Found) -> list[int]:
    """Indices of the members of a set that are differences."""
    return [m for m, h in enumerate(found.members) if isinstance(h, Difference)]


@dataclass(frozen=True)
class Changed:
    """One effect that acts after and not before, or by another amount."""

    label: str
    says: str  # With its numbers, after less before
    ci95: tuple[tuple[float, float], ...]  # Of each number, after less before
    rivals: tuple[str, ...]  # Other effects that could as well have changed


@dataclass(frozen=True)
class Comparison:
    """What changed between two sets of logs."""

    changed: tuple[Changed, ...]
    guesses: tuple[Changed, ...]  # What would be named, were it not for something without a name that acts in the logs
    unnamed: tuple[float, float]  # Evidence of a force without a name before and after, nats for each 0.1 s
    smallest: dict[str, str]  # Smallest change of single effects at the whole robot that these logs would have shown
    logs: tuple[int, int]
    varying: tuple[str, ...]
    """Effects that seem to differ between the sets, and differ as much from log to log within them."""

    @property
    def unknown_change(self) -> bool:
        """Whether something without a name acts after, and not before."""
        before, after = self.unnamed
        return after > UNNAMED >= before

    def to_json(self) -> dict[str, Any]:
        """All of it as JSON."""
        return {**asdict(self), "unknown_change": self.unknown_change}

    def __str__(self) -> str:
        """Lines for a person."""
        lines = [f"{self.logs[0]} logs before, {self.logs[1]} after"]
        lines += [f"changed: {', or '.join([one.says, *map(label_words, one.rivals)])}" for one in self.changed]
        if self.unknown_change:
            lines.append("changed: an unmodelled cause acts after, and not before")
        if self.varying:
            varying = ", ".join(map(effect_words, self.varying))
            lines.append(f"differs from log to log within the sets, hence no change: {varying}")
        if self.unnamed[0] > UNNAMED:
            lines.append("an unmodelled cause acts before, so that no change can be named")
        lines += [f"a guess that may stand in for it: {one.says}" for one in self.guesses]
        if not self.changed and max(self.unnamed) <= UNNAMED:
            lines.append("no change was found; these logs would have shown")
            for label, size in self.smallest.items():
                name, _, number = size.partition(" ")
                lines.append(f"  {label_words(label)} ({parameter_words(name)} {number})")
        return "\n".join(lines)


def compare_logs(
    before: Sequence[Log],
    after: Sequence[Log],
    robot: Robot,
    settings: Settings | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
) -> Comparison:
    """What changed between two sets of logs of one robot, whatever its model is wrong by in both."""
    for name, own in ((BEFORE, before), (AFTER, after)):
        if len(own) < 2:
            raise InputError(name, f"{len(own)} log", "two or more", "log further motions of the same kind")
    sets = [(f"{name}: {log.name}", log) for name, own in ((BEFORE, before), (AFTER, after)) for log in own]
    logs = [replace(log, name=name) for name, log in sets]
    bench = RefereedLogs.of("compare", logs, robot, settings or Settings(), threads).bench
    later = frozenset(log.name for log in logs[len(before) :])
    # Each fold leaves out logs of both sets.
    folds = np.concatenate([np.arange(len(before)), np.arange(len(after))]) % min(len(before), len(after), 4)
    progress(f"step 1 of 2, what acts in all logs, or after: {len(before)} logs before, {len(after)} after")
    hypotheses = [Difference.of(h, later) for h in bench.hypotheses]
    both = [*bench.hypotheses, *hypotheses]
    every = PairedBench(both, bench.tolerances, bench.states, bench.replayer, bench.hypotheses, later)
    search = Search(every, folds, progress)
    point = search.ascend(search.judge(every.nominal())).point
    progress("step 2 of 2, changes")
    varying: list[str] = []
    while True:
        left = [h for h in hypotheses if effect_of(h).name not in varying]
        most = MOST_CAUSES + len(point.acting)
        paired = PairedSearch(replace(every, hypotheses=left, cancels=True), folds, progress, most)
        acting = [one for one in point.acting if not isinstance(one[0], Difference) or one[0] in left]
        start = paired.moved(point, tuple(acting))
        start = max([start, paired.settle(start)], key=lambda one: one.evidence)
        found = paired.ascend(paired.without_idle(start))
        unsteady = [found.members[m] for m in differences(found) if not paired.is_steady(found, m)]
        if not unsteady or len(varying) >= MOST_CAUSES:
            return comparison_of(paired, found, (len(before), len(after)), tuple(varying))
        progress(f"differs from log to log: {unsteady[0].label}")
        varying.append(effect_of(unsteady[0]).name)


def comparison_of(search: PairedSearch, found: Found, logs: tuple[int, int], varying: tuple[str, ...]) -> Comparison:
    """What is reported of the differences, and what would have been."""
    parts = split_numbers(found.members, found.numbers)
    spreads = split_numbers(found.members, np.sqrt(np.diag(found.covariance)))
    losses = {m: found.loss(m) for m in differences(found) if found.departs(m)}
    changed = []
    for m in sorted(losses, key=lambda m: -losses[m]):
        h, numbers, own = effect_of(found.members[m]), parts[m], spreads[m]
        spread = 1.96 * np.hypot(own, MODEL_ERROR * np.abs(numbers - h.nominal))
        interval = tuple((float(n - s), float(n + s)) for n, s in zip(numbers - h.nominal, spread, strict=True))
        likely = [one for one in search.in_place_of(found, m) if one.evidence > found.evidence - LEAST_GAIN]
        others = few_of_each([effect_of(one.members[-1]) for one in likely], 1)
        rivals = tuple(other.label for other in others if other.label != h.label)
        changed.append(Changed(h.label, numbered(h, numbers), interval, rivals))
    blocks = found.point.evidence.blocks.log >= logs[0]
    unnamed = found.by_level.max(axis=0) - found.by_level[0]
    sides = float(unnamed[~blocks].mean()), float(unnamed[blocks].mean())
    named, guesses = (tuple(changed), ()) if max(sides) <= UNNAMED else ((), tuple(changed))
    return Comparison(named, guesses, sides, smallest(found), logs, varying)


def smallest(found: Found) -> dict[str, str]:
    """Smallest changes of effects with one number, at the whole robot, that would have gained enough to be named."""
    point, sizes = found.point, {}
    _, by_each = Projection.of(point, *point.priors()).of_columns(point.basis.whitened)
    for h in (h for h in point.basis.hypotheses if h.location == "all" and len(h.parameters) == 1):
        at = point.basis.columns.at(h, 0)
        known = float(by_each[np.ix_(at, at)].sum())
        if known > 0:
            sizes[effect_of(h)] = np.sqrt(2 * LEAST_GAIN / known)
    clear = sorted(sizes, key=lambda h: sizes[h] / abs(h.moderate[0]))
    told = {h.label: f"{h.parameters[0].name} {sizes[h]:.2g} {h.parameters[0].unit}" for h in clear[:SHOWN]}
    return {label: size.removesuffix(" 1") for label, size in told.items()}
