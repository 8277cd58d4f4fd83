"""The report of a diagnosis as data: the contract of ``report.json``."""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from leapgap.diagnosis.best_simulator import BestSimulator
from leapgap.diagnosis.checks import CheckResult
from leapgap.diagnosis.descriptions import DescriptionFigures
from leapgap.diagnosis.engine.verdict import Numbers, ResidualForce
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.diagnosis.gap import Interval
from leapgap.diagnosis.horizons import HorizonError
from leapgap.diagnosis.localisation import Place
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

TOOLS = ("leapgap", "mujoco", "numpy")
FORMAT_VERSION = 1


@dataclass(frozen=True)
class Provenance:
    """Hashes of logs and robot, settings and versions of tools behind a report."""

    logs: Mapping[str, str]
    """SHA-256 of each log by its name, of its file where the caller names it, else of its content."""
    versions: Mapping[str, str]  # Versions of the packages that influence the results
    robot: str  # SHA-256 of the model file
    config: Mapping[str, Any]  # The settings of the diagnosis

    @staticmethod
    def of(
        logs: Sequence[Log], robot: Robot, config: Mapping[str, Any], files: Mapping[str, str] | None = None
    ) -> "Provenance":
        """Provenance of some logs; ``files`` holds the SHA-256 of the file of each log by its name, if known."""
        digests = {log.name: content_sha256(log) for log in logs} if files is None else dict(files)
        return Provenance(digests, {name: installed_version(name) for name in TOOLS}, robot.sha256, config)


def content_sha256(log: Log) -> str:
    """SHA-256 of the metadata and all columns as 64-bit floats; the order of columns does not matter."""
    digest = hashlib.sha256(log.info.to_json().encode())
    for name in sorted(log.columns):
        digest.update(name.encode() + b"\0" + np.ascontiguousarray(log[name], dtype="<f8").tobytes())
    return digest.hexdigest()


def installed_version(package: str) -> str:
    """Version of a package, or ``not installed``."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


@dataclass(frozen=True)
class ParameterEstimate:
    """A parameter's value with its 95 % interval: noise, tolerances of the model, error of the simulation."""

    value: float
    ci95: tuple[float, float]
    nominal: float
    unit: str
    at_bound: bool  # Whether the fit ended at a limit of the range; then its value is not reliable

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval, ``ci95``."""
        return self.ci95

    @property
    def unconstrained(self) -> bool:
        """Whether the interval holds the nominal value, so that the logs do not determine this parameter."""
        return self.ci95[0] <= self.nominal <= self.ci95[1]


@dataclass(frozen=True)
class Cause:
    """One hypothesis with its estimates and held-out results."""

    effect: str
    location: str
    probability: float
    """Its share of the evidence of all effects in its place; of uneven time stamps, that of the resamples with it."""
    parameters: Mapping[str, ParameterEstimate]
    per_log: Mapping[str, Mapping[str, float]]
    closure: Interval
    gap: float  # Headline gap on held-out logs with this effect added
    confusable_with: tuple[str, ...]


@dataclass(frozen=True)
class Headline:
    """What the headline gap is the root mean square of."""

    preset: str  # ``jump``: the plane of a jump at fixed sizes; ``all``: every channel by its spread or a given size
    sizes: Mapping[str, float]  # Channel → size by which its errors are divided, m, rad, m/s, rad/s
    horizon_s: float | None  # Time after which replays restart from the log; None: whole logs


@dataclass(frozen=True)
class ReportContent:
    """All results of a diagnosis; ``report.json`` holds them."""

    verdict: str
    sentence: str
    gap_nominal: float
    gap_corrected: float
    noise_floor: float
    headline: Headline
    horizons: tuple[HorizonError, ...]
    answer: tuple[tuple[str, ...], ...]
    closure_of_answer: Interval | None
    closure_shared: Interval | None
    """Explained share with one value shared by all logs, where the values of a cause differ by log."""
    closures_by_source: Mapping[str, Interval]
    """What ``evidence`` alone, ``fits`` alone and ``both`` explain; empty where evidence gives no number of a cause."""
    where: tuple[Place, ...]
    causes: tuple[Cause, ...]
    checks: tuple[CheckResult, ...]
    evidence: tuple[Evidence, ...]  # What the logs say of the robot's numbers without a simulation
    descriptions: tuple[DescriptionFigures, ...]
    """Other descriptions of the robot, each as it is; the one that explains most first."""
    next_experiment: Mapping[str, Any] | None
    not_judged: tuple[str, ...]  # What could not be judged because columns are missing
    gap_per_log: Mapping[str, Mapping[str, float]]  # Headline gap of each log: nominal and corrected (held out)
    landing_misplaced_m: Mapping[str, Mapping[str, float]]
    """Error of the trunk's x in the last judged row (touch-down), simulated − logged: nominal and corrected (held out)
    of each log; empty without a base."""
    provenance: Provenance
    set_aside: Mapping[str, str] = field(default_factory=dict)
    """Name → reason of each log that was left out: it could not be used, or departs from the others."""
    outside_forces: tuple[OutsideForce, ...] = ()  # External forces and moments, by log and time
    notes: tuple[str, ...] = ()
    """What is unusual, left out or changed of the robot's file and of the logs, such as gravity that is not Earth's."""
    evidence_numbers: Numbers | None = None  # g, u, d and c of the engine; None where time stamps are uneven
    residual_force: tuple[ResidualForce, ...] = ()  # The force that replays lack at each degree of freedom, by evidence
    best_simulator: BestSimulator | None = None  # All effects fitted together; None where the settings ask for none

    @property
    def median_log(self) -> str:
        """Name of the log whose nominal gap is the median, as an example to show."""
        ordered = sorted(self.gap_per_log, key=lambda name: self.gap_per_log[name]["nominal"])
        return ordered[len(ordered) // 2]

    def landing_off_cm(self, of: str) -> float | None:
        """Mean absolute error of the trunk's x at touch-down, cm; ``of`` is ``nominal`` or ``corrected``."""
        off = [abs(both[of]) for both in self.landing_misplaced_m.values()]
        return 100 * sum(off) / len(off) if off else None

    def to_json(self) -> dict[str, Any]:
        """Content of ``report.json``; numbers have six significant digits, non-finite ones are null."""
        best = self.best_simulator
        return round_floats(
            {
                "format_version": FORMAT_VERSION,
                "verdict": self.verdict,
                "sentence": self.sentence,
                "gap": {
                    "nominal": self.gap_nominal,
                    "corrected": self.gap_corrected,
                    "noise_floor": self.noise_floor,
                    "unit": "1",
                },
                "headline": asdict(self.headline),
                "horizons": [asdict(one) for one in self.horizons],
                "answer": [list(names) for names in self.answer],
                "closure_of_answer": self.closure_of_answer.to_json() if self.closure_of_answer else None,
                "closure_shared": self.closure_shared.to_json() if self.closure_shared else None,
                "closure_by_source": {source: one.to_json() for source, one in self.closures_by_source.items()},
                "where": [asdict(place) for place in self.where],
                "causes": [
                    {
                        **asdict(cause),
                        "closure": cause.closure.to_json(),
                        "parameters": {k: asdict(v) for k, v in cause.parameters.items()},
                    }
                    for cause in self.causes
                ],
                "checks": [check.to_json() for check in self.checks],
                "evidence": [asdict(one) for one in self.evidence],
                "evidence_numbers": asdict(self.evidence_numbers) if self.evidence_numbers else None,
                "residual_force": [asdict(one) for one in self.residual_force],
                "descriptions": [{**asdict(one), "closure": one.closure.to_json()} for one in self.descriptions],
                "next_experiment": self.next_experiment,
                "not_judged": list(self.not_judged),
                "set_aside": dict(self.set_aside),
                "notes": list(self.notes),
                "outside_forces": [one.to_json() for one in self.outside_forces],
                "best_simulator": {"closure": best.closure.to_json(), **best.to_json()} if best else None,
                "gap_per_log": self.gap_per_log,
                "landing_misplaced_m": self.landing_misplaced_m,
                "provenance": asdict(self.provenance),
            }
        )

    def metrics(self) -> dict[str, Any]:
        """Metrics for ``dvc metrics``."""
        return round_floats(
            {
                "verdict": self.verdict,
                "answer": " + ".join(" or ".join(names) for names in self.answer),
                "closure_heldout": self.closure_of_answer.value if self.closure_of_answer else 0.0,
                "closure_shared": self.closure_shared.value if self.closure_shared else None,
                "gap_nominal": self.gap_nominal,
                "gap_corrected": self.gap_corrected,
                "noise_floor": self.noise_floor,
                "landing_misplaced_nominal_cm": self.landing_off_cm("nominal"),
                "landing_misplaced_corrected_cm": self.landing_off_cm("corrected"),
                "jumps": len(self.gap_per_log),
                **({"closure_best": self.best_simulator.closure.value} if self.best_simulator else {}),
                **{f"closure_{source}": one.value for source, one in self.closures_by_source.items()},
                **{f"closure_described/{one.robot}": one.closure.value for one in self.descriptions},
            }
        )


def round_floats(value: Any) -> Any:
    """The same structure with floats at six significant digits, tuples as lists, not-finite numbers as None."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: round_floats(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [round_floats(item) for item in value]
    return value
