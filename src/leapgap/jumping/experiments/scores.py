"""Landing figures of methods and tasks, as tables."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.atomic_io import whole_file
from leapgap.jumping.experiments.trial_spec import TrialResult

BOOTSTRAP_DRAWS = 1000


@dataclass(frozen=True)
class Scored:
    """One run of a method at a task."""

    hardware: str
    """Its variant; the robots drawn from one variant count together."""
    robot: str
    """Which robot of the variant, as in places."""
    method: str
    task: str
    number: int
    wanted: int
    """Jumps of the task."""
    done: TrialResult

    @property
    def key(self) -> str:
        """As in the metrics."""
        return f"{self.hardware}/{self.method}/{self.task}"

    def rows(self) -> Iterator[dict[str, Any]]:
        """One a jump that was made, with what the run asked of the robot."""
        about = {name: getattr(self, name) for name in ("hardware", "robot", "method", "task", "number")}
        for jump, landing in enumerate(self.done.landings):
            figures = {name: tidy(value) for name, value in asdict(landing).items()}
            conduct = {name: tidy(value) for name, value in asdict(self.done.conduct).items()}
            yield about | {"jump": jump} | figures | conduct | {"fallbacks": sum(self.done.fallbacks.values())}


def tables(scored: Iterable[Scored], seed: int) -> dict[str, dict[str, Any]]:
    """``{"abs_error_cm": {"worn/ours/jump_60": 1.2, …}, …}``; intervals are 95 %, as in ``interval``."""
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
    jumps = [landing for run in runs for landing in run.done.landings]
    wanted = sum(run.wanted for run in runs)
    error = np.array([jump.error_cm for jump in jumps])
    robots = [run.robot for run in runs for _ in run.done.landings]
    pitch = np.array([jump.pitch_deg for jump in jumps])
    conducts = [run.done.conduct for run in runs]
    found = {
        "error_cm": of(np.mean, error),
        "error_ci95_cm": interval(error, robots, seed),
        "error_sd_cm": sd(error),
        "abs_error_cm": of(np.mean, np.abs(error)),
        "abs_error_ci95_cm": interval(np.abs(error), robots, seed),
        "worst_error_cm": of(np.max, np.abs(error)),
        "success": tidy(sum(jump.success for jump in jumps) / wanted),
        "landing_pitch_deg": of(np.mean, np.abs(pitch)),
        "worst_pitch_deg": of(np.max, np.abs(pitch)),
        "apex": of(np.mean, np.array([jump.apex for jump in jumps])),
        "jumps": wanted,
        "jumps_made": len(jumps),
        "fallbacks": sum(sum(run.done.fallbacks.values()) for run in runs),
        "friction": of(np.max, np.array([conduct.friction for conduct in conducts])),
        "force_n": of(np.max, np.array([conduct.force_n for conduct in conducts])),
        "tracking_rad": of(np.mean, np.array([conduct.tracking_rad for conduct in conducts])),
        "short_of_torque": of(np.mean, np.array([conduct.short_of_torque for conduct in conducts])),
    }
    if any(run.wanted > 1 for run in runs):
        totals = np.array([run.done.total_error_cm for run in runs if run.done.total_error_cm is not None])
        found |= {"total_error_cm": of(np.mean, totals), "total_abs_error_cm": of(np.mean, np.abs(totals))}
    return found


def of(statistic: Callable[[np.ndarray], Any], values: np.ndarray) -> float | None:
    """Of what there is; None of nothing."""
    return tidy(statistic(values)) if len(values) else None


def sd(values: np.ndarray) -> float | None:
    """Standard deviation of a sample."""
    return tidy(values.std(ddof=1)) if len(values) > 1 else None


def interval(values: np.ndarray, robots: Sequence[str], seed: int) -> list[float | None] | None:
    """Of the mean: robots drawn again with all they did, where there are several; else jumps drawn again."""
    if not len(values):
        return None
    units = np.unique(robots, return_inverse=True)[1] if len(set(robots)) > 1 else np.arange(len(values))
    sums, counts = (np.bincount(units, weights) for weights in (values, np.ones(len(values))))
    drawn = np.random.default_rng(seed).integers(0, len(sums), (BOOTSTRAP_DRAWS, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    return [tidy(edge) for edge in np.percentile(means, [2.5, 97.5])]


def tidy(value: Any) -> Any:
    """Numbers to what a table shows; truth values and None as they are."""
    return value if value is None or isinstance(value, bool) else round(float(value), 3)


def overall(scored: Iterable[Scored], tasks: Sequence[str], seed: int) -> dict[str, dict[str, Any]]:
    """Mean absolute error over some tasks by hardware and method, each task counting alike, cm, with its interval."""
    by: dict[str, dict[tuple[str, str], list[float]]] = {}
    for run in scored:
        if run.task in tasks and run.done.landings:
            of_task = by.setdefault(f"{run.hardware}/{run.method}", {}).setdefault((run.task, run.robot), [])
            of_task += [abs(jump.error_cm) for jump in run.done.landings]
    return {
        "mean_abs_error_cm": {key: tidy(np.mean([np.mean(v) for v in of.values()])) for key, of in by.items()},
        "mean_abs_error_ci95_cm": {key: interval_of_tasks(of, seed) for key, of in by.items()},
    }


def interval_of_tasks(errors: Mapping[tuple[str, str], Sequence[float]], seed: int) -> list[float | None] | None:
    """Of the mean of the tasks' means, of errors by task and robot."""
    of_robots: dict[str, list[np.ndarray]] = {}
    for (_, robot), of_task in errors.items():
        of_robots.setdefault(robot, []).append(np.array(of_task))
    if len(of_robots) > 1:
        means = np.array([np.mean([of_task.mean() for of_task in tasks]) for tasks in of_robots.values()])
        return interval(means, list(of_robots), seed)
    rng, (tasks,) = np.random.default_rng(seed), of_robots.values()
    drawn = np.mean([rng.choice(v, (BOOTSTRAP_DRAWS, len(v))).mean(axis=1) for v in tasks], axis=0)
    return [tidy(edge) for edge in np.percentile(drawn, [2.5, 97.5])]


def landing_figures(scored: Sequence[Scored], single: Sequence[str], seed: int) -> dict[str, Any]:
    """All that ``metrics/landing.json`` holds; ``single`` are the tasks whose mean is the headline."""
    return tables(scored, seed) | overall(scored, single, seed) | {"seed": seed}


def write_rows(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write a table for `dvc plots` and for spreadsheets."""
    with whole_file(path) as beside, beside.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else ["hardware"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
