"""Truths of a benchmark opened, and the scores of each half, as metrics."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import read_logs
from leapgap.robot.mjcf import own_model
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.corrected import read_corrected
from leapgap.validation import scoring
from leapgap.validation.outcome import CaseOutcome, outcome
from leapgap.validation.realised_reduction import realised_closure
from leapgap.validation.seal import SEALS, open_truth

REPORTED, TUNING = "reported", "tuning"


@dataclass(frozen=True)
class ScoreSettings:
    """Section ``score`` of the configuration."""

    logs: str
    truth: str
    verdicts: str
    revisits: str | None
    out: str | None
    metrics: str | None
    published_metrics: str | None
    bootstrap_draws: int
    bins: int
    seed: int


def check_judged_logs(name: str, truth: Mapping[str, Any], report: Mapping[str, Any]) -> None:
    """Raise an ``InputError`` for a report on logs other than the sealed ones."""
    expected = {file.removesuffix(".parquet"): digest for file, digest in truth["logs"].items()}
    provenance = report.get("provenance")
    if not isinstance(provenance, Mapping) or provenance.get("logs") != expected:
        raise InputError(f"report of {name}", "logs other than those sealed", "just those", "diagnose the case again")


def read_revisits(folder: str | None) -> dict[str, Mapping[str, Any]]:
    """Results of stage ``revisit`` by kind: ablated effects, next experiments, missed cases; empty without a folder."""
    kinds = ("struck", "experiments", "missed")
    return {kind: {} if folder is None else read_json(Path(folder) / f"{kind}.json") for kind in kinds}


def open_outcomes(settings: ScoreSettings, robot: Robot) -> list[CaseOutcome]:
    """Outcomes of all cases that have a verdict; the others are said, and none with one is an ``InputError``."""
    cases = sorted(read_json(Path(settings.logs) / SEALS))
    diagnosed = [name for name in cases if (Path(settings.verdicts) / name / "report.json").is_file()]
    if not diagnosed:
        raise InputError(settings.verdicts, "no report of a withheld case", "<case>/report.json", "diagnose them first")
    for name in sorted(set(cases) - set(diagnosed)):
        print(f"{name}: not diagnosed, not scored")
    return [open_outcome(name, settings, robot) for name in diagnosed]


def open_outcome(name: str, settings: ScoreSettings, robot: Robot) -> CaseOutcome:
    """Outcome of one case: its seal is checked, and the realised closure measured on the jumps kept with the truth."""
    truth = open_truth(Path(settings.truth), Path(settings.logs), name)
    if own := own_model(Path(settings.logs) / name):
        robot = Robot.load(own)
    verdict = Path(settings.verdicts) / name
    report = read_json(verdict / "report.json")
    check_judged_logs(name, truth, report)
    realised = None
    if report["closure_of_answer"] and truth["proof"]:
        _, correction = read_corrected(verdict / "corrected")
        proof = read_logs(Path(settings.truth) / name)
        realised = realised_closure(proof, robot, correction, report, settings.seed)
    return outcome(name, truth, report, realised, robot.topology.sides)


def score_half(
    outcomes: list[CaseOutcome],
    half: str,
    revisits: Mapping[str, Mapping[str, Any]],
    settings: ScoreSettings,
    main: str,
) -> dict[str, Any]:
    """All scores of one half; ``main`` is the name of the pipeline's own robot."""
    rng = np.random.default_rng(settings.seed)
    own = {kind: {n: e for n, e in entries.items() if e["half"] == half} for kind, entries in revisits.items()}
    return {
        **scoring.scores(outcomes, settings.bootstrap_draws, settings.bins, rng),
        "verdicts": dict(sorted(Counter(o.verdict for o in scoring.of_pipeline(outcomes)).items())),
        "next_experiment_resolves": scoring.share(bool(e["resolved"]) for e in own["experiments"].values()),
        "next_experiments_made": len(own["experiments"]),
        "further_jumps_find": scoring.share(bool(e["found"]) for e in own["missed"].values()),
        "further_jumps_made": len(own["missed"]),
        "struck_honest": scoring.share(bool(e["honest"]) for e in own["struck"].values()),
        "struck_honest_mirrored": scoring.share(bool(e["honest_mirrored"]) for e in own["struck"].values()),
        "struck_cases": len(own["struck"]),
        "detection_limit_floors": {
            n: d["limit_floors"] for n, d in scoring.detection_limits(scoring.of_pipeline(outcomes)).items()
        },
        "robots": scoring.scores_by_robot(outcomes, main, settings.bins),
    }


def metrics(halves: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Scores as metrics: the reported half at the top level, the tuning half under its own key."""
    flat: dict[str, dict[str, Any]] = {}
    for half in (REPORTED, TUNING):
        flat[half] = {}
        for key, value in {**halves[half], **halves[half]["robots"]}.items():
            if key == "robots":
                continue
            if isinstance(value, Mapping) and "ci95" in value:
                flat[half] |= {key: value["value"], f"{key}_ci95": value["ci95"]}
            else:
                flat[half][key] = value
    return {**flat[REPORTED], TUNING: flat[TUNING]}


def published_metrics(o: CaseOutcome) -> dict[str, Any]:
    """Verdict on the published jumps, with promised and realised closure."""
    return {
        "verdict": o.verdict,
        "answer": " + ".join(" or ".join(names) for names in o.answer),
        "closure_promised": o.promised,
        "closure_realised": o.realised,
    }


def verdict_text(o: CaseOutcome) -> str:
    """Verdict and answer of a case as text."""
    return o.verdict + (": " + " + ".join(" or ".join(names) for names in o.answer) if o.answer else "")
