"""Landing figures of methods and tasks, as tables."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from leapgap.simulation.landing import Landing

BOOTSTRAP_DRAWS = 1000


@dataclass(frozen=True)
class Scored:
    """One run of a method at a task: its jumps, whether each was made at all, and the substitutes of its controller."""

    hardware: str
    method: str
    task: str
    wanted: int
    """Jumps of the task."""
    landings: tuple[Landing, ...]
    fallbacks: Mapping[str, int]

    @property
    def key(self) -> str:
        """As in the metrics."""
        return f"{self.hardware}/{self.method}/{self.task}"

    def to_json(self) -> dict[str, Any]:
        """As stored."""
        return asdict(self) | {"fallbacks": dict(self.fallbacks)}

    @staticmethod
    def from_json(raw: Mapping[str, Any]) -> "Scored":
        """Read it back."""
        return Scored(**{**raw, "landings": tuple(Landing(**one) for one in raw["landings"])})


def tables(scored: Iterable[Scored], seed: int) -> dict[str, dict[str, Any]]:
    """``{"abs_error_cm": {"worn/ours/jump_60": 1.2, …}, …}``; intervals are 95 % by resampling the jumps."""
    groups: dict[str, list[Scored]] = {}
    for one in scored:
        groups.setdefault(one.key, []).append(one)
    found: dict[str, dict[str, Any]] = {}
    for key, runs in groups.items():
        for name, value in figures(runs, seed).items():
            found.setdefault(name, {})[key] = value
    return found


def figures(runs: Sequence[Scored], seed: int) -> dict[str, Any]:
    """Of all jumps of some runs. A jump that was never made, because one before it failed, is no success."""
    jumps = [landing for run in runs for landing in run.landings]
    wanted = sum(run.wanted for run in runs)
    error = np.array([jump.error_cm for jump in jumps])
    pitch = np.array([jump.pitch_deg for jump in jumps])
    return {
        "error_cm": rounded(error.mean()),
        "error_sd_cm": rounded(error.std(ddof=1)) if len(error) > 1 else None,
        "abs_error_cm": rounded(np.abs(error).mean()),
        "abs_error_ci95_cm": interval(np.abs(error), seed),
        "success": rounded(sum(jump.success for jump in jumps) / wanted),
        "landing_pitch_deg": rounded(np.abs(pitch).mean()),
        "jumps": wanted,
        "fallbacks": sum(sum(run.fallbacks.values()) for run in runs),
    }


def interval(values: np.ndarray, seed: int) -> list[float]:
    """Of the mean."""
    drawn = np.random.default_rng(seed).choice(values, (BOOTSTRAP_DRAWS, len(values))).mean(axis=1)
    return [rounded(edge) for edge in np.percentile(drawn, [2.5, 97.5])]


def rounded(value: float) -> float:
    """To what a table shows."""
    return round(float(value), 3)


def overall(scored: Iterable[Scored], tasks: Sequence[str]) -> dict[str, float]:
    """Mean absolute error over some tasks by hardware and method, each task counting alike, cm."""
    by: dict[str, dict[str, list[float]]] = {}
    for run in scored:
        if run.task in tasks:
            of_task = by.setdefault(f"{run.hardware}/{run.method}", {}).setdefault(run.task, [])
            of_task += [abs(jump.error_cm) for jump in run.landings]
    return {key: rounded(np.mean([np.mean(v) for v in tasks_of.values()])) for key, tasks_of in by.items()}
