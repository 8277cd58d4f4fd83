"""The search for the set of effects that explains the logs: forward, backward and exchange, on one evidence.

Sets are compared by what they predict of logs that they were not fitted on; the numbers of the best are replayed, and
everything is linearised about them again where much stays without a name, until nothing gains. A cause has to gain on
all logs together as well, which tell more of what the model's tolerances do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np

from leapgap.diagnosis.candidates import Candidate, clip_numbers, split_numbers
from leapgap.diagnosis.engine.evidence import Posterior, Whitened, posterior_of, predictive
from leapgap.diagnosis.engine.planted import Planted
from leapgap.diagnosis.engine.points import Acting, Bench, Point, meets_ground, on_logs
from leapgap.diagnosis.engine.pruning import needed
from leapgap.diagnosis.engine.responses import departed
from leapgap.diagnosis.engine.screening import Projection, few_of_each, screen, stretched
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.simulation_settings import SimulationSettings
from leapgap.effects.base import overrides

LEAST_GAIN = 30.0  # Evidence on held-out logs that each number of a cause has to gain, nats: g₀
LEAST_SHARE = 0.03
"""A cause gains this share of the evidence that is missing, or closes it of the gap that is left of held-out logs, or
leaves little without a name."""
SOME = 10 * LEAST_GAIN
"""Evidence of a force without a name beside a set, nats, at which further effects are replayed far from nominal."""
UNNAMED = 20.0  # Evidence of a force without a name for each block, nats, up to which a set explains the logs: u₀
MOST_CAUSES, MOST_TOGETHER = 4, 8
"""Largest number of causes that are found one by one, and that are left of all effects together."""
POOL = 60  # Number of effects that are tried all together
WORTH_A_LOOK = 5.0  # Evidence that a hypothesis has to gain by its columns to be compared closely, nats
SHORTLIST, ALIKE, CLOSELY = 10, 2, 3
"""Sets that are compared by their columns in each round, of one effect, and by replays."""
LIKELY = 0.5  # Share of the gain of the best set that another has to have by its columns to be replayed
HALF = 0.5
"""A set that leaves a larger share without a name is no answer: of the evidence, and of the gap of whole logs too where
the robot stands on no feet."""
TRIED = 12  # Number of effects that are replayed because they bring feet to the ground
FACTORS = (0.5, 0.8, 1.25, 2.0)  # Times nominal at which effects of contacts are tried
CONTACTS = (("other_cone", 1.0), ("friction_impedance", 0.1))
"""Settings of contacts with the factors by which they are tried."""
AT_LEAST = 4.0  # An effect far from nominal does what its column says times one, with this inverse variance
SETTLED = 2.0  # Numbers have settled when their next step is worth less evidence than this, nats
ROUNDS = 4  # Most rounds in which numbers settle
STRETCHES = (1.0, 2.0, 4.0, 8.0)  # Times a step of the numbers of a robot with feet that are tried


@dataclass(frozen=True)
class Found:
    """A set of effects with what the logs say of it."""

    point: Point
    members: tuple[Hypothesis, ...]
    numbers: np.ndarray
    covariance: np.ndarray
    fold_numbers: np.ndarray  # Without each fold, (folds, numbers)
    evidence: float
    predictive: float  # Log probability of each fold by the others, summed, nats
    rivals: tuple[tuple[str, Hypothesis, float], ...] = ()
    """Label of a member, what was replayed in its place as it was found, and by how much that was worth less, nats."""

    @property
    def worth(self) -> float:
        """Log probability of the folds less what the numbers of the set have to gain, nats."""
        return self.predictive - LEAST_GAIN * len(self.numbers)

    @cached_property
    def by_level(self) -> np.ndarray:
        """Log likelihood of each block at each level of the force without a name, (levels, blocks), nats."""
        evidence = self.point.evidence
        return evidence.by_level(evidence.posterior(*self.point.priors()).mean)

    @property
    def unnamed(self) -> float:
        """Evidence of a force without a name beside the set, nats: u."""
        return float((self.by_level.max(axis=0) - self.by_level[0]).sum())

    @property
    def simulation(self) -> tuple[SimulationSettings, ...]:
        """Settings of the simulation that are not the given one's."""
        return self.point.intervals.simulation

    @property
    def unexplained(self) -> bool:
        """Whether a force without a name acts."""
        return self.unnamed > UNNAMED * self.by_level.shape[1]

    @property
    def missing(self) -> float:
        """Evidence that a set without a force without a name would have beyond this one, about, nats.

        Errors of such a set are as large as expected at the least level in every block.
        """
        evidence = self.point.evidence
        rows = sum((end - first) for _, first, end in evidence.blocks.places) * self.point.own[0].shape[2]
        return float(-0.5 * (rows + evidence.blocks.constant[0].sum()) - self.by_level.max(axis=0).sum())

    def loss(self, member: int) -> float:
        """Evidence that the set loses with a member at nominal, by its linearisation, nats."""
        return self.evidence - self.point.evidence.posterior(*self.point.priors((), [member])).evidence

    def scatter(self, member: int) -> float:
        """How much more the numbers of a member differ over the logs than they should."""
        return self.point.evidence.scatter(*self.point.priors(), self.point.nuisances + self.at(member))

    def at(self, member: int) -> np.ndarray:
        """Indices of a member's numbers among those of the set."""
        return split_numbers(self.members, np.arange(len(self.numbers)))[member]

    def number_at(self, hypothesis: Hypothesis) -> np.ndarray:
        """Numbers of an effect at one place: those of the member that acts there, or nominal."""
        members = self.point.basis.columns.members
        (place,) = members[hypothesis.name, hypothesis.location]
        for h, numbers in self.acting:
            if h.name == hypothesis.name and place in members[h.name, h.location]:
                return numbers
        return hypothesis.nominal

    @property
    def acting(self) -> Acting:
        """The effects with their numbers, within their ranges; factors within reach of those of the point."""
        numbers, replayed = split_numbers(self.members, self.numbers), dict(self.point.acting)
        return tuple((h, h.near(n, replayed.get(h))) for h, n in zip(self.members, numbers, strict=True))

    def departs(self, member: int) -> bool:
        """Whether a number of a member is other than nominal within its range.

        One beyond the end at which its effect does nothing asks for the reverse of the effect, which no robot has.
        """
        h, numbers = self.acting[member]
        return bool((numbers != h.nominal).any())

    def with_members(self, kept: Sequence[int]) -> "Found":
        """The set with some of its members, not yet replayed."""
        parts = split_numbers(self.members, self.numbers)
        numbers = np.concatenate([np.zeros(0), *(parts[m] for m in kept)])
        return replace(self, members=tuple(self.members[m] for m in kept), numbers=numbers)


def candidate_of(found: Found, order: Sequence[int] | None = None) -> Candidate:
    """A set as a candidate, with its members in some order."""
    members = range(len(found.members)) if order is None else order
    at = [i for m in members for i in found.at(m)]
    hypotheses = tuple(found.members[m] for m in members)
    numbers = clip_numbers(hypotheses, found.numbers[at])
    folds = np.array([clip_numbers(hypotheses, own[at]) for own in found.fold_numbers])
    return Candidate(hypotheses, numbers, found.covariance[np.ix_(at, at)], folds)


@dataclass(frozen=True)
class Search:
    """A search on a bench."""

    bench: Bench
    folds: np.ndarray  # Fold of each log
    progress: Callable[[str], None]
    most: int = MOST_CAUSES  # Largest number of causes that are found one by one
    gap: HeldOutGap | None = None  # Of whole logs; None where replays of these are chaotic, as on feet
    left_out: tuple[str, ...] = ()  # Effects that are not looked for

    @cached_property
    def feet(self) -> Planted:
        """The feet that stand in the logs."""
        return Planted.of(self.bench.intervals)

    def explore(self) -> tuple[Found, Found]:
        """The nominal robot, and the answer.

        Where much is left unexplained of a robot without feet, the search is made once more, from all effects together
        and on from what these find. The other answer stays where it is likelier by all logs, and by those that each
        fold was not fitted on.
        """
        start = self.judge(self.bench.nominal())
        answer = self.ascend(start)
        if answer.unexplained and not self.bench.robot.stands:
            together = self.together(answer)
            other = answer if together is answer else replace(self, most=MOST_TOGETHER).ascend(together)
            if other.members and other.evidence > answer.evidence and other.worth > answer.worth:
                answer = other
        answer = self.steady(start, answer)
        if answer.simulation:
            start = self.judge(self.bench.nominal(answer.simulation)) if answer.members else answer
        return start, self.linearised_about(answer) if answer.members and answer.unnamed > SOME else answer

    def steady(self, start: Found, found: Found) -> Found:
        """A set with others in place of members that stand in for what repeats itself, and so differ over the logs.

        Of sets of which at most half stays without a name: the others are no answer.
        """
        search = self
        while found.unexplained and len(found.members) > 1:
            closure = None if self.gap is None else self.gap.closure_value(*self.gap.squares([candidate_of(found)]))
            if left_unnamed(start, found, closure) > HALF:
                break
            members = range(len(found.members))
            sure = [found.loss(m) / found.scatter(m) / len(found.members[m].parameters) for m in members]
            worst = int(np.argmin(sure))
            if sure[worst] >= LEAST_GAIN:
                break
            self.progress(f"without {found.members[worst].label}, whose numbers differ from time to time")
            search = replace(search, left_out=(*search.left_out, found.members[worst].name))
            found = search.ascend(search.settle(found.with_members([m for m in members if m != worst])))
        return found

    def ascend(self, now: Found) -> Found:
        """The answer from a set without effects on.

        What moves feet comes first where those that stand are not on the ground: there, nothing else has its contacts.
        """
        while len(now.members) < self.most:
            tried = self.planted(now) if now.unexplained and self.bench.robot.stands else []
            if all(one.worth <= now.worth for one in tried):
                tried = self.by_columns(now)
            simulated = self.otherwise_simulated(now, tried)
            if simulated is not now:
                now = replace(simulated, rivals=now.rivals)
                continue
            if not tried:
                break
            best = max(tried, key=lambda one: one.worth)
            self.progress(f"{describe(best)}: gains {best.predictive - now.predictive:.1f}")
            gained = best.evidence - now.evidence
            if best.worth <= now.worth or gained <= LEAST_GAIN * (len(best.numbers) - len(now.numbers)):
                break
            newest = best.members[-1]
            others = [(newest.label, one.members[-1], best.worth - one.worth) for one in tried if one is not best]
            rivals = (*now.rivals, *(own for own in others if own[1].name != newest.name))
            if best.unexplained:
                best = self.linearised_about(best)
            other = self.exchanged(best)
            best = self.linearised_about(other) if other is not best and best.unexplained else other
            gains_little = best.predictive - now.predictive < LEAST_SHARE * now.missing
            if best.unexplained and gains_little and not self.closes_more(now, best):
                break
            now = replace(self.without_idle(best), rivals=rivals)
        return now

    def closes_more(self, now: Found, other: Found) -> bool:
        """Whether another set closes so much more of the gap of held-out logs, as a share of what is left of it."""
        if self.gap is None or not self.gap.has_gap:
            return False
        before, after = map(self.gap.closure_value, self.gap.squares([candidate_of(now), candidate_of(other)]))
        return after - before >= LEAST_SHARE * (1 - before)

    def by_columns(self, now: Found) -> list[Found]:
        """The set with one effect more, the likeliest by columns and by replays far from nominal."""
        worth = [*stretched(now.point), *(h for gain, h in self.screened(now) if gain > WORTH_A_LOOK)]
        linear = self.judge_each(now.point, self.few_of_each(worth, ALIKE)[:SHORTLIST])
        linear.sort(key=lambda one: -one.worth)
        return self.promising(now, linear)

    def few_of_each(self, hypotheses: Sequence[Hypothesis], most: int) -> list[Hypothesis]:
        """The hypotheses that are looked for in their order, at most so many of one effect."""
        return few_of_each([h for h in hypotheses if h.name not in self.left_out], most)

    def screened(self, now: Found) -> list[tuple[float, Hypothesis]]:
        """Further hypotheses by ``screen``.

        Where an effect acts at several places by numbers of their own, it may act at others.
        """
        if len({h.name for h in now.members}) == len(now.members):
            return screen(now.point)
        places = now.point.basis.columns.members
        taken = {(h.name, place) for h in now.members for place in places[h.name, h.location]}
        return [
            (gain, h)
            for gain, h in screen(now.point, again=True)
            if not any((h.name, place) in taken for place in places[h.name, h.location])
        ]

    def together(self, now: Found) -> Found:
        """What is left of all effects at once, at every single place, without those that gain little.

        Causes that act together at several joints each look wrong alone: a force without a name has to be large beside
        any few of them, and hides the others. So all are fitted first, about a set, which stays where that explains the
        logs better. Those with states of their own take part if the set has them.
        """
        point, known = now.point, {h.name for h in now.members}
        pool = [
            h
            for _, h in screen(point, again=True)
            if len(point.basis.columns.members[h.name, h.location]) == 1 and (h.name in known or not self.has_memory(h))
        ]
        if not pool:
            return now
        acting = tuple((h, now.number_at(h)) for h in pool[:POOL])
        best = full = self.judge(self.bench.by_columns(point, acting))
        for _ in range(ROUNDS):
            full = self.judge(self.bench.by_columns(full.point, full.acting))
            best = max([best, full], key=lambda one: one.evidence)
        full = self.moved(best.point, best.acting)
        full = self.moved(full.point, full.acting)
        if full.evidence <= now.evidence:  # so far from here, columns say nothing
            return now
        kept = needed(full.point, LEAST_GAIN, MOST_TOGETHER)
        self.progress(f"together: {len(kept)} of {len(pool)} effects")
        if not kept:
            return now
        found = self.settle(self.moved(full.point, kept))
        return self.without_idle(self.linearised_about(found))

    def has_memory(self, hypothesis: Hypothesis) -> bool:
        """Whether a robot with an effect has states that the nominal one has not."""
        return self.bench.intervals.has_memory(0, departed(hypothesis, 0, self.bench.states[0].log.name))

    def promising(self, now: Found, linear: Sequence[Found]) -> list[Found]:
        """Those sets, settled, that may gain most by what their columns say, the best first.

        Where little is left without a name columns are right but for contacts, and if no set gains by them, none does.
        Else sets are judged by replays at the numbers that their columns give, and drives far from nominal as well. A
        further set is settled if it may gain half of what the first may.
        """
        gains = [one.worth - now.worth for one in linear]
        sets = [one.acting for one in linear]
        looks_far, nearer = now.unnamed > SOME or max(gains, default=0.0) > 0, []
        if looks_far or self.bench.robot.stands:
            part = self.part(now.point)
            nearer = self.touching(now, part)
        if looks_far:
            looked = ("all", *(one.members[-1].location for one in linear[:1]))
            far = [[(*now.acting, one) for one in pair] for pair in self.far(part, tuple(dict.fromkeys(looked)))]
            glanced = iter(self.glances(part, now.acting, [*(own for pair in far for own in pair), *sets]))
            drives = [max([(next(glanced), own) for own in pair], key=itemgetter(0)) for pair in far]
            gains = list(map(max, gains, glanced))
            nearer = [*drives, *nearer]
        gains += [gain for gain, _ in nearer]
        sets += [own for _, own in nearer]
        found: list[Found] = []
        for k in np.argsort(-np.array(gains), kind="stable")[:CLOSELY]:
            if gains[k] <= LIKELY * max(gains):
                break
            found.append(self.settle(linear[k] if k < len(linear) else self.moved(now.point, sets[k])))
        return found

    def part(self, point: Point) -> Point:
        """The point by the chunks that tell what is worth a closer look."""
        chosen = self.bench.some
        return point if chosen.all() else point.part(self.bench.chunks, chosen)

    def glances(self, part: Point, acting: Acting, sets: Sequence[Acting]) -> list[float]:
        """Evidence that robots with other effects at just some numbers gain, as of all logs, nats."""
        (base, *found), share = self.bench.glances(part, [acting, *sets]), self.bench.some.mean()
        return [(one - base) / share for one in found]

    def far(self, part: Point, looked: Sequence[str]) -> list[Acting]:
        """Effects in the drives with numbers far from nominal that by their columns gain most, two numbers of each.

        A robot with feet is replayed with each at the places that are ``looked`` at.
        The second departs from nominal by as many times the first as the errors hold its column.
        """
        left = Projection.of(part, *part.priors())
        gains: list[tuple[float, Hypothesis, np.ndarray, float]] = []
        for found, columns in self.bench.far(part, looked):
            by_errors, by_each = left.of_columns(columns)
            inner = by_each.diagonal() + AT_LEAST
            times = (by_errors + AT_LEAST) / inner
            of_each = 0.5 * times**2 * inner - 0.5 * AT_LEAST
            gains += [(float(gain), *one, float(own)) for gain, one, own in zip(of_each, found, times, strict=True)]
        gains.sort(key=lambda one: -one[0])
        best = {h.label: (h, numbers, times) for gain, h, numbers, times in reversed(gains) if gain > WORTH_A_LOOK}
        few = self.few_of_each([h for gain, h, *_ in gains if gain > WORTH_A_LOOK], 2 * ALIKE)
        labels = list(dict.fromkeys(h.label for h in few))[:SHORTLIST]
        return [
            ((h, numbers), (h, h.near(h.nominal + times * (numbers - h.nominal), numbers)))
            for h, numbers, times in map(best.__getitem__, labels)
        ]

    def touching(self, now: Found, part: Point) -> list[tuple[float, Acting]]:
        """The set with an effect of the feet's contacts at the likeliest of several numbers and places, and its gain.

        Contacts are far from linear: a foot that sinks in further meets the ground earlier.
        """
        known, found = {*self.left_out, *(h.name for h in now.members)}, []
        for h in self.bench.hypotheses if self.bench.robot.stands else ():
            if h.location != "all" or h.name in known or not changes_contacts(h):
                continue
            sets = [(*now.acting, (h, h.nominal * by)) for by in FACTORS]
            gain, best = max(zip(self.glances(part, now.acting, sets), sets, strict=True), key=itemgetter(0))
            if gain > LEAST_GAIN:
                places = [one for one in self.bench.hypotheses if one.name == h.name and one is not h]
                sets = [(*now.acting, (one, best[-1][1])) for one in places]
                pairs = [(gain, best), *zip(self.glances(part, now.acting, sets), sets, strict=True)]
                found.append(max(pairs, key=itemgetter(0)))
        return found

    def otherwise_simulated(self, now: Found, tried: Sequence[Found]) -> Found:
        """The same set by other contacts of the simulation, where these gain more than sets that were tried.

        No robot is as its simulation in how contacts are computed. What a friction cone or an impedance changes at the
        edge of slipping is far from linear: where softer friction helps at a glance, everything is linearised anew.
        """
        if not (now.unexplained and self.bench.robot.stands):
            return now
        (settings,) = now.simulation or (SimulationSettings(),)
        others = [
            now.point.intervals.simulated_by((settings.changed(name, by),))
            for name, by in CONTACTS
            if not settings.has(name)
        ]
        if not others:
            return now
        gains = [one.predictive - now.predictive for one in tried]
        softer = replace(now.point, intervals=others[-1])
        by_given, by_softer = (self.bench.glances(one, [now.acting])[0] for one in (now.point, softer))
        if by_softer - by_given <= max([LEAST_GAIN, *(LIKELY * own for own in gains)]):
            return now
        linearised = (self.bench.linearised(own, now.acting, now.point.basis) for own in others)
        best = min([now, *map(self.judge, linearised)], key=lambda one: one.unnamed)
        if best is now or best.evidence - now.evidence <= max([SOME, *gains]):
            return now
        self.progress(f"contacts by {best.simulation[0].in_words}: unexplained {now.unnamed:.0f} to {best.unnamed:.0f}")
        return best

    def judge(
        self,
        point: Point,
        further: Sequence[Hypothesis] = (),
        without: Sequence[int] = (),
        whitened: Whitened | None = None,
        drawn: Sequence[float] = (),
    ) -> Found:
        """What the logs say of a point's set, and further effects, with the levels that suit it.

        Its members are ``drawn`` to nominal by shares of their prior deviations; none: by all of them.
        """
        priors, first = point.priors(further, without, drawn), point.nuisances
        evidence = point.evidence_with(further, whitened).at_best_levels(*priors)
        whole = evidence.posterior(*priors)
        at = np.concatenate([np.zeros(0), *(n for _, n in point.acting), *(h.nominal for h in further)])
        members = (*(h for h, _ in point.acting), *further)
        own, spread = at + whole.mean[first:], whole.covariance[first:, first:]
        held_out, folds, lost = 0.0, [], lost_in_range(members, own, spread)
        of_folds, (gram, constant) = evidence.of_each(self.folds[evidence.blocks.log]), evidence.total()
        for of_fold, own_constant in of_folds:
            rest = posterior_of(gram - of_fold, constant - own_constant, *priors)
            held_out += self.predicted(of_fold, own_constant, priors[0][:first], rest, whole)
            folds.append(rest.mean[first:])
        judged = replace(point, evidence=replace(point.evidence, levels=evidence.levels))
        of_folds_at = at + np.array(folds)
        return Found(judged, members, own, spread, of_folds_at, whole.evidence - lost, held_out - lost)

    def judge_each(self, point: Point, further: Sequence[Hypothesis], without: Sequence[int] = ()) -> list[Found]:
        """What the logs say of a point's set with each of some further effects, by all threads."""
        whitened = point.whitened
        return self.bench.intervals.each(further, lambda h: self.judge(point, [h], without, whitened))

    def predicted(
        self, gram: np.ndarray, constant: float, nuisances: np.ndarray, rest: Posterior, whole: Posterior
    ) -> float:
        """Log probability of a fold, by its inner products, with numbers by the ``rest`` of the logs, nats.

        ``nuisances`` are their prior deviations: no other log tells anything of them. ``whole`` is by all logs.
        """
        del whole
        first = len(nuisances)
        told = Posterior(0.0, rest.mean[first:], rest.covariance[first:, first:])
        return predictive(gram, constant, nuisances, told)

    def moved(self, near: Point, acting: Acting) -> Found:
        """A set at some numbers, replayed."""
        return self.judge(self.bench.moved(near.intervals, near.basis, acting))

    def settle(self, found: Found) -> Found:
        """The set at the numbers that its own replays give."""
        for _ in range(ROUNDS if found.members else 0):
            acting = found.acting
            before = np.concatenate([n for _, n in acting])
            found = self.moved(found.point, acting)
            found = self.stretched_step(found, before) if self.bench.robot.stands else found
            step = found.numbers - before
            if 0.5 * step @ np.linalg.solve(found.covariance, step) < SETTLED:
                break
        return found

    def stretched_step(self, found: Found, before: np.ndarray) -> Found:
        """A set with its next numbers as many steps from those ``before`` as gains most: contacts make steps short."""
        others = [replace(found, numbers=before + by * (found.numbers - before)) for by in STRETCHES]
        sets = [one.acting for one in others]
        gains = self.evidence_at(found, sets[:2])
        if gains[1] > gains[0]:
            gains += self.evidence_at(found, sets[2:])
        return others[int(np.argmax(gains))]

    def evidence_at(self, found: Found, sets: Sequence[Acting]) -> list[float]:
        """Evidence of a set at other numbers, exactly, each block at its level, nats."""
        return self.bench.glances(found.point, sets, found.point.evidence.levels)

    def planted(self, now: Found) -> list[Found]:
        """The set with one effect more by which feet that stand are on the ground, which columns tell little of.

        A foot that is reported in the air, or deep in the ground, has another contact than the robot's.
        """
        acting, known = on_logs(now.point.intervals, now.point.acting), {h.name for h in now.members}
        moving = [h for h in self.bench.hypotheses if moves_feet(h) and h.name not in known]
        near = {h: numbers for gain, h, numbers in self.feet.numbers(acting, moving) if gain > SOME}
        tried = self.few_of_each([*near], ALIKE)[:TRIED]
        sets = [(*now.point.acting, (h, self.feet.numbers_about(acting, h, near[h])[1])) for h in tried]
        trials = list(zip(self.glances(self.part(now.point), now.point.acting, sets), sets, strict=True))
        trials.sort(key=lambda pair: -pair[0])
        return [self.settle(self.moved(now.point, acting)) for _, acting in trials[:2]]

    def linearised(self, found: Found) -> Found:
        """The set with everything linearised about it."""
        point = found.point
        return self.settle(self.judge(self.bench.linearised(point.intervals, point.acting, point.basis)))

    def linearised_about(self, found: Found) -> Found:
        """A set with everything linearised about it, where that leaves less unexplained."""
        if [h.label for h, _ in found.point.basis.about] == [h.label for h in found.members]:
            return found
        return min([found, self.linearised(found)], key=lambda one: one.unnamed)

    def exchanged(self, found: Found) -> Found:
        """The set with one member in place of another, where that predicts the logs better."""
        part = self.part(found.point)
        for m in range(len(found.members)):
            order = [k if k != m else len(found.members) for k in range(len(found.members))]
            likely = [one for one in self.in_place_of(found, m)[:CLOSELY] if one.worth > found.worth]
            for linear in (one.with_members(order) for one in likely):
                if self.glances(part, found.acting, [linear.acting])[0] < 0:
                    continue
                other = self.settle(linear)
                self.progress(f"{other.members[m].label} for {found.members[m].label}: {other.worth - found.worth:.1f}")
                if other.worth > found.worth:
                    found = other
                    break
        return found

    def in_place_of(self, found: Found, member: int) -> list[Found]:
        """The set with the likeliest effects by their columns in place of a member, which is taken back to nominal."""
        likely = self.few_of_each([h for _, h in screen(found.point, [member], again=True)], ALIKE)[:SHORTLIST]
        return sorted(self.judge_each(found.point, likely, [member]), key=lambda one: -one.evidence)

    def without_idle(self, found: Found) -> Found:
        """The set without members that the others have made needless."""
        while len(found.members) > 1:
            members = range(len(found.members))
            sizes = [LEAST_GAIN * len(h.parameters) for h in found.members]
            others = [self.judge(found.point, (), [m]) for m in members]
            losses = [
                min(found.predictive - one.predictive, found.evidence - one.evidence) - size
                for one, size in zip(others, sizes, strict=True)
            ]
            least = int(np.argmin(losses))
            if losses[least] > 0:
                break
            fewer = self.settle(found.with_members([m for m in members if m != least]))
            if fewer.worth < found.worth:
                break
            self.progress(f"without {found.members[least].label}")
            found = fewer
        return found


def left_unnamed(start: Found, found: Found, closure: float | None) -> float:
    """Share of what is to be explained that a set leaves without a name, where something unknown acts.

    Of the evidence, or of the gap of whole logs where that is less; None for ``closure`` where whole logs are chaotic.
    """
    gained, missing = max(found.predictive - start.predictive, 0.0), max(found.missing, 0.0)
    share = missing / (gained + missing) if missing else 0.0
    return share if closure is None else float(np.clip(1 - closure, 0.0, share))


def lost_in_range(hypotheses: Sequence[Hypothesis], numbers: np.ndarray, covariance: np.ndarray) -> float:
    """Evidence that is lost where numbers by columns are held at the ends of their ranges, nats."""
    beyond = numbers - clip_numbers(hypotheses, numbers)
    out = np.flatnonzero(beyond)
    return float(0.5 * beyond[out] @ np.linalg.solve(covariance[np.ix_(out, out)], beyond[out]))


def changes_contacts(hypothesis: Hypothesis) -> bool:
    """Whether an effect is of the contacts of feet, and not of the ground under them."""
    return hypothesis.kind.places == "feet" and not overrides(hypothesis.kind, "change_spec")


def moves_feet(hypothesis: Hypothesis) -> bool:
    """Whether an effect moves the feet as they are reported, or the ground under them."""
    return overrides(hypothesis.kind, "change_measured") or meets_ground(hypothesis.kind)


def describe(found: Found) -> str:
    """The set in words: ``payload 1.7 + joint_damping at elbow 0.4``."""
    numbers = split_numbers(found.members, found.numbers)
    parts = zip(found.members, numbers, strict=True)
    return " + ".join(f"{h.label} {' '.join(f'{n:.4g}' for n in own)}" for h, own in parts)
