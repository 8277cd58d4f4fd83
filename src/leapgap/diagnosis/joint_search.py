"""Which effects stay of a fit of all together: what does not matter is taken away while the simulation gets no worse.

Logs by their own clock and others are searched in two ways. Beside a clock, effects act at all places. Elsewhere they
have numbers of their own at the parts of a robot.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.candidates import Candidate, in_words
from leapgap.diagnosis.full_rollouts import FullRolloutCause, FullRolloutFit
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.joint_fit import JointFit, cost_of_others, part, where_others_are_nominal
from leapgap.diagnosis.joint_sets import at_all_places, at_parts, merge_alike, numbers_at

REPLAYED = 4
"""So many effects, those that matter least by the curvature, are taken away in turn by replays."""
PROMISING = 5.0
"""An effect is tried in the place of another where that costs less by the curvature, in ``least_gain``."""
IDLE = 0.5
"""An effect without which the logarithm of the likelihood falls by less, by the curvature, is not replayed for that."""
CONVERGED = 0.5
"""The last fit has converged when the logarithm of its likelihood rises by less than this."""
REPLACED = 2
"""So many sets with one other effect in the place of two are fitted."""
EXCHANGED = 2
"""So many times at most is an effect exchanged for a likelier one, or for one of fewer numbers."""
NUMBER = 3.0
"""What each number of an effect must gain in the logarithm of the likelihood beside an effect of fewer: half the
logarithm of some 400 independent values (Schwarz's criterion)."""
FLAT, AFAR = 0.95, 12
"""A number of which logs leave a larger share of its spread near nominal is tried at so many values over its range."""
KNOWN = 0.5
"""Pieces tell a number where its spread after them is a smaller share of the one before."""


def search_jointly(
    joint: JointFit, hypotheses: Sequence[Hypothesis], found: Candidate | None = None, none_gap: float = 0.0
) -> tuple[list[FullRolloutCause], JointFit]:
    """Fit all effects, take away those that do not matter, and return the rest, what matters most first.

    Beside them is the fit that judged them, by the steps of the simulation that all effects together tell.

    ``found`` is what a search one by one has found; in parts of the robot, effects act at its places and start from its
    numbers. ``none_gap`` is the largest gap, in noise floors, that noise and tolerances explain.
    """
    if joint.in_parts:
        last = [h for h in hypotheses if h.name in joint.last]
        hypotheses = [h for h in hypotheses if h not in last]
        every = at_parts(hypotheses, found.hypotheses if found else ())
        # From the nominal robot a fit may end at one that moves alike, with all torques, masses and friction smaller by
        # one factor: it starts where a search one by one has ended.
        start = numbers_at(every, found)
        near = joint.fit(every, start, joint.plan.first_steps, whole=False)
        if not joint.steps_known:
            told = joint.by_steps_of(near)
            joint = told or joint.by_usual_steps()
            near = near if told else joint.fit(every, start, joint.plan.first_steps, whole=False)
        return SearchInParts(joint, last).search(hypotheses, near, found, none_gap), joint
    return SearchBesideClock(joint).search(hypotheses), joint


@dataclass(frozen=True)
class JointSearch:
    """What both searches share.

    Short pieces answer almost linearly: effects that they tell to be absent go first, by the curvature. Whole logs
    answer to large changes in ways that no curvature tells, so that replays judge the others.
    """

    joint: JointFit

    def reduced(self, fit: FullRolloutFit) -> FullRolloutFit:
        """The fit of the effects of another one that matter and help on held-out logs."""
        plan = self.joint.plan
        kept = self.without_idle(fit, self.replayed_losses_without, plan.least_gain, plan.most_causes)
        fit = self.fit_part(fit, kept)
        useful = self.without_useless(fit)
        if len(useful) < len(fit.hypotheses):
            again = self.fit_part(fit, useful)
            if self.joint.closes(fit) - self.joint.closes(again) < plan.most_lost:
                fit = again
        return fit

    def fit_part(self, fit: FullRolloutFit, kept: Sequence[int]) -> FullRolloutFit:
        """Some of the effects of a fit, fitted again from their numbers in it."""
        hypotheses = tuple(fit.hypotheses[k] for k in kept)
        numbers = np.concatenate([fit.split()[k] for k in kept])
        again = self.joint.fit(hypotheses, numbers, self.joint.plan.steps)
        closes = self.joint.closes(again)
        self.joint.progress(f"jointly, {in_words(again)}: explains {closes:.2f}, loss {again.loss:.0f}")
        return again

    def without_idle(
        self,
        fit: FullRolloutFit,
        losses_without: Callable[[FullRolloutFit, Sequence[int]], np.ndarray],
        least: float,
        most: int | None = None,
        among: Sequence[int] | None = None,
    ) -> list[int]:
        """Indices of at most so many hypotheses without each of which the likelihood falls by ``least`` or more.

        The one that matters least goes first. Those that evidence tells stay and are not counted; so do those that are
        not ``among`` the ones in question.
        """
        kept = list(range(len(fit.hypotheses)))
        stay = [self.joint.is_told(h) or (among is not None and k not in among) for k, h in enumerate(fit.hypotheses)]
        while (open_to_doubt := [k for k in kept if not stay[k]]) and len(kept) > 1:
            losses = dict(zip(kept, losses_without(fit, kept), strict=True))
            idlest = min(open_to_doubt, key=lambda k: losses[k])
            if losses[idlest] >= least and (most is None or len(open_to_doubt) <= most):
                break
            kept.remove(idlest)
        return kept

    def without_useless(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses that help on held-out logs, or that evidence tells; what helps least goes first."""
        kept, draws = list(range(len(fit.hypotheses))), self.joint.judging.draws
        while len(kept) > 1:
            open_to_doubt = [k for k in kept if not self.joint.is_told(fit.hypotheses[k])]
            tried = [part(fit, kept), *(part(fit, [other for other in kept if other != k]) for k in open_to_doubt)]
            whole, *without = [squares[draws].sum(axis=1) for squares in self.joint.judging.squares(tried)]
            sure = [float((whole < own).mean()) for own in without]
            if not sure or min(sure) >= self.joint.plan.least_useful:
                break
            kept.remove(open_to_doubt[int(np.argmin(sure))])
        return kept

    def losses_without(self, fit: FullRolloutFit, kept: Sequence[int]) -> np.ndarray:
        """Fall of the logarithm of the likelihood without each of the kept hypotheses, the others fitted anew.

        By the curvature at the fit; hypotheses that are not kept are nominal.
        """
        own, shift, inner = where_others_are_nominal(fit, kept)
        departs = fit.departs[own] + shift
        ends = np.cumsum([0, *(len(fit.hypotheses[k].parameters) for k in kept)])
        at = [list(range(begin, end)) for begin, end in itertools.pairwise(ends)]
        return np.array([0.5 * departs[i] @ np.linalg.solve(inner[np.ix_(i, i)], departs[i]) for i in at])

    def replayed_losses_without(self, fit: FullRolloutFit, kept: Sequence[int]) -> np.ndarray:
        """As ``losses_without``, by replays where the others are at their numbers by the curvature.

        Only the few that may matter least by the curvature are replayed; the others count as needed.
        """
        losses = dict(zip(kept, self.losses_without(fit, kept), strict=True))
        open_to_doubt = [k for k in kept if not self.joint.is_told(fit.hypotheses[k])]
        doubtful = sorted(open_to_doubt, key=lambda k: losses[k])[:REPLAYED]
        tried = [part(fit, kept), *(part(fit, [other for other in kept if other != k]) for k in doubtful)]
        whole, *without = [self.joint.loss_at(one) for one in tried]
        found = dict(zip(doubtful, without, strict=True))
        return np.array([found.get(k, np.inf) - whole for k in kept])

    def ordered(self, fit: FullRolloutFit, rivals: Mapping[str, str]) -> list[FullRolloutCause]:
        """The causes of a fit, what matters most first, each with the fit of those up to it and its rival.

        The probability of a cause is the share of resampled logs on which the whole set is better than without it.
        """
        kept = list(range(len(fit.hypotheses)))
        last_first = []
        while len(kept) > 1:
            last_first.append(kept.pop(int(np.argmin(self.losses_without(fit, kept)))))
        order = [*kept, *reversed(last_first)]
        without = [part(fit, [k for k in order if k != one]) for one in order] if len(order) > 1 else []
        judging = self.joint.judging
        sure = [judging.share_better(fit.heldout, own) for own in judging.squares(without)]
        whole = part(fit, order)
        steps = [part(fit, order[: k + 1]) for k in range(len(order) - 1)] + [whole]
        return [
            FullRolloutCause(step, (step.names[-1], *filter(None, [rivals.get(step.names[-1])])), probability)
            for step, probability in zip(steps, sure or [1.0], strict=True)
        ]


@dataclass(frozen=True)
class SearchBesideClock(JointSearch):
    """The search in logs by their own clock."""

    def search(self, hypotheses: Sequence[Hypothesis]) -> list[FullRolloutCause]:
        """The causes, what matters most first."""
        return self.ordered(self.reduced(self.fit_beside_clock(at_all_places(hypotheses))), {})

    def fit_beside_clock(self, every: tuple[Hypothesis, ...]) -> FullRolloutFit:
        """The fit of all effects but those that short pieces tell to be absent."""
        near = self.joint.fit(every, self.joint.numbers(every).centre, self.joint.plan.first_steps, whole=False)
        near = part(
            near, self.without_idle(near, self.losses_without, self.joint.plan.least_sign, among=self.told_by(near))
        )
        self.joint.progress(f"by short segments, {in_words(near)}")
        return self.joint.fit(near.hypotheses, near.numbers, self.joint.plan.all_steps)

    def told_by(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses of which a fit knows each number much better than it was known before."""
        spread = np.sqrt(np.diag(fit.covariance)) / self.joint.numbers(fit.hypotheses).spread
        return [k for k, (begin, end) in enumerate(itertools.pairwise(fit.ends)) if spread[begin:end].max() < KNOWN]


@dataclass(frozen=True)
class SearchInParts(JointSearch):
    """The search in logs that need no clock of their own."""

    last: Sequence[Hypothesis] = ()
    """Effects that are looked for beside the causes of this search: each can do what several do."""

    def search(
        self, hypotheses: Sequence[Hypothesis], near: FullRolloutFit, found: Candidate | None, none_gap: float
    ) -> list[FullRolloutCause]:
        """The causes, what matters most first, each with its rival; ``near`` is the fit of all to short pieces."""
        every = self.fit_in_parts(hypotheses, near)
        fit = self.reduced(part(every, self.without_idle(every, self.losses_without, IDLE)))
        fit = self.with_one_for_two(every, self.without_small(fit, none_gap), found)
        fit, rivals = self.with_exchanges(fit, hypotheses, none_gap)
        if (simpler := self.with_one_for_several(fit, none_gap)) is not None:
            fit, rivals = self.with_exchanges(simpler, [*hypotheses, *self.last], none_gap)
        return self.ordered(self.without_opposites(fit), rivals)

    def fit_in_parts(self, hypotheses: Sequence[Hypothesis], near: FullRolloutFit) -> FullRolloutFit:
        """The fit of all effects, with one number for the whole robot where its parts need none of their own."""
        every = near.hypotheses
        fit = self.joint.fit(every, near.numbers, self.joint.plan.all_steps)
        kept, numbers = merge_alike(fit, hypotheses, self.joint.plan.least_gain)
        if len(kept) < len(every):
            fit = self.joint.fit(kept, numbers, self.joint.plan.steps)
        if (far := self.from_afar(fit)) is not None:
            fit = self.joint.fit(fit.hypotheses, far, self.joint.plan.steps)
        if len(lasting := self.lasting(fit)) < len(fit.hypotheses):
            own = part(fit, lasting)
            fit = self.joint.fit(own.hypotheses, own.numbers, self.joint.plan.steps)
        self.joint.progress(f"all effects, {in_words(fit)}: explains {self.joint.closes(fit):.2f}")
        return fit

    def from_afar(self, fit: FullRolloutFit) -> np.ndarray | None:
        """The numbers of a fit with one far from nominal that is likelier, (numbers,); None where there is none.

        What limits a motor does nothing until the motor meets it, so that no derivative at nominal leads there.
        """
        about = self.joint.numbers(fit.hypotheses)
        spread = np.sqrt(np.diag(fit.covariance)) / about.spread
        nominal = np.concatenate([h.nominal for h in fit.hypotheses])
        flat = (spread > FLAT) & np.isclose(fit.numbers, nominal) & (about.limits == nominal).any(axis=0)
        tried = []
        for k in np.flatnonzero(flat & about.fitted):
            for value in np.linspace(about.limits[0, k], about.limits[1, k], AFAR + 1):
                if value != nominal[k]:
                    numbers = fit.numbers.copy()
                    numbers[k] = value
                    tried.append(numbers)
        best = min(self.joint.tried(about, tried, True), key=lambda one: one.loss, default=None) if tried else None
        return None if best is None or best.loss > fit.loss - self.joint.plan.least_gain else best.numbers

    def without_small(self, fit: FullRolloutFit, none_gap: float) -> FullRolloutFit:
        """The fit without causes that close little which the others, fitted again, do not close as well.

        A small cause stays where it closes more than is left with it, and noise does not explain what is left without;
        where short pieces, which tell it, make it much of what the likelihood rises by; and on a held robot where it
        surely helps, if it is within its range: at the end of one it stands for another.
        """
        while (fewer := self.with_one_less(fit, none_gap)) is not None:
            fit = fewer
        return self.joint.fit(fit.hypotheses, fit.numbers, self.joint.plan.steps, settled=CONVERGED)

    def with_one_less(self, fit: FullRolloutFit, none_gap: float) -> FullRolloutFit | None:
        """The fit without a cause that closes little; what seems to close least is tried first. None: all stay."""
        gap, plan, each = self.joint.judging, self.joint.plan, range(len(fit.hypotheses))
        if len(each) == 1:
            return None
        rests = [[other for other in each if other != k] for k in each]
        closes = [gap.closure_value(squares) for squares in gap.squares([part(fit, rest) for rest in rests])]
        for k in sorted(each, key=lambda k: -closes[k]):
            again = self.fit_part(fit, rests[k])
            lost, left = self.joint.closes(fit) - self.joint.closes(again), 1 - self.joint.closes(fit)
            by_noise = gap.gap(again.heldout) <= none_gap * gap.gap(gap.floor)
            share = (again.loss - fit.loss) / (self.joint.nominal_loss - fit.loss)
            self.joint.progress(f"without {fit.names[k]}: explains {lost:.2f} less, {share:.0%} of the likelihood")
            small = lost < plan.least_part and share < plan.least_share and (lost <= left or by_noise)
            at_end = fit.hypotheses[k].at_bound(fit.split()[k])
            if small and (at_end or not self.surely_helps(fit, again)):
                return again
        return None

    def surely_helps(self, fit: FullRolloutFit, without: FullRolloutFit) -> bool:
        """Whether a cause of a held robot is clearly likelier than none, and held-out logs are surely nearer with it.

        Whole logs of a robot with a free base part ways at a landing, so that small causes are told by no such logs.
        """
        gap, plan = self.joint.judging, self.joint.plan
        likelier = gap.is_of_held_robot and without.loss - fit.loss >= plan.least_likelier
        return likelier and gap.share_better(fit.heldout, without.heldout) >= plan.least_sure

    def with_one_for_two(self, every: FullRolloutFit, fit: FullRolloutFit, found: Candidate | None) -> FullRolloutFit:
        """The fit with one other effect in the place of two, where that is likelier by what a cause must gain.

        Two effects together may do what one does, and effects are taken away one by one. By the curvature at the fit of
        all effects, ``every``, the most promising are fitted, and with them what a search one by one has ``found``.
        """
        kept = [every.hypotheses.index(h) for h in fit.hypotheses]
        others = [k for k, h in enumerate(every.hypotheses) if h.name not in fit.names]
        pairs = itertools.combinations(kept, 2)
        sets = [[*(k for k in kept if k not in pair), other] for pair in pairs for other in others]
        sets.sort(key=lambda some: cost_of_others(every, some))
        before = () if found is None else found.names
        tried = [*sets[:REPLACED], *[some for some in sets if every.names[some[-1]] in before][:1]]
        fits = [self.fit_part(every, some) for some in {tuple(some): some for some in tried}.values()]
        simpler = min(fits, key=lambda one: one.loss, default=fit)
        return simpler if simpler.loss < fit.loss + self.joint.plan.least_gain else fit

    def with_one_for_several(self, fit: FullRolloutFit, none_gap: float) -> FullRolloutFit | None:
        """The fit with an effect that is looked for last, which leaves no more causes and closes clearly more.

        None where there is none. In the fit of all effects such a one would hide others, since it can do what they do.
        """
        parts, plan, closed = at_parts(self.last), self.joint.plan, self.joint.closes(fit)
        if not parts or closed > 1 - plan.least_part:
            return None
        absent = [h.nominal for h in parts]
        wide = self.joint.fit((*fit.hypotheses, *parts), np.concatenate([fit.numbers, *absent]), plan.all_steps)
        again = self.reduced(part(wide, self.without_idle(wide, self.losses_without, IDLE)))
        again = self.without_small(again, none_gap)
        clearer = self.joint.closes(again) - closed >= plan.least_part
        return again if clearer and len(again.hypotheses) <= len(fit.hypotheses) else None

    def with_exchanges(
        self, fit: FullRolloutFit, hypotheses: Sequence[Hypothesis], none_gap: float
    ) -> tuple[FullRolloutFit, dict[str, str]]:
        """The fit with another effect in the place of one while that is likelier, and the rivals of those that stay.

        An effect of fewer numbers takes the place of one that gains too little by more of them. A fit of all effects
        lies where several share what one does, so that its curvature shows the last ones taken away as needed. A rival
        is as likely in the place of an effect, or closes as much of held-out logs' gap.
        """
        plan, exchanged = self.joint.plan, 0
        while True:
            others = {name: self.with_other(fit, name, hypotheses) for name in dict.fromkeys(fit.names)}
            loss, closes = self.joint.loss_at(fit), self.joint.closes(fit)
            tried = {name: again for name, again in others.items() if again is not None}
            best = min(tried.values(), key=with_numbers, default=fit)
            fewer = len(best.numbers) < len(fit.numbers) and with_numbers(best) < loss + NUMBER * len(fit.numbers)
            if exchanged == EXCHANGED or not (fewer or best.loss <= loss - plan.least_gain):
                break
            fit, exchanged = self.without_small(best, none_gap), exchanged + 1
        equal = {
            name: again
            for name, again in tried.items()
            if again.loss < loss + plan.least_gain or self.joint.closes(again) > closes - plan.most_lost
        }
        return fit, {name: again.names[-1] for name, again in equal.items()}

    def with_other(self, fit: FullRolloutFit, name: str, hypotheses: Sequence[Hypothesis]) -> FullRolloutFit | None:
        """The fit with the most promising other effect in the place of one, everywhere or where that one acts.

        None where none is promising, by derivatives where the one is absent.
        """
        rest = [k for k, own in enumerate(fit.names) if own != name]
        of = [k for k, own in enumerate(fit.names) if own == name]
        places = {"all", *(fit.hypotheses[k].location for k in of)}
        others = [h for h in hypotheses if h.name not in fit.names and h.location in places and h.per_log is None]
        stays = part(fit, rest)
        wide = (*stays.hypotheses, *(fit.hypotheses[k] for k in of), *others)
        absent = [h.nominal for h in wide[len(rest) :]]
        near = self.joint.fit(wide, np.concatenate([stays.numbers, *absent]), 1)
        kept, first = list(range(len(rest))), len(rest) + len(of)
        costs = {k: cost_of_others(near, [*kept, k]) for k in range(first, len(wide))}
        other = min(costs, key=lambda k: costs[k], default=None)
        own = cost_of_others(near, list(range(first)))
        if other is None or costs[other] - own > PROMISING * self.joint.plan.least_gain:
            return None
        start = part(near, [*kept, other])
        again = self.joint.fit(start.hypotheses, start.numbers, self.joint.plan.steps)
        if len(self.lasting(again)) < len(again.hypotheses):
            return None
        closes = self.joint.closes(again)
        self.joint.progress(f"{wide[other].label} for {name}: loss {again.loss:.0f}, explains {closes:.2f}")
        return again

    def without_opposites(self, fit: FullRolloutFit) -> FullRolloutFit:
        """The fit without the one of two effects against each other that is needed less, the others fitted anew."""
        while (pair := self.opposites(fit)) is not None:
            each = range(len(fit.hypotheses))
            fit = min((self.fit_part(fit, [k for k in each if k != one]) for one in pair), key=lambda one: one.loss)
        return fit

    def opposites(self, fit: FullRolloutFit) -> tuple[int, int] | None:
        """Indices of two effects of a fit that act against each other; None where no two do."""
        effects = fit.typical_effects(self.joint.heldout_gap.names)
        pairs = itertools.permutations(range(len(effects)), 2)
        return next((p for p in pairs if effects[p[0]].is_against(effects[p[1]], fit.hypotheses[p[0]].robot)), None)

    def lasting(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the effects of a fit that the others do not undo."""
        effects = fit.typical_effects(self.joint.heldout_gap.names)
        return [k for k, one in enumerate(effects) if not one.is_undone_by(effects, fit.hypotheses[k].robot)]


def with_numbers(fit: FullRolloutFit) -> float:
    """Minus the logarithm of the likelihood, and what the numbers of a fit must gain."""
    return fit.loss + NUMBER * len(fit.numbers)
