"""The verdict: one table of four numbers.

======  ==========================================================================================
g       evidence on held-out logs that the set gains, nats: something named acts
u       evidence of a force without a name beside the set, nats: something without a name acts
d       evidence that is lost when the likeliest other effect takes a member's place, nats: it is known which
c       share of the gap of whole logs that the set closes: how much
======  ==========================================================================================

none: no set, u small · unknown: no set, u large · partly: a set, u large · ambiguous: d small · named: else. A set that
closes nothing of a gap is none (on feet: surely nothing); where u is large, one that may close nothing is none either.
A number at the end of its range is never named.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from leapgap.diagnosis.candidates import PLACES, Candidate, Undecided, clip_numbers, in_words, nominal_candidate
from leapgap.diagnosis.candidates import Rival as OpenFit
from leapgap.diagnosis.engine.screening import few_of_each, screen
from leapgap.diagnosis.engine.search import (
    HALF,
    LEAST_GAIN,
    LEAST_SHARE,
    UNNAMED,
    Found,
    Search,
    candidate_of,
    changes_contacts,
    left_unnamed,
)
from leapgap.diagnosis.engine.whitening import CORRELATION_S, Chunks
from leapgap.diagnosis.full_rollouts import FullRollouts
from leapgap.diagnosis.gap import HeldOutFigures, HeldOutGap
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.diagnosis.outside_forces.search import MARGIN_S, place_of
from leapgap.effects.base import overrides

SINGLES = 4  # Number of single effects that a report lists beside the answer
LEAST_CLOSURE = 0.01  # Share of the gap that a set, and each member of it, has to close
SURE = 0.95  # Share of the resamples of logs in which numbers by whole logs have to leave less
FOLLOWED_S = 6 * CORRELATION_S  # Time after a push in which a filter without a force has still to follow, s
APART = LEAST_GAIN  # Evidence by which the likeliest other set must be worse for a cause to be told apart, nats: d₀
AROUND = (-0.2, -0.13, -0.07, 0.0, 0.07, 0.13, 0.2)  # Shares of a departure from nominal by which it is moved


@dataclass(frozen=True)
class Numbers:
    """The four numbers of a diagnosis; ``report.json`` holds them as ``evidence_numbers``."""

    g: float
    u: float
    u_before: float  # u of the nominal robot
    d: float | None  # None without a set
    c: float | None  # None without a set
    blocks: int  # Number of blocks of the logs; u is judged by block


@dataclass(frozen=True)
class Moment:
    """A block of a log with the evidence that a force without a name acts in it beside the answer."""

    log: str
    begin_s: float
    end_s: float
    nats: float


@dataclass(frozen=True)
class ResidualForce:
    """The force at a degree of freedom that replays lack, root mean square over the logs."""

    at: str  # Name of the joint, or of the body of the free base
    axis: str  # Of a base; empty for a joint
    unit: str
    nominal: float
    corrected: float  # The same once the effects of the answer act


@dataclass(frozen=True)
class Conclusion:
    """Verdict and answer of a diagnosis."""

    verdict: str
    answer: tuple[tuple[str, ...], ...]  # Each cause, followed by the rivals that cannot be told apart from it
    steps: tuple[Candidate, ...] = ()  # Fits of the first one, two, … causes; the last is the answer's
    probabilities: tuple[float, ...] = ()  # How sure each cause is


@dataclass(frozen=True)
class Judgement:
    """A search with its conclusion."""

    conclusion: Conclusion
    selected: Candidate  # The answer's fit; the nominal robot where there is no answer
    others: Sequence[tuple[Candidate, float]] = ()
    """One fit for each further hypothesis that was judged, with the probability of its newest effect."""
    numbers: Numbers | None = None  # None of logs by their own clock
    moments: Sequence[Moment] = ()  # By evidence, where something without a name acts beside the answer
    residual: tuple[ResidualForce, ...] = ()
    undecided: Undecided = field(default_factory=Undecided)
    notes: tuple[str, ...] = ()  # What a report must say of it, such as why a set that was found is no answer


@dataclass(frozen=True)
class Rival:
    """An effect in place of a member of a set."""

    hypothesis: Hypothesis
    loss: float  # Evidence that the set loses by it, nats


def rivals_of(search: Search, found: Found, member: int) -> list[Rival]:
    """The likeliest effects in place of a member, the best first: those that were replayed, and by columns the others.

    None of them is another place of the same effect, nor one that has joined the set since.
    """
    own = found.members[member]
    near = [Rival(one.members[-1], found.evidence - one.evidence) for one in search.in_place_of(found, member)]
    members = {h.name for h in found.members}
    replayed = [Rival(h, loss) for label, h, loss in found.rivals if label == own.label and h.name not in members]
    others = [rival for rival in (*near, *replayed) if rival.hypothesis.name != own.name]
    return sorted(others, key=lambda rival: rival.loss)


def conclude(search: Search, start: Found, found: Found, gap: HeldOutGap) -> Judgement:
    """The conclusion of a search: verdict, causes in the order of what they explain, and the four numbers."""
    # Whole logs of feet are chaotic: they fit no numbers, and by own steps refuse what surely closes nothing alone.
    on_feet = search.bench.robot.stands
    asks_of_steps = any(overrides(h.kind, "change_step") for h in search.bench.hypotheses)
    exact = gap.by_exact_steps if found.members and not asks_of_steps else gap
    found = without_immaterial(search, start, found, exact)
    if on_feet:
        found = without_outweighed(search, found)
    blocks = len(found.point.evidence.levels)
    u, before = found.unnamed, start.unnamed
    nominal = nominal_candidate(int(gap.folds.max()) + 1)
    moments, of_nominal = moments_of(found), moments_of(start)
    explained, others = is_explained(moments), partial(single_effects, search, start)
    unknown = Conclusion("unknown", ())
    without = Conclusion("none", ()) if is_explained(of_nominal) else unknown
    as_it_is = of_nominal, residual_of(start, start)
    if not found.members:
        numbers = Numbers(0.0, u, before, None, None, blocks)
        return Judgement(without, nominal, others(start), numbers, *as_it_is)
    losses = [found.loss(m) for m in range(len(found.members))]
    order = [int(m) for m in np.argsort(losses)[::-1]]
    rivals = [rivals_of(search, found, m) for m in order]
    d = min((own[0].loss for own in rivals if own), default=np.inf)
    steps = [candidate_of(found, order[: k + 1]) for k in range(len(order))]
    if explained:
        steps[-1] = by_parabolas(steps[-1], search, found, gap) if on_feet else by_whole_logs(steps[-1], gap)
    gap.replays(steps[-1:])  # all rows at once: the report shows them
    (figures,), (judged,) = (own.figures(steps[-1:]) for own in (gap, exact))
    gained, closure = found.predictive - start.predictive, figures.closure.value
    numbers = Numbers(gained, u, before, float(d), closure, blocks)
    # What stays without a name may make up for as large a share of a cause as of all that is to be explained.
    unnamed = 0.0 if explained else left_unnamed(start, found, None if on_feet else closure)
    apart = [max(APART, unnamed * losses[m]) for m in order]
    near = [[rival for rival in own if rival.loss < least] for own, least in zip(rivals, apart, strict=True)]
    answer = tuple(
        (found.members[m].name, *dict.fromkeys(rival.hypothesis.name for rival in own))
        for m, own in zip(order, near, strict=True)
    )
    closes = judged.closure.high if on_feet and exact is gap else judged.closure.value
    if exact.has_gap and closes < LEAST_CLOSURE:
        return Judgement(without, nominal, others(start), numbers, *as_it_is)
    if why := refusal(found, explained, gained if unnamed > HALF else None, judged, exact):
        notes = (f"{in_words(steps[-1])} {why}",)
        return Judgement(unknown, nominal, others(start), numbers, *as_it_is, notes=notes)
    at_end = steps[-1].at_bound
    if not explained or at_end:
        verdict = "partly"
    else:
        verdict = "ambiguous" if any(len(names) > 1 for names in answer) else "named"
    sure = tuple(1 / (1 + sum(np.exp(-np.clip(r.loss, -50, 50)) for r in own)) for own in rivals)
    undecided = undecided_of(search, found, order, near, steps[-1])
    conclusion = Conclusion(verdict, answer, tuple(steps), sure)
    return Judgement(conclusion, steps[-1], others(found), numbers, moments, residual_of(start, found), undecided)


def refusal(found: Found, explained: bool, outweighed: float | None, figures: HeldOutFigures, gap: HeldOutGap) -> str:
    """Why a set with some figures is no answer, in words after its own; empty where it is one.

    ``outweighed`` is its evidence on held-out logs, nats, where what is left outweighs it.
    """
    if figures.gap >= gap.unmoved:
        over = "whole logs" if gap.horizon_s is None else f"{gap.horizon_s:g} s"
        return (
            f"is no answer: over {over} a robot that does not move is nearer to them (gap {gap.unmoved:.2g} beside "
            f"{figures.gap:.2g}), so that these logs judge no simulation"
        )
    if outweighed is not None:
        return (
            "came nearest, but what is left unexplained is worth more evidence than it gains "
            f"({found.missing:.0f} beside {outweighed:.0f} nats)"
        )
    if not explained and gap.has_gap and figures.closure.low <= 0:
        share = figures.closure.capped_at_one
        value, low, high = (f"{100 * own:.0f}" for own in (share.value, share.low, share.high))
        return f"came nearest, but may explain nothing of held-out logs: {value} % (95 %: {low} to {high})"
    return ""


def residual_of(start: Found, found: Found) -> tuple[ResidualForce, ...]:
    """The force by which references follow the logs, by the nominal robot and beside a set."""
    sizes, robot = [], start.point.intervals.robot
    for one in (start.point, found.point):
        assert one.intervals.residual is not None
        sizes.append(np.sqrt((one.intervals.residual**2).mean(axis=0)) * one.basis.linearisation.units)
    return tuple(
        ResidualForce(*place_of(dof, robot), float(nominal), float(own))
        for dof, (nominal, own) in enumerate(zip(*sizes, strict=True))
    )


def moments_of(found: Found) -> list[Moment]:
    """The blocks of a set."""
    intervals, blocks = found.point.intervals, found.point.basis.blocks
    chunks, nats, moments = Chunks.of(intervals), found.by_level.max(axis=0) - found.by_level[0], []
    for (chunk, first, end), own in zip(blocks.places, nats.tolist(), strict=True):
        course, at = intervals.courses[chunks.log[chunk]], int(chunks.first[chunk])
        instants = course.begins[at + first], course.begins[at + end - 1] + 1
        begin_s, end_s = course.states.log.time[course.rows[[*instants]]].tolist()
        moments.append(Moment(course.states.log.name, begin_s, end_s, own))
    return moments


def without_pushes(moments: Sequence[Moment], forces: Sequence[OutsideForce]) -> list[Moment]:
    """The moments in which none of some forces acts, nor what a filter that knows none has still to follow."""
    acting = [(one.log, one.begin_s - MARGIN_S, one.end_s + FOLLOWED_S) for one in forces]
    return [
        own
        for own in moments
        if not any(own.log == log and own.begin_s < end_s and begin_s < own.end_s for log, begin_s, end_s in acting)
    ]


def is_explained(moments: Sequence[Moment]) -> bool:
    """Whether nothing without a name acts in some moments."""
    return sum(own.nats for own in moments) <= UNNAMED * len(moments)


def by_whole_logs(candidate: Candidate, gap: HeldOutGap) -> Candidate:
    """A set that explains the logs with its numbers by whole logs, where these surely leave less of held-out logs."""
    fit = FullRollouts(gap).fit(candidate.hypotheses, candidate.numbers)
    better = gap.share_better(fit.heldout, *gap.squares([candidate]))
    return fit if fit.sensible and better > SURE else candidate


def undecided_of(
    search: Search, found: Found, order: Sequence[int], rivals: Sequence[Sequence[Rival]], answer: Candidate
) -> Undecided:
    """What the evidence leaves open: the first cause with rivals that it does not tell apart.

    ``order`` is that of the members in the answer, and ``rivals`` are those of each that are not told apart.
    """
    for k, member in enumerate(order):
        if not (near := rivals[k]):
            continue
        own, members = found.members[member].name, [*order[:k], len(order), *order[k + 1 :]]
        fits = [
            OpenFit(h.name, candidate_of(search.settle(search.judge(found.point, [h], [member]).with_members(members))))
            for h in few_of_each([rival.hypothesis for rival in near], PLACES)
        ]
        names = (own, *dict.fromkeys(fit.name for fit in fits))
        return Undecided(
            names, (OpenFit(own, answer), *fits), float(1 / (1 + np.exp(np.clip(near[0].loss, 0.0, 50.0))))
        )
    return Undecided((), (OpenFit(found.members[order[0]].name, answer),))


def without_immaterial(search: Search, start: Found, found: Found, gap: HeldOutGap) -> Found:
    """The set without members that gain little beside the others and leave the gap of whole logs as it was.

    They make up for errors of the simulation and are no causes of the gap.
    """
    while len(found.members) > 1 and gap.has_gap:
        members = range(len(found.members))
        fewer = [[m for m in members if m != one] for one in members]
        whole, *others = gap.figures([candidate_of(found), *(candidate_of(found, kept) for kept in fewer)])
        small = LEAST_SHARE * (found.predictive - start.predictive)
        idle = [
            one
            for one, own in zip(members, others, strict=True)
            if whole.closure.value - own.closure.value < LEAST_CLOSURE
            and found.predictive - search.judge(found.point, (), [one]).predictive < small
        ]
        if not idle:
            break
        search.progress(f"without {found.members[idle[0]].label}, which explains nothing")
        found = search.settle(found.with_members(fewer[idle[0]]))
    return found


def without_outweighed(search: Search, found: Found) -> Found:
    """The set without members that are worth less evidence than what stays without a name, which they may stand for."""
    while found.unexplained and len(found.members) > 1:
        members = range(len(found.members))
        losses = [found.loss(m) for m in members]
        least = int(np.argmin(losses))
        if losses[least] >= found.missing:
            break
        search.progress(f"without {found.members[least].label}, worth less than what stays without a name")
        found = search.settle(found.with_members([m for m in members if m != least]))
    return found


def by_parabolas(candidate: Candidate, search: Search, found: Found, gap: HeldOutGap) -> Candidate:
    """A set of a robot with feet with its numbers at the tops of parabolas through its evidence and through whole logs.

    Contacts make both rough, so that numbers settle where they are the best near by alone. Each number is tried further
    off while the others stay; how well a parabola tells it, the scatter about it says. Numbers of the contacts
    themselves stay: what slips a little earlier is elsewhere at the end of a log, and none tells by how much.
    """
    step = np.zeros(len(candidate.numbers))
    members = candidate.hypotheses
    own = np.repeat([not changes_contacts(h) for h in members], [len(h.parameters) for h in members])
    departs = np.diag(candidate.numbers - np.concatenate([h.nominal for h in members]))[own]
    tried = [moved_by(candidate, by * one) for one in departs for by in AROUND]
    acting = [tuple(zip(one.hypotheses, one.split(), strict=True)) for one in tried]
    evidence = search.evidence_at(found, acting)
    left = [float(squares.sum()) for squares in gap.squares(tried)]
    both = np.array([evidence, np.negative(left)]).reshape(2, len(departs), len(AROUND))
    for k, one in enumerate(departs):
        at, sure = np.transpose([top(AROUND, values) for values in both[:, k]])
        step += one * (at @ sure / max(sure.sum(), 1e-12))
    return moved_by(candidate, step)


def moved_by(candidate: Candidate, step: np.ndarray) -> Candidate:
    """A candidate with other numbers within their ranges, those without each fold as much off."""
    numbers = clip_numbers(candidate.hypotheses, candidate.numbers + step)
    folds = np.array([clip_numbers(candidate.hypotheses, own + step) for own in candidate.fold_numbers])
    return replace(candidate, numbers=numbers, fold_numbers=folds)


def top(at: Sequence[float], values: np.ndarray) -> tuple[float, float]:
    """Where a parabola through values (points,) has its top, within them, and its inverse variance by their scatter.

    Zero and zero of a parabola without a top.
    """
    design = np.vander(at, 3)
    fit, *_ = np.linalg.lstsq(design, values)
    scatter = ((values - design @ fit) ** 2).sum() / (len(values) - 3)
    curved, slope, _ = fit.tolist()
    if curved >= 0:
        return 0.0, 0.0
    found = -slope / (2 * curved)
    by_fit = np.array([slope / (2 * curved**2), -1 / (2 * curved), 0.0])
    variance = scatter * by_fit @ np.linalg.inv(design.T @ design) @ by_fit
    return float(np.clip(found, min(at), max(at))), float(1 / max(variance, 1e-12))


def single_effects(search: Search, start: Found, found: Found) -> list[tuple[Candidate, float]]:
    """Fits of the likeliest single effects that the set has not, one a name, with the probability 0 of what is out."""
    known = {h.name for h in found.members}
    likely = few_of_each([h for _, h in screen(start.point) if h.name not in known], 1)
    return [(candidate_of(search.judge(start.point, [h])), 0.0) for h in likely[:SINGLES]]
