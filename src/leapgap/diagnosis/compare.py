"""What changed between two sets of logs of one robot: before and after a load, a repair, a specimen.

First one search looks for each effect twice, in all logs and as a difference in the later set alone, so that all is
linear about a robot near the true one. Then whatever the model may be wrong by is a column that both sets share, with
its prior, and cancels: a difference stays, or is found, where nothing shared can explain it.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import split_numbers
from leapgap.diagnosis.engine.search import LEAST_GAIN, MOST_CAUSES, UNNAMED, Found, Projection, Search, few_of_each
from leapgap.diagnosis.judge import numbered
from leapgap.diagnosis.paired_search import Difference, PairedBench, PairedSearch, differences, effect_of
from leapgap.diagnosis.refereed_logs import RefereedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.effects import effect_words, label_words, parameter_words
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

BEFORE, AFTER = "before", "after"
MODEL_ERROR = 0.08  # Relative error of a difference because the simulation differs from the robot, in its interval
SHOWN = 8  # Number of smallest changes that are reported


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
    losses = {m: found.evidence - found.evidence_without([m]) for m in differences(found) if found.departs(m)}
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
