"""What changed between two sets of logs of one robot: before and after a load, a repair, a specimen.

Errors of the model that both sets share are columns that both share, with wide priors, so that they cancel. A
difference is a column of the later set alone, with a narrow prior: it is named where nothing shared can explain it.
Errors that a search finds in all logs act in the replays, so that all is linear about a robot near the true one.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import split_numbers
from leapgap.diagnosis.engine.search import LEAST_GAIN, MOST_CAUSES, Search, few_of_each
from leapgap.diagnosis.engine.verdict import UNNAMED
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.judge import numbered
from leapgap.diagnosis.paired_evidence import Paired
from leapgap.diagnosis.refereed_logs import RefereedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

BEFORE, AFTER = "before", "after"
CLOSELY = 3
"""Number of differences that are replayed in each round."""
ROUNDS = 3
"""Most rounds in which the numbers of differences settle."""
SETTLED = 0.2
"""Numbers have settled when none moves by more than this share of its standard deviation."""
MODEL_ERROR = 0.08
"""Relative error of a difference because the simulation differs from the robot, in its interval."""
SURE = 0.99
"""Probability that a difference is no chance of logs that differ among themselves."""
SHOWN = 8
"""Number of smallest changes that are told."""


@dataclass(frozen=True)
class Difference(Hypothesis):
    """An effect that acts on the later logs alone."""

    after: frozenset[str] = field(default=frozenset(), compare=False)

    @staticmethod
    def of(hypothesis: Hypothesis, after: frozenset[str]) -> "Difference":
        """The difference by a hypothesis."""
        return Difference(hypothesis.kind, hypothesis.robot, hypothesis.location, None, after)

    def on(self, log: str, numbers: np.ndarray) -> Effect:
        """The effect on one log: nominal before."""
        return super().on(log, numbers if log in self.after else self.nominal)


@dataclass(frozen=True)
class Told:
    """Differences with what the logs say of them."""

    paired: Paired
    members: tuple[Hypothesis, ...]
    """What acts in all logs, and differences."""
    numbers: np.ndarray
    covariance: np.ndarray
    worth: float
    """Log probability of each fold by the others, summed, less what each number has to gain, nats."""

    @staticmethod
    def of(paired: Paired, further: Sequence[Hypothesis] = ()) -> "Told":
        """The numbers of the acting and of further differences."""
        sums = paired.sums(further)
        paired = paired.with_levels(sums)
        whole, first = paired.posterior(sums), paired.shared + len(paired.point.basis.deviation)
        held_out = [paired.posterior(sums, paired.folds != fold).evidence for fold in np.unique(paired.folds)]
        acting = paired.point.acting
        at = np.concatenate([np.zeros(0), *(n for _, n in acting), *(h.nominal for h in further)])
        members = (*(h for h, _ in acting), *further)
        worth = sum(whole.evidence - one for one in held_out) - LEAST_GAIN * len(at)
        return Told(paired, members, at + whole.mean[first:], whole.covariance[first:, first:], worth)

    def settled(self) -> "Told":
        """The same at the numbers that its own replays give."""
        found = self
        for _ in range(ROUNDS):
            parts = split_numbers(found.members, found.numbers)
            acting = tuple((h, h.clip(n)) for h, n in zip(found.members, parts, strict=True))
            before = np.concatenate([n for _, n in acting])
            found = Told.of(found.paired.moved(acting))
            spread = np.sqrt(np.diag(found.covariance))
            if (np.abs(found.numbers - before) <= SETTLED * spread + 1e-3 * np.abs(before)).all():
                break
        return found

    def gains(self, hypotheses: Sequence[Hypothesis], without: Sequence[int] = ()) -> list[tuple[float, Hypothesis]]:
        """Evidence that each further difference alone would gain, nats, the best first; in closed form."""
        paired, left = self.paired, self.left(without)
        size = paired.point.evidence.gram.shape[2] - 1
        found = []
        for h in hypotheses:
            part = np.zeros((len(left) - 1, len(h.parameters)))
            for k, own in enumerate(np.abs(h.moderate)):
                part[[size + i for i in paired.point.basis.columns.at(h, k)], k] = own
            normal, slope = np.eye(part.shape[1]) + part.T @ left[1:, 1:] @ part, part.T @ left[1:, 0]
            gain = 0.5 * slope @ np.linalg.solve(normal, slope) - 0.5 * np.linalg.slogdet(normal)[1]
            found.append((float(gain), h))
        return sorted(found, key=lambda pair: -pair[0])

    def left(self, without: Sequence[int] = ()) -> np.ndarray:
        """Inner products less what the shared columns, nuisances and acting differences can do for them."""
        paired, evidence = self.paired, self.paired.point.evidence
        transform, deviation, centre = paired.sums((), without)
        gram = paired.extended(evidence.total(), evidence.total(paired.after)[0])
        shifted = np.eye(len(gram))
        shifted[1:, 0] = -(transform @ centre)
        gram = shifted.T @ gram @ shifted
        scaled = transform * deviation
        cross = gram[:, 1:] @ scaled
        normal = np.eye(len(deviation)) + scaled.T @ gram[1:, 1:] @ scaled
        return np.asarray(gram - cross @ np.linalg.solve(normal, cross.T))

    def without_idle(self) -> "Told":
        """The same without differences that the others have made needless."""
        found = self
        while len(found.differences) > 1:
            parts = list(zip(found.members, split_numbers(found.members, found.numbers), strict=True))
            fewer = [[(h, h.clip(n)) for k, (h, n) in enumerate(parts) if k != m] for m in found.differences]
            best = max((Told.of(found.paired.moved(tuple(one))) for one in fewer), key=lambda one: one.worth)
            if best.worth < found.worth:
                break
            found = best
        return found

    @property
    def differences(self) -> list[int]:
        """Indices of the members that are differences."""
        return [m for m, h in enumerate(self.members) if isinstance(h, Difference)]

    def is_steady(self) -> bool:
        """Whether the newest difference is larger than what it differs by from log to log within each set.

        Student's test of the share of it that acts in each log.
        """
        paired, h = self.paired, self.members[-1]
        numbers = split_numbers(self.members, self.numbers)[-1] - h.nominal
        weights = np.zeros(paired.shared)
        for k, number in enumerate(numbers):
            weights[paired.point.basis.columns.at(h, k)] += number
        shares = paired.by_log(weights, slice(-len(numbers), None))
        logs = paired.point.evidence.blocks.log
        later = np.array([paired.after[logs == log].all() for log in range(len(shares))])
        return stands_out(shares[~later], shares[later] + 1)  # the difference acts already

    def rivals(self, member: int, hypotheses: Sequence[Hypothesis]) -> tuple[str, ...]:
        """Effects that could as well have changed in place of a member."""
        paired, own = self.paired, self.members[member]
        lost = paired.posterior(paired.sums()).evidence - paired.posterior(paired.sums((), [member])).evidence
        near = [h for gain, h in self.gains(hypotheses, [member]) if gain > lost - LEAST_GAIN and h.label != own.label]
        return tuple(h.label for h in few_of_each(near, 1))


def stands_out(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether two sets of numbers, one a log, differ by more than each scatters, by Student's test."""
    from scipy.stats import t as student  # takes as long to import as a check takes

    freedom = len(before) + len(after) - 2
    squares = sum(float(((own - own.mean()) ** 2).sum()) for own in (before, after))
    error = np.sqrt(squares / freedom * (1 / len(before) + 1 / len(after)))
    return bool(abs(after.mean() - before.mean()) > student.ppf(0.5 + SURE / 2, freedom) * error)


@dataclass(frozen=True)
class Changed:
    """One effect that acts after and not before, or by another amount."""

    label: str
    says: str
    """With its numbers, after less before."""
    ci95: tuple[tuple[float, float], ...]
    """Of each number, after less before."""
    rivals: tuple[str, ...]
    """Other effects that could as well have changed."""


@dataclass(frozen=True)
class Comparison:
    """What changed between two sets of logs."""

    changed: tuple[Changed, ...]
    guesses: tuple[Changed, ...]
    """What would be named, were it not for something without a name that acts in the logs."""
    unnamed: tuple[float, float]
    """Evidence of a force without a name before and after, nats for each 0.1 s."""
    smallest: dict[str, str]
    """Smallest change of single effects at the whole robot that these logs would have shown."""
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
        lines += [f"changed: {', or '.join([one.says, *one.rivals])}" for one in self.changed]
        if self.unknown_change:
            lines.append("changed: an unmodelled cause acts after, and not before")
        if self.varying:
            lines.append(f"differs from log to log within the sets, hence no change: {', '.join(self.varying)}")
        if self.unnamed[0] > UNNAMED:
            lines.append("an unmodelled cause acts before, so that no change can be named")
        lines += [f"a guess that may stand in for it: {one.says}" for one in self.guesses]
        if not self.changed and max(self.unnamed) <= UNNAMED:
            lines.append("no change was found; these logs would have shown")
            lines += [f"  {label} ({size})" for label, size in self.smallest.items()]
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
    of = RefereedLogs.of("compare", logs, robot, settings or Settings(), threads)
    progress(f"step 1 of 2, what all logs share: {len(before)} logs before, {len(after)} after")
    nominal = of.bench.nominal()
    later = nominal.evidence.blocks.log >= len(before)
    # Each fold leaves out logs of both sets.
    fold = np.concatenate([np.arange(len(before)), np.arange(len(after))]) % min(len(before), len(after), 4)
    shared = Search(of.bench, of.folds, lambda line: progress(f"in all logs: {line}"))
    point = shared.ascend(shared.judge(nominal)).point
    told = Told.of(Paired(of.bench, point, later, fold[point.evidence.blocks.log]).with_all())
    names = frozenset(log.name for log in logs[len(before) :])
    differences = [Difference.of(h, names) for h in of.bench.hypotheses]
    varying: list[str] = []
    progress("step 2 of 2, changes")
    while len(told.differences) < MOST_CAUSES and len(varying) < MOST_CAUSES:
        known = {told.members[m].label for m in told.differences}
        left = [h for h in differences if h.label not in known and h.name not in varying]
        worth = [h for gain, h in told.gains(left) if gain > LEAST_GAIN]
        linear = [Told.of(told.paired, [h]) for h in few_of_each(worth, 2)[: 2 * CLOSELY]]
        tried = [one.settled() for one in sorted(linear, key=lambda one: -one.worth)[:CLOSELY]]
        best = max(tried, key=lambda one: one.worth, default=told)
        if best.worth <= told.worth:
            break
        if not best.is_steady():
            progress(f"differs from log to log: {best.members[-1].label}")
            varying.append(best.members[-1].name)
            continue
        progress(f"changed: {best.members[-1].label}")
        told = best.without_idle()
    return comparison_of(told, differences, (len(before), len(after)), tuple(varying))


def comparison_of(
    told: Told, differences: Sequence[Difference], logs: tuple[int, int], varying: tuple[str, ...]
) -> Comparison:
    """What is told of the differences, and what would have been told."""
    paired, parts = told.paired, split_numbers(told.members, told.numbers)
    spreads = split_numbers(told.members, np.sqrt(np.diag(told.covariance)))
    changed = []
    for m in told.differences:
        h, numbers, own = told.members[m], parts[m], spreads[m]
        spread = 1.96 * np.hypot(own, MODEL_ERROR * np.abs(numbers - h.nominal))
        interval = tuple((float(n - s), float(n + s)) for n, s in zip(numbers - h.nominal, spread, strict=True))
        changed.append(Changed(h.label, numbered(h, numbers), interval, told.rivals(m, differences)))
    by_level = paired.by_level(paired.sums())
    unnamed = by_level.max(axis=0) - by_level[0]
    sides = tuple(float(unnamed[of].mean()) for of in (~paired.after, paired.after))
    named, guesses = (tuple(changed), ()) if max(sides) <= UNNAMED else ((), tuple(changed))
    return Comparison(named, guesses, sides, smallest(told, differences), logs, varying)  # type: ignore[arg-type]


def smallest(told: Told, differences: Sequence[Difference]) -> dict[str, str]:
    """Smallest changes of effects with one number, at the whole robot, that would have gained enough to be named."""
    left, size, found = told.left(), told.paired.point.evidence.gram.shape[2] - 1, {}
    for h in (h for h in differences if h.location == "all" and len(h.parameters) == 1):
        part = np.zeros(len(left) - 1)
        part[[size + i for i in told.paired.point.basis.columns.at(h, 0)]] = 1
        known = float(part @ left[1:, 1:] @ part)
        if known > 0:
            found[h] = np.sqrt(2 * LEAST_GAIN / known)
    clear = sorted(found, key=lambda h: found[h] / abs(h.moderate[0]))
    sizes = {h.label: f"{h.parameters[0].name} {found[h]:.2g} {h.parameters[0].unit}" for h in clear[:SHOWN]}
    return {label: size.removesuffix(" 1") for label, size in sizes.items()}
