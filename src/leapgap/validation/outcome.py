"""The outcome of one case: the truth beside what the report says."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leapgap import effects

CLAIMS = ("named", "ambiguous", "partly")  # verdicts that name causes
LEAVES_A_REST = ("unknown", "partly")  # verdicts that say that something has no name
CLOCK = "sample_period"  # name of the effect as which a diagnosis names rows that are not what they claim
DETECTABLE_FLOORS = 2.0  # an effect is detectable where it changes the motion's headline figure by so many floors
PUBLISHED_CLOSURE = 0.8  # share of the gap of held-out published jumps that their diagnosis closes
ORDINARY = ("single", "pair", "triple", "nameless", "none")  # kinds of the scores without a kind in their name


@dataclass(frozen=True)
class ParameterComparison:
    """A true parameter and its estimate with the 95 % interval from ``low`` to ``high``, all in ``unit``."""

    effect: str
    parameter: str
    unit: str
    nominal: float
    true: float
    value: float
    low: float
    high: float

    @property
    def error(self) -> float:
        """|estimate − true| as a share of the true departure from nominal."""
        return abs(self.value - self.true) / max(abs(self.true - self.nominal), 1e-12)

    @property
    def interval_holds_truth(self) -> bool:
        """Whether the true value lies within the 95 % interval."""
        return self.low <= self.true <= self.high


@dataclass(frozen=True)
class CaseOutcome:
    """Truth and verdict of one case, and the figures that the scores are counted from."""

    case: str
    half: str
    kind: str
    true: tuple[str, ...]  # names of the effects that acted
    said_true: str  # the truth in words, with locations and values
    change_floors: float  # how much the effects change the motion, in noise floors
    detectable: bool
    each_detectable: bool  # whether each of several effects, switched off alone, changes the motion detectably
    verdict: str
    answer: tuple[tuple[str, ...], ...]
    first: str | None  # the most probable cause; None where the verdict claims none
    probability: float | None  # probability of that cause
    locations: tuple[tuple[str, str], ...]  # (true, reported) location of each effect that acted and is in the answer
    where_true: tuple[str, str] | None
    where_said: tuple[str, str] | None
    compared: tuple[ParameterComparison, ...]
    promised: float | None
    realised: float | None
    sentence: str
    next_experiment: str  # sentence of the report about the next experiment; empty where it proposes none
    sides: Mapping[str, str] = field(default_factory=dict)
    """Joint → the joint that stands for it and its twin on the other side (``Topology.sides``)."""
    clock: str | None = None  # family of the rows that are not what they claim; None where they are
    physics: str | None = None  # physics of a case of the third kind
    accepted: tuple[str, ...] = ()  # effects that this physics has, so that they may be named besides
    clock_first: bool = False  # whether the report names the clock as its first cause
    effect_detectable: bool = False  # whether the effect beside uneven rows, switched off alone, changes the motion
    robot: str | None = None  # class of a case of another robot; None: the pipeline's own
    where_overlap: float | None = None  # overlap of the reported map with the true one; None where nothing acted
    where_top_three: bool = False  # whether the true map's largest share is among the three largest reported
    members: Mapping[str, bool] = field(default_factory=dict)
    """Of three effects those that show, each switched off alone, and whether the answer has them."""
    shown: tuple[str, ...] = ()  # names of the effects that show, each switched off alone
    facts: Mapping[str, bool] = field(default_factory=dict)
    """What is wrong with the log and not with the robot, and whether a check tells it."""
    told_by_check: bool = False  # whether a check tells one of the effects

    @property
    def is_ordinary(self) -> bool:
        """Whether the case is of one of the kinds that the scores without a kind in their name are counted from."""
        return self.kind in ORDINARY

    @property
    def names_nothing_else(self) -> bool:
        """Whether the answer holds no cause beside those that acted or that the physics of the case has."""
        return self.answered <= {*self.true, *self.accepted}

    @property
    def answered(self) -> set[str]:
        """All effect names in the answer."""
        return {name for names in self.answer for name in names}

    @property
    def wrongly_named(self) -> bool:
        """Whether the verdict is ``named`` and its answer contains an effect that did not act."""
        return self.verdict == "named" and not self.answered <= set(self.true)

    @property
    def false_names(self) -> set[str]:
        """Causes that are stated as a fact, without a rival, and did not act."""
        alone = {names[0] for names in self.answer if len(names) == 1} if self.verdict in CLAIMS else set()
        return alone - {*self.true, *self.accepted}

    @property
    def honest(self) -> bool:
        """Whether the verdict is right, or states nothing false as a fact.

        An answer with rivals must hold what acts, ``named`` all that shows, and ``none`` is right or nothing.
        """
        if all(self.facts.values()) and (self.told_by_check or (self.facts and not self.true)):
            return not self.false_names
        if self.verdict == "named":
            is_whole = self.names_nothing_else and set(self.shown) <= self.answered
            return self.right or (self.kind != "nameless" and is_whole)
        if self.verdict == "ambiguous":
            return all(set(names) & {*self.true, *self.accepted} for names in self.answer)
        if self.verdict in LEAVES_A_REST:
            return not self.false_names
        return self.right

    @property
    def right(self) -> bool:
        """Whether the verdict is one that a perfect diagnosis may give."""
        if not all(self.facts.values()):
            return False
        if self.kind == "published":
            return self.clock_first and (self.promised or 0.0) >= PUBLISHED_CLOSURE
        if self.kind == "nameless":
            return self.verdict in LEAVES_A_REST or (not self.detectable and self.verdict == "none")
        if self.kind == "none":
            return self.verdict == "none"
        if self.clock is not None:
            found = not self.effect_detectable or set(self.true) <= self.answered
            return self.clock_first and self.names_nothing_else and found
        if self.kind == "third" and (not self.true or not self.detectable):
            return self.verdict == "none" or self.names_nothing_else
        if self.kind == "third":
            return self.verdict == "named" and set(self.true) <= self.answered and self.names_nothing_else
        if not self.detectable:
            return self.verdict == "none" or self.answered <= set(self.true)
        return self.verdict == "named" and self.answered == set(self.true)

    @property
    def where_right(self) -> bool:
        """Whether the phase and channel of the largest share are those of the truth."""
        return self.where_true is not None and self.where_true == self.where_said

    @property
    def where_mirrored(self) -> bool:
        """Like ``where_right``, with left and right legs taken as one."""
        return merge_sides(self.where_true, self.sides) == merge_sides(self.where_said, self.sides)


def outcome(
    case: str,
    truth: Mapping[str, Any],
    report: Mapping[str, Any],
    realised: float | None,
    sides: Mapping[str, str] | None = None,
) -> CaseOutcome:
    """Compare a truth with a report; ``sides`` are those of the robot's topology."""
    same = {other: e["name"] for e in truth["effects"] for other in e.get("same", ())}

    def canonical(name: str) -> str:
        first = effects.first_name(name)
        return same.get(first, first)

    answer = tuple(tuple(dict.fromkeys(map(canonical, names))) for names in report["answer"])
    said = [one["says"] for one in report.get("checks", ()) if not one["passed"]] + list(report.get("notes", ()))

    def is_told(words: str | None) -> bool:
        return words is not None and any(re.search(words, one, re.IGNORECASE) for one in said)

    by_check = {e["name"] for e in truth["effects"] if is_told(e.get("told"))}
    claims = report["verdict"] in CLAIMS and bool(report["causes"])
    true = tuple(effect["name"] for effect in truth["effects"])
    in_answer = {name for names in answer for name in names}
    # the most probable one of each name
    causes = {effects.first_name(c["effect"]): c for c in reversed(report["causes"])}
    floor = truth.get("noise_floor") or 1.0
    true_map, said_map = comparable_maps(truth["where"], report["where"])
    return CaseOutcome(
        case=case,
        half=truth["half"],
        kind=truth["kind"],
        true=true,
        said_true=truth_in_words(truth),
        change_floors=(truth["change"] or 0.0) / floor,
        detectable=truth["detectable"],
        each_detectable=bool(truth.get("changes")) and min(truth["changes"]) >= DETECTABLE_FLOORS * floor,
        verdict=report["verdict"],
        answer=answer,
        first=canonical(report["causes"][0]["effect"]) if claims else None,
        probability=report["causes"][0]["probability"] if claims else None,
        # A rival that a cause cannot be told apart from is in the answer, and not always among the causes.
        locations=tuple(
            (e["location"], causes[e["name"]]["location"])
            for e in truth["effects"]
            if e["name"] in in_answer and e["name"] in causes
        ),
        where_true=place(truth["where"]),
        where_said=place(report["where"]),
        compared=tuple(c for e in truth["effects"] if e["name"] in in_answer for c in compare(e, truth, report)),
        promised=(report["closure_of_answer"] or {}).get("heldout") if claims else None,
        realised=realised if claims else None,
        sentence=report["sentence"],
        next_experiment=(report.get("next_experiment") or {}).get("sentence", ""),
        sides=sides or {},
        clock=truth["clock"]["family"] if "clock" in truth else None,
        physics=truth.get("physics"),
        accepted=tuple(truth.get("accepted", ())),
        clock_first=report["verdict"] in CLAIMS and [c["effect"] for c in report["causes"][:1]] == [CLOCK],
        effect_detectable="clock" in truth
        and len(truth["changes"]) > 1
        and truth["changes"][1] >= DETECTABLE_FLOORS * floor,
        robot=truth.get("robot"),
        where_overlap=overlap(true_map, said_map) if true_map else None,
        where_top_three=bool(true_map) and largest(true_map, 1)[0] in largest(said_map, 3),
        members={name: name in in_answer for name in members_that_show(truth) if truth["kind"] == "triple"},
        shown=tuple(name for name in members_that_show(truth) if name not in by_check),
        facts={name: is_told(fact["told"]) for name, fact in truth.get("facts", {}).items()},
        told_by_check=bool(by_check),
    )


def members_that_show(truth: Mapping[str, Any]) -> list[str]:
    """Names of the effects that change the motion detectably, each switched off alone."""
    changes = truth.get("changes") or ()
    least = DETECTABLE_FLOORS * (truth.get("noise_floor") or 1.0)
    return [e["name"] for e, change in zip(truth["effects"], changes, strict=False) if change >= least]


Map = Mapping[tuple[str, str], float]  # phase and channel → share of the squared gap


def comparable_maps(true: list[Mapping[str, Any]], said: list[Mapping[str, Any]]) -> tuple[Map, Map]:
    """The true and the reported map; left and right are one in both where the report does not tell them apart."""
    ones = {}
    for entry in said:
        twin = entry.get("as_one_with")
        if twin is not None:
            ones[entry["phase"], max(entry["channel"], twin)] = (entry["phase"], min(entry["channel"], twin))
    found: tuple[dict[tuple[str, str], float], dict[tuple[str, str], float]] = ({}, {})
    for of, entries in zip(found, (true, said), strict=True):
        for entry in entries:
            at = (entry["phase"], entry["channel"])
            at = ones.get(at, at)
            of[at] = of.get(at, 0.0) + entry["share"]
    return found


def overlap(true: Map, said: Map) -> float:
    """Sum over phases and channels of the smaller of two shares: 1 where both maps are the same."""
    return sum(min(share, said.get(at, 0.0)) for at, share in true.items())


def largest(of: Map, number: int) -> list[tuple[str, str]]:
    """Phases and channels with the largest shares."""
    return sorted(of, key=lambda at: -of[at])[:number]


def merge_sides(place: tuple[str, str] | None, sides: Mapping[str, str]) -> tuple[str, str] | None:
    """A phase and channel with left and right legs taken as one.

    In a symmetric jump, sensor noise alone decides which of the two sides has the larger share.
    """
    if place is None:
        return None
    phase, channel = place
    quantity, slash, joint = channel.partition("/")
    return phase, f"{quantity}{slash}{sides.get(joint, joint)}"


def in_words(effect: Mapping[str, Any]) -> str:
    """An effect of a truth file as text, such as ``joint_damping at RR: damping 0.4``."""
    values = ", ".join(f"{name} {value:.3g}" for name, value in effect["parameters"].items())
    return f"{effect['name']}{'' if effect['location'] == 'all' else ' at ' + effect['location']}: {values}"


def truth_in_words(truth: Mapping[str, Any]) -> str:
    """What acted in a case, with its clock family or physics where it has one, or its kind where nothing acted."""
    acted = " and ".join(in_words(e) for e in truth["effects"]) or truth["kind"]
    special = truth["clock"]["family"] if "clock" in truth else truth.get("physics")
    return acted if special is None else f"{acted} ({special})"


def place(where: list[Mapping[str, Any]]) -> tuple[str, str] | None:
    """Phase and channel of the largest share; None where nothing has a share."""
    return (where[0]["phase"], where[0]["channel"]) if where else None


def compare(
    effect: Mapping[str, Any], truth: Mapping[str, Any], report: Mapping[str, Any]
) -> list[ParameterComparison]:
    """Compare every parameter of one true effect that the report estimates.

    The true value is the median over the diagnosed logs, since some effects differ from log to log.
    """
    comparisons = []
    kind = effects.known().get(effect["name"])
    known = kind.declarations() if kind else {}
    index = [e["name"] for e in truth["effects"]].index(effect["name"])
    logs = [of_log for name, of_log in truth["per_log"].items() if f"{name}.parquet" in truth["logs"]]
    for name, about in known.items():
        causes = (c["parameters"] for c in report["causes"] if effects.first_name(c["effect"]) == effect["name"])
        estimate = next((parameters[name] for parameters in causes if name in parameters), None)
        if estimate is None or name not in effect["parameters"]:  # or the truth has another number of it
            continue
        true = float(np.median([of_log[index][name] for of_log in logs]))
        numbers = estimate["nominal"], true, estimate["value"], *estimate["ci95"]
        comparisons.append(ParameterComparison(effect["name"], name, about.unit, *numbers))
    return comparisons
