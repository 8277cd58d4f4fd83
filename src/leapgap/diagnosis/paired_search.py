"""The engine on two sets of logs: each effect may act in all logs, or as a difference in the later set alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from leapgap.diagnosis.engine.evidence import Posterior, Whitened
from leapgap.diagnosis.engine.intervals import Intervals
from leapgap.diagnosis.engine.points import ABSENT, Acting, Basis, Bench, Point, prior_of
from leapgap.diagnosis.engine.responses import Columns
from leapgap.diagnosis.engine.search import ALIKE, CLOSELY, Found, Search, few_of_each, screen
from leapgap.diagnosis.engine.whitening import Chunks
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.effects.base import Effect

SURE = 0.99  # Probability that a difference is no chance of logs that differ among themselves
LEAST = 1e-9  # Share of a difference that acts before, where it needs further parts of the model
SHARE = 3.0  # Prior standard deviation of the share of a difference that acts in a log


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

    def far(
        self, near: Point, looked: Sequence[str] = ("all",)
    ) -> Iterator[tuple[list[tuple[Hypothesis, np.ndarray]], Whitened]]:
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
