"""The search for the set of effects that explains the logs: forward, backward and exchange, on one evidence.

A *point* is a robot with some effects at some numbers, with everything linearised about it. Sets are compared by what
they predict of logs that they were not fitted on; the numbers of the best are replayed and linearised about again until
nothing changes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap import effects
from leapgap.diagnosis.channels import tangent_difference
from leapgap.diagnosis.engine.evidence import BLOCK_S, Evidence, Posterior, inner_products, posterior_of
from leapgap.diagnosis.engine.intervals import Effects, Intervals
from leapgap.diagnosis.engine.responses import Columns, Linearisation
from leapgap.diagnosis.engine.whitening import WRONG_ZERO_RAD, Chunks, Filter, filters_of, follow, linearise
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.effects.base import overrides
from leapgap.diagnosis.sensitivities import tolerance, usable
from leapgap.logs.state import States
from leapgap.simulation.replay import Replayer

INTERVAL_S = 0.01
"""Length of an interval; one row, where that is longer."""
MOST_INTERVALS = 2500
"""Intervals of a robot without contacts become longer where there would be more of them."""
LEAST_IN_BLOCK = 5
"""Number of intervals of a block at least."""
FINE = 0.255
"""Steps of the finer simulation as a share of the usual: what they change is a nuisance."""
PRIOR = 3.0
"""Standard deviation of a number's prior in moderate departures."""
LEAST_GAIN = 30.0
"""Evidence on held-out logs that a cause has to gain, nats."""
MOST_CAUSES = 4
LEAST_SHARE = 0.2
"""A cause takes this share of the evidence of a force without a name, or leaves little of it."""
MUCH = 1000.0
"""Evidence of a force without a name beside a set, nats, at which everything is linearised anew about it."""
WORTH_A_LOOK = 5.0
"""Evidence that a hypothesis has to gain by its columns to be compared closely, nats."""
TRIED = 12
"""Number of effects that are replayed to both sides where columns tell little."""
SHORTLIST = 6
"""Number of sets that are compared closely in each round."""
SETTLED = 0.2
"""Numbers have settled when none moves by more than this share of its standard deviation."""
ROUNDS = 4

SMALL = {
    "encoder_bias.bias_rad": 5e-4,
    "leg_geometry.hip_x_m": 5e-4,
    "leg_geometry.upper_m": 5e-4,
    "leg_geometry.lower_m": 5e-4,
    "ground_height.height_m": 5e-4,
    "torque_gain.scale": 0.005,
    "foot_compliance.time_constant_s": 0.002,
    "position_gain.scale": 0.01,
    "velocity_gain.scale": 0.03,
    "link_com.outward_m": 1e-3,
    "link_inertia.scale": 0.02,
}
"""Further tolerances, in the unit of the number: no robot is built, and no floor laid, more exactly."""
LATE = ("command_delay", "state_latency")
QUARTER = 0.25
"""Share of a row by which it is not known when commands act and states are measured."""

Acting = tuple[tuple[Hypothesis, np.ndarray], ...]


@dataclass(frozen=True)
class Point:
    """A robot with some effects, linearised."""

    acting: Acting
    intervals: Intervals
    whitened: list[np.ndarray]
    """Errors, then all columns, of each level: (chunks, longest, channels, 1 + columns)."""
    evidence: Evidence


@dataclass(frozen=True)
class Found:
    """A set of effects with what the logs say of it."""

    point: Point
    members: tuple[Hypothesis, ...]
    numbers: np.ndarray
    covariance: np.ndarray
    fold_numbers: np.ndarray
    """Without each fold, (folds, numbers)."""
    evidence: float
    predictive: float
    """Log probability of each fold by the others, summed, nats."""


@dataclass
class Workbench:
    """All that is common to the points of a search."""

    hypotheses: Sequence[Hypothesis]
    tolerances: Mapping[str, float]
    folds: np.ndarray
    """Fold of each log."""
    progress: Callable[[str], None]
    columns: Columns | None = None

    def begin(self, states: Sequence[States], replayer: Replayer) -> Point:
        """Linearise about the nominal robot."""
        self.robot = replayer.robot
        seconds = sum(float(own.log.time[-1]) for own in states)
        longest = 0.0 if self.robot.has_free_base else seconds / MOST_INTERVALS
        intervals = Intervals.of(states, replayer, max(INTERVAL_S, longest))
        self.per_block = max(LEAST_IN_BLOCK, round(BLOCK_S / intervals.interval_s))
        self.chunks = Chunks.of([own.intervals for own in intervals.courses])
        self.kinds = {h.name: h for h in reversed(self.hypotheses)}
        known = effects.known()
        for name in {key.partition(".")[0] for key in self.tolerances} - set(self.kinds):
            if usable(known[name], self.robot):
                self.kinds[name] = Hypothesis(known[name], self.robot)
        self.transitions: Sequence[np.ndarray] = [
            np.zeros((own.intervals, 2 * self.robot.model.nv, 2 * self.robot.model.nv)) for own in intervals.courses
        ]
        return self.linearise(intervals, ())

    def explore(self, states: Sequence[States], replayer: Replayer) -> list[Found]:
        """The sets found on the way from the nominal robot to the answer.

        Where a robot with feet leaves much unexplained, the search is made once more from references that allow for
        wrong zeros of its joints, and the likelier of both answers stays.
        """
        start = self.begin(states, replayer)
        path = self.search(start)
        if not self.robot.feet or self.unnamed(path[-1]) < MUCH:
            return path
        kept = dict(self.__dict__)
        free = self.search(self.linearise(start.intervals, (), WRONG_ZERO_RAD), replay=True)
        if free[-1].members and free[-1].evidence > path[-1].evidence:
            return [path[0], *free[1:]]
        self.__dict__.update(kept)
        return path

    def linearise(self, intervals: Intervals, acting: Acting, wrong_zero: float = 0.0) -> Point:
        """The point of a robot with some effects, with everything linearised about it.

        ``wrong_zero``, rad, as in ``whitening.linearise``.
        """
        offsets = intervals.remembered(self.transitions)
        intervals, linearisation = linearise(intervals, self.chunks, offsets, wrong_zero)
        self.linearisation, self.transitions = linearisation, linearisation.transitions
        self.filters = filters_of(intervals, linearisation, self.chunks)
        present = [h.name for h, _ in acting]
        self.columns = Columns.of(intervals, linearisation, list(self.kinds.values()), self.columns, present)
        self.nuisances(intervals)
        steps = self.steps(intervals)
        raw = [np.concatenate(pair, axis=2) for pair in zip(self.columns.values, steps, strict=True)]
        stacked = self.chunks.stack(raw)
        whitened = [np.concatenate([self.errors(intervals, own), -own.whiten(stacked)], axis=3) for own in self.filters]
        return self.move(Point((), intervals, whitened, self.products(whitened)), acting)

    def nuisances(self, intervals: Intervals) -> None:
        """Columns and standard deviations of what is off a little in every robot and simulation."""
        columns, deviation = [], []
        for name, share in {**self.tolerances, **SMALL}.items():
            effect, _, parameter = name.partition(".")
            for i, key in enumerate(self.columns.keys):
                if key.effect == effect and effect in self.kinds and self.kinds[effect].parameters[key.number].name == parameter:
                    kind = self.kinds[effect].kind
                    size = share if name in SMALL else tolerance(kind, self.robot, key.place, parameter, share)
                    if size > 0:
                        columns.append(i)
                        deviation.append(size)
        late = QUARTER * intervals.courses[0].states.log.info.sample_period_s
        together = [[i] for i in columns]
        for name in LATE:
            if name in self.kinds:
                h = replace(self.kinds[name], location="all")
                together.append(self.columns.at(h, 0))
                deviation.append(late)
        together.append([len(self.columns.keys)])  # finer steps
        deviation.append(1.0)
        self.nuisance_transform = np.zeros((len(self.columns.keys) + 1, len(together)))
        for k, at in enumerate(together):
            self.nuisance_transform[at, k] = 1
        self.nuisance_deviation = np.array(deviation)

    def steps(self, intervals: Intervals) -> list[np.ndarray]:
        """What finer steps of the simulation change, (intervals, 2 nv, 1) a log."""
        replayer = intervals.replayer
        fine = intervals.with_replayer(replayer.with_steps(FINE * replayer.largest_step_s))
        pairs = zip(fine.predicted, intervals.predicted, strict=True)
        return [tangent_difference(a, b, self.robot)[:, :, None] for a, b in pairs]

    def errors(self, intervals: Intervals, of: Filter) -> np.ndarray:
        """Whitened errors, (chunks, longest, channels, 1)."""
        steps = self.chunks.stack(intervals.defects(self.transitions))[..., None]
        measured = self.chunks.stack(intervals.innovations())[..., None]
        return of.whiten(steps, measured)

    def products(self, whitened: Sequence[np.ndarray]) -> Evidence:
        """Inner products of whitened errors and columns."""
        determinants = [own.log_determinant for own in self.filters]
        return inner_products(whitened, determinants, self.chunks.valid, self.chunks.log, self.per_block)

    def effects_of(self, acting: Acting, log: str) -> Effects:
        """The effects of a set on one log."""
        return tuple(h.on(log, numbers) for h, numbers in acting)

    def followed(self, near: Point, acting: Acting) -> Intervals:
        """The intervals of a robot with other effects, with references that follow the logs."""
        names = [course.states.log.name for course in near.intervals.courses]
        here = replace(near.intervals, acting=tuple(self.effects_of(acting, name) for name in names))
        return follow(here, self.chunks, here.remembered(self.transitions), self.linearisation)

    def glance(self, near: Point, acting: Acting) -> float:
        """Evidence of a robot with some effects at just these numbers, nats, without columns of its effects."""
        here = self.followed(near, acting)
        used = self.nuisance_transform.any(axis=1)
        whitened = [
            np.concatenate([self.errors(here, of), w[..., 1 : 1 + len(used)][..., used]], axis=3)
            for of, w in zip(self.filters, near.whitened, strict=True)
        ]
        evidence = self.products(whitened)
        evidence.levels = near.evidence.levels.copy()
        prior = self.nuisance_transform[used], self.nuisance_deviation, np.zeros(len(self.nuisance_deviation))
        evidence.choose_levels(*prior)
        return evidence.posterior(*prior).evidence

    def move(self, near: Point, acting: Acting) -> Point:
        """The point of a robot with other effects or numbers: replayed, with the columns of its effects made anew."""
        if not acting and not near.acting:
            return near
        here = self.followed(near, acting)
        names = [course.states.log.name for course in here.courses]
        sets, at, sizes = [], [], []
        for m, (h, numbers) in enumerate(acting):
            for k, size in enumerate(self.small_steps(h, numbers)):
                changed = numbers.copy()
                changed[k] += size
                other = (*acting[:m], (h, changed), *acting[m + 1 :])
                sets.append([self.effects_of(other, name) for name in names])
                sizes.append(size)
                at.append((m, k))
        changes = here.changes(sets, self.transitions)
        raw = [
            np.stack([changes[j][log] / size for j, size in enumerate(sizes)], axis=2)
            if sizes
            else np.zeros((course.intervals, 2 * self.robot.model.nv, 0))
            for log, course in enumerate(here.courses)
        ]
        stacked = self.chunks.stack(raw)
        base = len(self.columns.keys) + 2
        whitened = [
            np.concatenate([self.errors(here, of), w[..., 1:base], -of.whiten(stacked)], axis=3)
            for of, w in zip(self.filters, near.whitened, strict=True)
        ]
        evidence = self.products(whitened)
        evidence.levels = near.evidence.levels.copy()
        return Point(acting, here, whitened, evidence)

    def small_steps(self, h: Hypothesis, numbers: np.ndarray) -> list[float]:
        """Departures by which numbers are differenced: a tenth of a moderate one, within the range."""
        found = []
        lower, upper = h.bounds
        for k, size in enumerate(0.1 * h.moderate):
            inside = lower[k] <= numbers[k] + size <= upper[k]
            found.append(float(size if inside else -size))
        return found

    def transform(self, point: Point, further: Sequence[Hypothesis] = (), without: Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Sums of columns, prior deviations and prior means of nuisances, the point's own numbers, and further effects.

        Numbers are departures from the point's. Members ``without`` are taken back to nominal.
        """
        columns = point.evidence.gram.shape[2] - 1
        parts = [np.pad(self.nuisance_transform, ((0, columns - len(self.nuisance_transform)), (0, 0)))]
        deviation, centre = [*self.nuisance_deviation], [0.0] * len(self.nuisance_deviation)
        own = len(self.columns.keys) + 1
        for m, (h, numbers) in enumerate(point.acting):
            for k in range(len(h.parameters)):
                part = np.zeros((columns, 1))
                part[own, 0] = 1
                own += 1
                parts.append(part)
                deviation.append(1e-9 if m in without else PRIOR * abs(h.moderate[k]))
                centre.append(h.nominal[k] - numbers[k])
        for h in further:
            for k in range(len(h.parameters)):
                part = np.zeros((columns, 1))
                part[self.columns.at(h, k), 0] = 1
                parts.append(part)
                deviation.append(PRIOR * abs(h.moderate[k]))
                centre.append(0.0)
        return np.concatenate(parts, axis=1), np.array(deviation), np.array(centre), len(self.nuisance_deviation)

    def screen(self, point: Point, without: Sequence[int] = ()) -> list[tuple[float, Hypothesis]]:
        """Evidence that each hypothesis alone would gain at the levels as they are, the best first."""
        transform, deviation, centre, _ = self.transform(point, (), without)
        gram, _ = point.evidence.total()
        shifted = shift(gram, transform @ centre)
        scaled = transform * deviation
        inner = np.eye(len(deviation)) + scaled.T @ shifted[1:, 1:] @ scaled
        half = np.linalg.solve(inner, scaled.T @ np.concatenate([shifted[1:, :1], shifted[1:, 1:]], axis=1))
        cross = shifted[1:, 1:] @ scaled
        left = shifted[1:, 1:] - cross @ half[:, 1:]
        slope = shifted[1:, 0] - cross @ half[:, 0]
        present = {h.name for m, (h, _) in enumerate(point.acting) if m not in without}
        same = {h.label for h, _ in point.acting}
        found = []
        for h in self.hypotheses:
            if h.name in present or h.label in same:
                continue
            at = [self.columns.at(h, k) for k in range(len(h.parameters))]
            size = PRIOR * np.abs(h.moderate)
            v = np.array([slope[i].sum() for i in at]) * size
            g = np.array([[left[np.ix_(i, j)].sum() for j in at] for i in at]) * size[:, None] * size
            normal = np.eye(len(at)) + g
            best = np.linalg.solve(normal, v)
            numbers = h.clip(h.nominal + best * size)
            allowed = (numbers - h.nominal) / size
            gain = v @ allowed - 0.5 * allowed @ normal @ allowed - 0.5 * np.linalg.slogdet(normal)[1]
            found.append((float(gain), h))
        return sorted(found, key=lambda pair: -pair[0])

    def judge(self, point: Point, further: Sequence[Hypothesis] = (), without: Sequence[int] = (), levels: bool = True) -> Found:
        """What the logs say of a point's set, and further effects, with the levels that suit it."""
        transform, deviation, centre, first = self.transform(point, further, without)
        evidence = replace(point.evidence, levels=point.evidence.levels.copy())
        if levels:
            evidence.choose_levels(transform, deviation, centre)
        whole = evidence.posterior(transform, deviation, centre)
        predictive, folds = 0.0, []
        for fold in range(int(self.folds.max()) + 1):
            rest = self.folds[evidence.log_of_block] != fold
            other = evidence.posterior(transform, deviation, centre, evidence.total(rest))
            predictive += whole.evidence - other.evidence
            folds.append(other.mean[first:])
        at = np.concatenate([np.zeros(0), *(n for _, n in point.acting), *(h.nominal for h in further)])
        members = (*(h for h, _ in point.acting), *further)
        return Found(
            replace(point, evidence=evidence), members, at + whole.mean[first:], whole.covariance[first:, first:],
            at + np.array(folds), whole.evidence, predictive,
        )

    def settle(self, found: Found) -> Found:
        """The set at the numbers that its own replays give."""
        for _ in range(ROUNDS):
            numbers = split(found.members, found.numbers)
            acting = tuple((h, h.clip(n)) for h, n in zip(found.members, numbers, strict=True))
            before = np.concatenate([n for _, n in acting]) if acting else np.zeros(0)
            point = self.move(found.point, acting)
            found = self.judge(point)
            spread = np.sqrt(np.diag(found.covariance))
            if not acting or (np.abs(found.numbers - before) <= SETTLED * spread + 1e-3 * np.abs(before)).all():
                break
        return found

    def search(self, start: Point, replay: bool = False) -> list[Found]:
        """The sets found on the way, the first without effects, the last the answer.

        With ``replay`` the first effect may be one whose columns tell little.
        """
        path = [self.judge(start)]
        while len(path) <= MOST_CAUSES:
            now = path[-1]
            shortlist = few_of_each([h for gain, h in self.screen(now.point) if gain > WORTH_A_LOOK], 2)[:SHORTLIST]
            linear = sorted((self.judge(now.point, [h]) for h in shortlist), key=lambda one: -one.predictive)
            tried = [self.settle(one) for one in linear[:3]]
            tried = [one for one in tried if np.isfinite(one.predictive)]
            if not tried:
                break
            best = max(tried, key=lambda one: one.predictive)
            if replay and not now.members:
                tried += self.tried_in_full(now)
                best = max(tried, key=lambda one: one.predictive)
            self.progress(
                f"{describe(best)}: gains {best.predictive - now.predictive:.1f}, "
                + ", ".join(f"{one.members[-1].label} {one.predictive - now.predictive:.1f}" for one in linear)
            )
            if best.predictive - now.predictive < LEAST_GAIN:
                break
            if self.unnamed(best) > MUCH:
                best = self.exchanged(self.relinearised(best))
            if self.unnamed(best) > max(MUCH, (1 - LEAST_SHARE) * self.unnamed(now)):
                break  # it takes next to nothing of what has no name
            path.append(self.without_idle(best))
        return path

    def tried_in_full(self, now: Found) -> list[Found]:
        """The set with one effect more whose columns tell little, since it moves feet into the ground or out of it.

        Those that columns like best are replayed at moderate size to both sides, and the best two fitted.
        """
        shortlist = few_of_each([h for _, h in self.screen(now.point) if moves_contacts(h)], 2)[:TRIED]
        trials = []
        for h in shortlist:
            for side in (1.0, -1.0):
                numbers = h.nominal + side * h.moderate
                if h.allows(numbers):
                    acting = (*now.point.acting, (h, numbers))
                    trials.append((self.glance(now.point, acting), acting))
        trials.sort(key=lambda pair: -pair[0])
        self.progress("replayed: " + ", ".join(f"{describe_acting(a[-1:])} {e - now.evidence:.0f}" for e, a in trials[:6]))
        return [self.settle(self.judge(self.move(now.point, acting))) for _, acting in trials[:2]]

    def relinearised(self, found: Found) -> Found:
        """The set with everything linearised about it."""
        return self.settle(self.judge(self.linearise(found.point.intervals, found.point.acting)))

    def exchanged(self, found: Found) -> Found:
        """The set with one member in place of another, where that predicts the logs better."""
        for m in range(len(found.members)):
            own = found.point
            kept, less = found.evidence, self.evidence_without(found, [m])
            for gain, h in self.screen(own, [m])[:2]:
                if gain + less < kept + LEAST_GAIN / 2 and gain + less < kept - 200:
                    continue
                linear = self.judge(own, [h], [m])
                members = (*found.members[:m], h, *found.members[m + 1 :])
                numbers = split(linear.members, linear.numbers)
                ordered = np.concatenate([*numbers[:m], numbers[-1], *numbers[m + 1 : -1]])
                other = self.settle(replace(linear, members=members, numbers=ordered))
                self.progress(f"{h.label} for {found.members[m].label}: {other.predictive - found.predictive:.1f}")
                if other.predictive > found.predictive + 1.0:
                    found = other
                    break
        return found

    def without_idle(self, found: Found) -> Found:
        """The set without members that the others have made needless."""
        while len(found.members) > 1:
            losses = [found.predictive - self.judge(found.point, (), [m]).predictive for m in range(len(found.members))]
            least = int(np.argmin(losses))
            if losses[least] >= LEAST_GAIN:
                break
            acting = found.point.acting
            fewer = self.settle(replace(found, members=tuple(h for m, h in enumerate(found.members) if m != least),
                numbers=np.concatenate([n for m, n in enumerate(split(found.members, found.numbers)) if m != least])))
            if found.predictive - fewer.predictive >= LEAST_GAIN:
                break
            self.progress(f"without {acting[least][0].label}: loses {found.predictive - fewer.predictive:.1f}")
            found = fewer
        return found

    def evidence_without(self, found: Found, members: Sequence[int]) -> float:
        """Evidence of a set with some members at nominal, by its linearisation, nats."""
        return found.point.evidence.posterior(*self.transform(found.point, (), members)[:3]).evidence

    def unnamed(self, found: Found) -> float:
        """Evidence of a force without a name beside a set, nats."""
        transform, deviation, centre, _ = self.transform(found.point)
        mean = found.point.evidence.posterior(transform, deviation, centre).mean
        by_level = found.point.evidence.by_level(transform @ mean)
        return float((by_level.max(axis=0) - by_level[0]).sum())


def few_of_each(hypotheses: Sequence[Hypothesis], most: int) -> list[Hypothesis]:
    """The hypotheses in their order, at most so many of one effect."""
    seen: dict[str, int] = {}
    found = []
    for h in hypotheses:
        seen[h.name] = seen.get(h.name, 0) + 1
        if seen[h.name] <= most:
            found.append(h)
    return found


def moves_contacts(hypothesis: Hypothesis) -> bool:
    """Whether an effect moves the contacts of a robot with feet."""
    kind = hypothesis.kind
    measured = overrides(kind, "change_measured")
    return hypothesis.robot.has_free_base and (measured or kind.places == "feet" or kind.name == "ground_slope")


def shift(gram: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Inner products with the errors (column 0) less ``weights`` of the columns."""
    change = np.eye(len(gram))
    change[1:, 0] = -weights
    return np.asarray(change.T @ gram @ change)


def split(members: Sequence[Hypothesis], numbers: np.ndarray) -> list[np.ndarray]:
    """Numbers of each member."""
    return np.split(numbers, np.cumsum([len(h.parameters) for h in members])[:-1]) if members else []


def describe(found: Found) -> str:
    """The set in words: ``payload 1.7 + joint_damping at elbow 0.4``."""
    return describe_acting(tuple(zip(found.members, split(found.members, found.numbers), strict=True)))


def describe_acting(acting: Acting) -> str:
    """Effects with numbers in words."""
    return " + ".join(f"{h.label} {' '.join(f'{n:.4g}' for n in own)}" for h, own in acting)
