"""Which cases are diagnosed again with knowledge of their truth, and what comes of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from leapgap.runtime.atomic_io import read_json
from leapgap.validation.outcome import CLAIMS, CaseOutcome, outcome

UNMADE = ("sensor", "jumps")
"""Kinds of experiments that cannot be made: the generator has no sensors beside the state, and plans no jumps."""
RUNNABLE = ("target", "targets", "jumps", "block_height_m")
"""Settings of ``collect`` that the generator can follow for the robot of a case."""


@dataclass(frozen=True)
class Seen:
    """A case with its truth, its report and the outcome of its first verdict."""

    name: str
    truth: Mapping[str, Any]
    report: Mapping[str, Any]
    first: CaseOutcome


def ablation_cases(cases: list[Seen], number: int | None) -> list[Seen]:
    """Cases of detectable single effects that were named first: one per effect, at most ``number`` (None: all)."""
    chosen: dict[str, Seen] = {}
    for case in cases:
        first = case.first
        if first.kind == "single" and first.detectable and first.first == first.true[0]:
            chosen.setdefault(first.true[0], case)
    return list(chosen.values())[:number]


def ablation_result(case: Seen, folder: Path) -> dict[str, Any]:
    """Result of a diagnosis without the true effect.

    It is honest where the verdict is ``unknown`` or ``partly``, or the answer holds only causes that the first report
    called confusable with the true effect, and the localisation is right.
    """
    report = read_json(folder / case.name / "report.json")
    again = outcome(case.name, case.truth, report, None, case.first.sides)
    effect = case.first.true[0]
    confusable = {
        other
        for cause in case.report["causes"]
        for other in (cause["effect"], *cause["confusable_with"])
        if effect in (cause["effect"], *cause["confusable_with"])
    }
    accepted = again.verdict in ("unknown", "partly", "none") or again.answered <= confusable
    return {
        "effect": effect,
        "half": case.first.half,
        "verdict": again.verdict,
        "answer": [list(names) for names in again.answer],
        "where_right": again.where_right,
        "honest": accepted and again.verdict != "none" and again.where_right,
        "honest_mirrored": accepted and again.verdict != "none" and again.where_mirrored,
    }


def experiment_cases(cases: list[Seen], number: int | None) -> list[Seen]:
    """Cases of detectable effects of the table with an ambiguous verdict that proposes further jumps."""
    asking = (
        case
        for case in cases
        if case.first.kind in ("single", "pair", "triple")
        and case.first.verdict == "ambiguous"
        and case.first.detectable
        and is_runnable(case.report.get("next_experiment") or {})
    )
    return list(asking)[:number]


def is_runnable(proposal: Mapping[str, Any]) -> bool:
    """Whether the generator can make a proposal: by settings of ``collect``, or without new sensors."""
    return bool(proposal.get("collect")) or proposal.get("settings", {}).get("kind", UNMADE[0]) not in UNMADE


def is_feasible(case: Seen, overrides: list[str]) -> bool:
    """Whether the generator can make the proposed jumps with the robot of the case."""
    keys = [line.split("=", 1)[0].removeprefix("collect.") for line in overrides]
    if set(keys) <= set(RUNNABLE):
        return True
    print(f"{case.name}: cannot make {', '.join(overrides)}", flush=True)
    return False


def extension_result(case: Seen, overrides: list[str], folder: Path) -> dict[str, Any]:
    """Result of a diagnosis of the first and the further jumps together.

    ``resolved``: exactly the true effects are named. ``found``: the answer contains all of them.
    """
    again = outcome(case.name, case.truth, read_json(folder / case.name / "report.json"), None)
    return {
        "half": case.first.half,
        "truth": list(again.true),
        "collect": list(overrides),
        "settings": (case.report.get("next_experiment") or {}).get("settings"),
        "before": {"verdict": case.first.verdict, "answer": [list(names) for names in case.first.answer]},
        "verdict": again.verdict,
        "answer": [list(names) for names in again.answer],
        "resolved": again.verdict == "named" and again.answered == set(again.true),
        "found": again.verdict in CLAIMS and set(again.true) <= again.answered,
    }
