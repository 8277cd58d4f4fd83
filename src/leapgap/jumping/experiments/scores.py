"""Landing figures by hardware, method and task, as tables."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.jumping.experiments.trial_spec import TrialResult
from leapgap.runtime.atomic_io import whole_file

BOOTSTRAP_DRAWS = 1000


@dataclass(frozen=True)
class ScoredRun:
    """One run of a method at a task."""

    hardware: str
    """Name of its variant; robots drawn from one variant count together."""
    robot: str
    """Which robot of the variant, as in places."""
    method: str
    task: str
    number: int
    planned_jumps: int
    """Number of jumps in the task."""
    result: TrialResult

    @property
    def key(self) -> str:
        """Key of this run's figures in the metrics: hardware/method/task."""
        return f"{self.hardware}/{self.method}/{self.task}"

    def rows(self) -> Iterator[dict[str, Any]]:
        """One row for each jump that was made: its landing, and what the run demanded of the robot."""
        about = {name: getattr(self, name) for name in ("hardware", "robot", "method", "task", "number")}
        for jump, landing in enumerate(self.result.landings):
            figures = {name: round_value(value) for name, value in asdict(landing).items()}
            figures["disturbance"] = self.result.disturbance
            demands = {name: round_value(value) for name, value in asdict(self.result.metrics).items()}
            yield about | {"jump": jump} | figures | demands | {"fallbacks": sum(self.result.fallbacks.values())}


def tables(scored: Iterable[ScoredRun], seed: int) -> dict[str, dict[str, Any]]:
    """``{"abs_error_cm": {"worn/ours/jump_60": 1.2, …}, …}``; intervals are 95 %, as in ``interval``."""
    groups: dict[str, list[ScoredRun]] = {}
    for one in scored:
        groups.setdefault(one.key, []).append(one)
    found: dict[str, dict[str, Any]] = {}
    for key, runs in groups.items():
        for name, value in figures(runs, seed).items():
            found.setdefault(name, {})[key] = value
    return found


def figures(runs: Sequence[ScoredRun], seed: int) -> dict[str, Any]:
    """Figures over all jumps of some runs. A jump that was not made because one before it failed is no success."""
    jumps = [landing for run in runs for landing in run.result.landings]
    wanted = sum(run.planned_jumps for run in runs)
    error = np.array([jump.error_cm for jump in jumps])
    robots = [run.robot for run in runs for _ in run.result.landings]
    pitch = np.array([jump.pitch_deg for jump in jumps])
    demands = [run.result.metrics for run in runs]
    found = {
        "error_cm": summarise(np.mean, error),
        "error_ci95_cm": interval(error, robots, seed),
        "error_sd_cm": standard_deviation(error),
        "abs_error_cm": summarise(np.mean, np.abs(error)),
        "abs_error_ci95_cm": interval(np.abs(error), robots, seed),
        "worst_error_cm": summarise(np.max, np.abs(error)),
        "success": round_value(sum(jump.success for jump in jumps) / wanted),
        "landing_pitch_deg": summarise(np.mean, np.abs(pitch)),
        "worst_pitch_deg": summarise(np.max, np.abs(pitch)),
        "apex": summarise(np.mean, np.array([jump.apex for jump in jumps])),
        "jumps": wanted,
        "jumps_made": len(jumps),
        "fallbacks": sum(sum(run.result.fallbacks.values()) for run in runs),
        "friction": summarise(np.max, np.array([one.friction for one in demands])),
        "force_n": summarise(np.max, np.array([one.force_n for one in demands])),
        "tracking_rad": summarise(np.mean, np.array([one.tracking_rad for one in demands])),
        "short_of_torque": summarise(np.mean, np.array([one.short_of_torque for one in demands])),
    }
    if any(run.planned_jumps > 1 for run in runs):
        totals = np.array([run.result.total_error_cm for run in runs if run.result.total_error_cm is not None])
        found |= {
            "total_error_cm": summarise(np.mean, totals),
            "total_abs_error_cm": summarise(np.mean, np.abs(totals)),
        }
    return found


def summarise(statistic: Callable[[np.ndarray], Any], values: np.ndarray) -> float | None:
    """A statistic of some values, rounded; None where there are none."""
    return round_value(statistic(values)) if len(values) else None


def standard_deviation(values: np.ndarray) -> float | None:
    """Standard deviation of a sample, rounded; None of fewer than two values."""
    return round_value(values.std(ddof=1)) if len(values) > 1 else None


def interval(values: np.ndarray, robots: Sequence[str], seed: int) -> list[float | None] | None:
    """95 % bootstrap interval of the mean: resamples robots, where there are several, else jumps; None of one jump."""
    if len(values) < 2:
        return None
    units = np.unique(robots, return_inverse=True)[1] if len(set(robots)) > 1 else np.arange(len(values))
    sums, counts = (np.bincount(units, weights) for weights in (values, np.ones(len(values))))
    drawn = np.random.default_rng(seed).integers(0, len(sums), (BOOTSTRAP_DRAWS, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    return [round_value(edge) for edge in np.percentile(means, [2.5, 97.5])]


def round_value(value: Any) -> Any:
    """A number rounded to three digits; truth values and None unchanged."""
    return value if value is None or isinstance(value, bool) else round(float(value), 3)


def mean_over_tasks(scored: Iterable[ScoredRun], tasks: Sequence[str], seed: int) -> dict[str, dict[str, Any]]:
    """Mean absolute error and its interval over some tasks, each with equal weight, by hardware and method, cm."""
    by: dict[str, dict[tuple[str, str], list[float]]] = {}
    for run in scored:
        if run.task in tasks and run.result.landings:
            of_task = by.setdefault(f"{run.hardware}/{run.method}", {}).setdefault((run.task, run.robot), [])
            of_task += [abs(jump.error_cm) for jump in run.result.landings]
    return {
        "mean_abs_error_cm": {
            key: round_value(np.mean([np.mean(v) for v in errors.values()])) for key, errors in by.items()
        },
        "mean_abs_error_ci95_cm": {key: task_mean_interval(errors, seed) for key, errors in by.items()},
    }


def task_mean_interval(errors: Mapping[tuple[str, str], Sequence[float]], seed: int) -> list[float | None] | None:
    """95 % bootstrap interval of the mean of the tasks' means; ``errors`` by task and robot, cm.

    None where a task was jumped once on the only robot: one jump says nothing of its scatter.
    """
    of_robots: dict[str, list[np.ndarray]] = {}
    for (_, robot), of_task in errors.items():
        of_robots.setdefault(robot, []).append(np.array(of_task))
    if len(of_robots) > 1:
        means = np.array([np.mean([of_task.mean() for of_task in tasks]) for tasks in of_robots.values()])
        return interval(means, list(of_robots), seed)
    rng, (tasks,) = np.random.default_rng(seed), of_robots.values()
    if min(len(of_task) for of_task in tasks) < 2:
        return None
    drawn = np.mean([rng.choice(v, (BOOTSTRAP_DRAWS, len(v))).mean(axis=1) for v in tasks], axis=0)
    return [round_value(edge) for edge in np.percentile(drawn, [2.5, 97.5])]


def landing_figures(scored: Sequence[ScoredRun], single: Sequence[str], seed: int) -> dict[str, Any]:
    """Contents of ``metrics/landing.json``; ``single`` names the tasks of the mean over tasks."""
    return tables(scored, seed) | mean_over_tasks(scored, single, seed) | {"seed": seed}


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a table for `dvc plots` and for spreadsheets."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["hardware"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
