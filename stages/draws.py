"""Several draws of landings as one file of figures, and tables of docs/research/experiments.md, by `make kicked`.

The first word is the folder of the runs of ``stages.land``, each with a seed of its own; the second is the file.

Examples:

    python -m stages.draws data/kicked metrics/landing_kicked.json
"""

import csv
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.experiments.landing_experiment import FIGURES, TABLE, round_value
from leapgap.runtime.atomic_io import read_json, write_metrics
from stages.common import run_command
from stages.compose import compose_conf

AMOUNT = re.compile(r"[+-][\d.]+ ")
Row = Mapping[str, str]


def rows_of_draws(folder: Path) -> dict[str, list[Row]]:
    """Rows of all tables of landings below a folder, by their draw, ``seed_11``."""
    found: dict[str, list[Row]] = defaultdict(list)
    for path in sorted(folder.rglob(TABLE)):
        with path.open(newline="", encoding="utf-8") as file:
            found[f"seed_{read_json(path.with_name(FIGURES))['seed']}"] += csv.DictReader(file)
    if not found:
        raise InputError(folder, f"no {TABLE}", "results of stages.land", "make kicked")
    return dict(sorted(found.items()))


def merge(draws: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
    """Figures by robot, method, draw and task under ``robots``; by kind, method and robot under ``disturbances``."""
    robots: dict[str, Any] = {}
    of_kinds: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    for seed, rows in draws.items():
        for (robot, method, task), runs in grouped(rows).items():
            error, pitch = (np.abs([float(run[name]) for run in runs]) for name in ("error_cm", "pitch_deg"))
            success = [run["success"] == "True" for run in runs]
            figures = {"abs_error_cm": error.mean(), "worst_pitch_deg": pitch.max(), "success": np.mean(success)}
            of_draw = robots.setdefault(robot, {}).setdefault(method, {}).setdefault(seed, {})
            for name, value in figures.items():
                of_draw.setdefault(name, {})[task] = round_value(value)
            for run, one in zip(runs, error, strict=True):
                if run["disturbance"]:
                    of_kinds[AMOUNT.sub("", run["disturbance"]), method, robot].append(one)
    kinds: dict[str, Any] = {}
    for (kind, method, robot), errors in sorted(of_kinds.items()):
        of_robots = kinds.setdefault(kind, {}).setdefault(method, {})
        of_robots[robot] = {"abs_error_cm": round_value(np.mean(errors)), "jumps": len(errors)}
    return {"robots": robots, "disturbances": kinds}


def grouped(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[Row]]:
    """Rows by robot, method and task, drawn robots as ``random:5``."""
    found: dict[tuple[str, str, str], list[Row]] = defaultdict(list)
    for row in rows:
        number = row["robot"].removeprefix(row["hardware"]).lstrip("_")
        robot = f"{row['hardware']}:{number}" if number else row["hardware"]
        found[robot, row["method"], row["task"]].append(row)
    return found


def single_tasks() -> list[str]:
    """Tasks of the headline mean, as conf/land states them."""
    return list(compose_conf()["land"]["single"])


def tables(figures: Mapping[str, Any]) -> str:
    """Robots by task, and disturbances by kind, in cm, as Markdown."""
    headline = single_tasks()
    draws = [draw for methods in figures["robots"].values() for seeds in methods.values() for draw in seeds.values()]
    tasks = list(dict.fromkeys(task for draw in draws for task in draw["abs_error_cm"]))
    single, others = [task for task in tasks if task in headline], [task for task in tasks if task not in headline]
    head = ["", "draws", "mean of the single ones", *single, *others, "pitch", "stand"]
    lines = [line(head), line(["---"] * len(head))]
    for robot, methods in figures["robots"].items():
        lines += [
            line([f"`{robot}`: {method}", *cells(list(seeds.values()), single, others)])
            for method, seeds in methods.items()
        ]
    lines += ["", line(["", "method", "jumps a robot", "mean over robots (range)"]), line(["---"] * 4)]
    for kind, methods in figures["disturbances"].items():
        for method, robots in methods.items():
            lines.append(line([kind, method, str(next(iter(robots.values()))["jumps"]), span(robots)]))
    return "\n".join(lines)


def cells(
    draws: Sequence[Mapping[str, Mapping[str, float]]], single: Sequence[str], others: Sequence[str]
) -> list[str]:
    """Cells of one method on one robot: means over its draws, empty for tasks that it was not run at; those of
    ``others`` with the range over draws."""
    tasks = (*single, *others)
    errors = {task: [draw["abs_error_cm"][task] for draw in draws if task in draw["abs_error_cm"]] for task in tasks}
    means = {task: float(np.mean(of_task)) for task, of_task in errors.items() if of_task}
    told = {task: f"{means[task]:.1f}" if task in means else "" for task in tasks}
    for task in others:
        if len(errors[task]) > 1:
            told[task] += f" ({min(errors[task]):.1f}–{max(errors[task]):.1f})"
    pitch = max(max(draw["worst_pitch_deg"].values()) for draw in draws)
    stand = np.mean([value for draw in draws for value in draw["success"].values()])
    five = f"{np.mean([means[task] for task in single]):.2f}" if single and means.keys() >= {*single} else ""
    return [str(len(draws)), five, *told.values(), f"{pitch:.0f}°", f"{stand:.0%}"]


def span(robots: Mapping[str, Mapping[str, float]]) -> str:
    """Mean over robots, with the smallest and the largest."""
    values = [one["abs_error_cm"] for one in robots.values()]
    return f"{np.mean(values):.1f} ({min(values):.1f} to {max(values):.1f})"


def line(cells: Iterable[str]) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def draws(words: list[str]) -> None:
    """Merge the draws of a folder into a file, and print their tables."""
    if len(words) != 2:
        raise InputError("stages.draws", f"{len(words)} words", "a folder and a file", "see --help")
    found = merge(rows_of_draws(Path(words[0])))
    write_metrics(Path(words[1]), found)
    print(tables(found))


if __name__ == "__main__":
    run_command("draws", draws)
