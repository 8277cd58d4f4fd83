"""Write the plans to a list of targets: one reference for each, and an index of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.problem import Grid, Limits, Problem, Weights
from leapgap.jumping.planning.reference import Gains, name_of, to_jump
from leapgap.jumping.planning.solve import Solution, solve_all
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.logs.log import write_log
from leapgap.runtime.atomic_io import write_json, write_metrics
from leapgap.runtime.output_folder import whole_folder

INDEX, BESIDE = "references.json", "beside"


@dataclass(frozen=True)
class OptimizeSettings:
    """Section ``optimize`` of the configuration."""

    robot: str | None
    planar: str | None
    out: str | None
    metrics: str | None
    timing: str | None
    """File of the solution times; ``beside``: beside the references."""
    targets: Any
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    weights: Weights = field(default_factory=Weights)
    limits: Limits = field(default_factory=Limits)
    gains: Gains = field(default_factory=Gains)

    def problems(self, targets: Iterable[Target], planar: PlanarRobot) -> list[Problem]:
        """The problem of each target."""
        grid = Grid(self.schedule)
        return [Problem(target, grid, planar, self.weights, self.limits) for target in targets]


def read_targets(pairs: Any, where: str) -> list[Target]:
    """Targets from a list of [x_m, z_m]; anything else is an ``InputError``."""
    if not isinstance(pairs, Sequence) or isinstance(pairs, str) or not pairs:
        raise InputError(where, repr(pairs), "a list of [x_m, z_m]", "write it like [[0.55,0.0],[0.5,0.1]]")
    targets = []
    for i, pair in enumerate(pairs):
        is_pair = isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2
        if not (is_pair and all(is_number(value) for value in pair)):
            raise InputError(
                f"{where}[{i}]",
                repr(pair),
                "two finite numbers [x_m, z_m]",
                "give distance and height in metres",
            )
        targets.append(Target(float(pair[0]), float(pair[1])))
    return targets


def is_number(value: Any) -> bool:
    """Whether a value is one finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def plan_all(problems: Sequence[Problem]) -> list[Solution]:
    """Solve all problems, and print what each solution cost."""
    solutions = []
    for found in solve_all(problems):
        solutions.append(found)
        name, seconds = name_of(found.problem.target), f"{found.seconds:.2f} s"
        print(f"{name}: cost {found.cost:.1f}, {found.iterations} iterations, {seconds}", flush=True)
    return solutions


def write_all(solutions: Sequence[Solution], settings: OptimizeSettings, out: Path, by: str) -> dict[str, float]:
    """Write references into a folder, and metrics and times where files are named; the cost of each reference.

    ``by``: the command that writes.
    """
    with whole_folder(out, by) as folder:
        write_references(solutions, folder, settings.gains)
        if settings.timing == BESIDE:
            write_json(folder / "timing.json", timing(solutions))
    if settings.timing not in (None, BESIDE):
        write_json(Path(settings.timing), timing(solutions))
    if settings.metrics is not None:
        write_metrics(Path(settings.metrics), metrics(solutions))
    print(f"{len(solutions)} references in {out}")
    return {f"cost/{name_of(one.problem.target)}": float(one.cost) for one in solutions}


def write_references(solutions: Iterable[Solution], folder: Path, gains: Gains) -> None:
    """A jump log for each solution, and ``references.json``, their list in order; no file holds a time stamp."""
    index = []
    for solution in solutions:
        jump = to_jump(solution, gains)
        file = f"{jump.name}.parquet"
        write_log(jump, folder / file)
        index.append(
            {
                "x_m": solution.problem.target.x_m,
                "z_m": solution.problem.target.z_m,
                "cost": solution.cost,
                "max_violation": solution.max_violation,
                "status": solution.status,
                "file": file,
            }
        )
    write_json(folder / INDEX, index)


def metrics(solutions: Iterable[Solution]) -> dict[str, dict[str, float] | float]:
    """Cost of each reference, by its name, and the greatest constraint violation of all."""
    solutions = list(solutions)
    return {
        "cost": {name_of(solution.problem.target): solution.cost for solution in solutions},
        "max_violation": max((solution.max_violation for solution in solutions), default=0.0),
    }


def timing(solutions: Iterable[Solution]) -> dict[str, dict[str, float]]:
    """Seconds and iterations of each reference, by its name; without the time to build the programme."""
    by_name = {name_of(solution.problem.target): solution for solution in solutions}
    return {
        "seconds": {name: solution.seconds for name, solution in by_name.items()},
        "iterations": {name: solution.iterations for name, solution in by_name.items()},
    }
