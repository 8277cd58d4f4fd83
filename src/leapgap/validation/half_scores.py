"""Truths of a benchmark opened, closures measured on the jumps kept with them, and the scores of each half."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.diagnosis.checks.joint_clock import JointClock
from leapgap.diagnosis.gap import candidate_squares, headline_gap, noise_floor
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log, read_logs
from leapgap.robot.mjcf import own_model
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.corrected import read_corrected
from leapgap.simulation.replay import Replayer
from leapgap.validation import scoring
from leapgap.validation.outcome import CaseOutcome, outcome
from leapgap.validation.seal import SEALS, open_truth

REPORTED, TUNING = "reported", "tuning"
NOISE_DRAWS = 3


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
    folders = Path(settings.logs), Path(settings.truth), Path(settings.verdicts)
    return [open_outcome(name, *folders, robot, settings.seed) for name in diagnosed]


def open_outcome(name: str, logs: Path, truths: Path, verdicts: Path, robot: Robot, seed: int) -> CaseOutcome:
    """Outcome of one case: its seal is checked, and the realised closure measured on the jumps kept with the truth."""
    truth, verdict = open_truth(truths, logs, name), verdicts / name
    if own := own_model(logs / name):
        robot = Robot.load(own)
    report = read_json(verdict / "report.json")
    check_judged_logs(name, truth, report)
    realised = None
    if report["closure_of_answer"] and truth["proof"]:
        _, correction = read_corrected(verdict / "corrected")
        realised = realised_closure(read_logs(truths / name), robot, correction, report, seed)
    return outcome(name, truth, report, realised, robot.topology.sides)


def realised_closure(
    proof: Sequence[Log], robot: Robot, correction: Sequence[Effect], report: Mapping[str, Any], seed: int
) -> float:
    """(nominal − corrected) / (nominal − noise floor) of the headline gap on the proof jumps.

    The value of an effect that differs from log to log comes from the clock of the joints on each proof jump, as in the
    report.
    """
    judged = JudgedLogs.of(proof, robot)
    replayer = Replayer(robot, terrain_slots=max(1, *(len(jump.info.terrain) for jump in proof)), threads=1)
    corrected = [
        tuple(effect_on_log(effect, jump, judged, robot, report) for effect in correction) for jump in judged.logs
    ]
    nominal, after = candidate_squares(judged, replayer, [[()] * len(proof), corrected])
    floor = noise_floor(judged, replayer, NOISE_DRAWS, np.random.default_rng(seed))
    before, left, least = (headline_gap(s, judged) for s in (nominal, after, floor))
    return float((before - left) / max(before - least, 1e-12))


def effect_on_log(effect: Effect, jump: Log, judged: JudgedLogs, robot: Robot, report: Mapping[str, Any]) -> Effect:
    """The effect on a jump that was not fitted; where it differs by log, it is scaled by the clock of that jump.

    The effect is returned unchanged where the report holds no values by log.
    """
    if not effect.differs_per_log:
        return effect
    cause = next((c for c in report["causes"] if c["effect"] == effect.called(robot)), None)
    clocks = next((c["per_log"] for c in report["checks"] if c["name"] == JointClock.name and c.get("per_log")), None)
    check = JointClock().run([jump], robot, threshold=0.0)
    if not (cause and cause.get("per_log") and clocks and check):
        return effect
    parameter = effect.parameters(robot, effect.location)[0]
    name = parameter.name
    shares = [
        (cause["per_log"][log][name] - 1) / (clocks[log] - 1) for log in cause["per_log"] if clocks.get(log, 1) != 1
    ]
    (clock,) = check.per_log.values()
    value = float(np.clip(1 + np.median(shares) * (clock - 1), parameter.lower, parameter.upper))
    changed: dict[str, Any] = {name: value}
    return replace(effect, **changed)


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
