"""Which effects stay of a fit of all: what does not matter is taken away while the simulation gets no worse."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leapgap.diagnosis.candidates import in_words
from leapgap.diagnosis.full_rollouts import FullRolloutFit
from leapgap.diagnosis.hypotheses import Hypothesis, parts_of
from leapgap.diagnosis.joint_fit import JointFit, part, where_others_are_nominal

REPLAYED = 4  # So many effects, those that matter least by the curvature, are taken away in turn by replays
KNOWN = 0.5  # Pieces tell a number where its spread after them is a smaller share of the one before


@dataclass(frozen=True)
class JointSearch:
    """The search in logs by their own clock, beside which effects act at all places, or at parts of a held robot.

    Short pieces answer almost linearly: effects that they tell to be absent go first, by the curvature. Whole logs
    answer to large changes in ways that no curvature tells, so that replays judge the others.
    """

    joint: JointFit

    def search(self, near: FullRolloutFit) -> tuple[tuple[FullRolloutFit, ...], tuple[float, ...]]:
        """Fits of the first one, two, … causes, what matters most first, and the probability of each cause.

        That is the share of resampled logs on which the whole set is better than without it. ``near`` is the fit by
        pieces from which that to whole logs begins. Nothing where the set does not surely help.
        """
        fit = self.reduced(self.joint.fit(near.hypotheses, near.numbers, self.joint.plan.all_steps))
        return self.ordered(fit) if self.joint.surely_helps(fit) else ((), ())

    def by_pieces(self, hypotheses: Sequence[Hypothesis]) -> FullRolloutFit:
        """The fit by short pieces of all effects but those that they tell to be absent."""
        every = tuple(h for h in hypotheses if h.location == "all" or is_part(h))
        near = self.joint.fit(every, self.joint.numbers(every).centre, self.joint.plan.first_steps, whole=False)
        near = part(
            near, self.without_idle(near, self.losses_without, self.joint.plan.least_sign, among=self.told_by(near))
        )
        self.joint.progress(f"by short segments, {in_words(near)}")
        return near

    def told_by(self, fit: FullRolloutFit) -> list[int]:
        """Indices of the hypotheses of which a fit knows each number much better than it was known before."""
        spread = np.sqrt(np.diag(fit.covariance)) / self.joint.numbers(fit.hypotheses).spread
        return [k for k, (begin, end) in enumerate(itertools.pairwise(fit.ends)) if spread[begin:end].max() < KNOWN]

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
        """Indices of the fewest hypotheses that close nearly as much as all; what helps least goes first.

        What evidence tells goes only where held-out logs are replayed better without it.
        """
        kept, gap, now = list(range(len(fit.hypotheses))), self.joint.heldout_gap, self.joint.closes(fit)
        enough = now - self.joint.plan.most_lost
        while len(kept) > 1:
            without = gap.squares([part(fit, [other for other in kept if other != k]) for k in kept])
            closes = np.array([gap.closure_value(squares) for squares in without])
            room = closes - [now if self.joint.is_told(fit.hypotheses[k]) else enough for k in kept]
            least = int(np.argmax(room))
            if room[least] <= 0:
                break
            kept.pop(least)
            now = float(closes[least])
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

    def ordered(self, fit: FullRolloutFit) -> tuple[tuple[FullRolloutFit, ...], tuple[float, ...]]:
        """The causes of a fit, what matters most first, as ``search`` returns them."""
        kept = list(range(len(fit.hypotheses)))
        last_first = []
        while len(kept) > 1:
            last_first.append(kept.pop(int(np.argmin(self.losses_without(fit, kept)))))
        order = [*kept, *reversed(last_first)]
        without = [part(fit, [k for k in order if k != one]) for one in order] if len(order) > 1 else []
        gap = self.joint.heldout_gap
        sure = [gap.share_better(fit.heldout, own) for own in gap.squares(without)]
        return tuple(part(fit, order[: k + 1]) for k in range(len(order))), tuple(sure or [1.0])


def is_part(hypothesis: Hypothesis) -> bool:
    """Whether an effect acts at one of the few parts of a held robot; legs of a walking one are alike."""
    robot = hypothesis.robot
    return not robot.has_free_base and hypothesis.location in parts_of(hypothesis.kind, robot)
