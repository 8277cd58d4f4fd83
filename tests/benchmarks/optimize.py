"""How long does it take to plan a jump, from nothing and from a neighbour, beside a plain CasADi version?

The plain peer is the same problem as one would first write it: expanded Lagrangian dynamics by automatic
differentiation, IPOPT's defaults. Solver time only, 120 knots; building the programme is given beside. Run as
``python -m tests.benchmarks.optimize --json <file>``; limit it to one core (``taskset -c 0``) to compare.
"""

import argparse
import os
import platform
import time
from pathlib import Path

import casadi as ca
import numpy as np

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.dynamics import COORDINATES
from leapgap.jumping.planning.nlp import JumpNlp, Label
from leapgap.jumping.planning.problem import Grid, Limits, Problem, Weights
from leapgap.jumping.planning.solve import solve
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.runtime.atomic_io import write_json
from tests.benchmarks import run_benchmark
from tests.jumping.planning.lagrangian import residual

TARGETS = [Target(0.4), Target(0.5), Target(0.6), Target(0.7), Target(0.6, 0.2)]
NEIGHBOUR_M = 0.01


class PlainProgramme(JumpNlp):
    """The same programme with expanded Lagrangian dynamics."""

    def _dynamics(self) -> None:
        dt = self.grid.step_s
        lagrangian = residual(self.robot)
        for k in range(self.grid.steps):
            a = (self.v[k + 1] - self.v[k]) / dt
            balance = lagrangian(self.q[k], self.v[k], a, self.torque[k], self.force[k])
            self._constrain(balance, 0, 0, Label("dynamics", k, "equations of motion"))
            step = self.q[k + 1] - self.q[k] - dt * self.v[k + 1]
            self._constrain(step, 0, 0, Label("integration", k, f"{COORDINATES} positions"))


def plain_seconds(targets: list[Target]) -> list[float]:
    """Seconds of IPOPT with its defaults on the plain programme, for each target."""
    programme = PlainProgramme(Grid(ContactSchedule()), PlanarRobot(), Weights(), Limits())
    nlp = {"x": programme.w, "f": programme.cost, "g": programme.g}
    quiet = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    solver = ca.nlpsol("plain", "ipopt", nlp, quiet)
    seconds = []
    for target in targets:
        problem = Problem(target)
        (lower_w, upper_w), (lower_g, upper_g) = programme.w_bounds(problem), programme.g_bounds(problem)
        start = time.perf_counter()
        found = solver(x0=programme.first_guess, lbx=lower_w, ubx=upper_w, lbg=lower_g, ubg=upper_g)
        seconds.append(time.perf_counter() - start)
        cost, ours = float(found["f"]), solve(problem).cost
        if not np.isclose(cost, ours, rtol=1e-3):
            print(f"plain: cost {cost:.1f} instead of {ours:.1f} at {target}: another optimum")
    return seconds


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    chosen = parser.parse_args()
    file, targets = chosen.json, TARGETS[:1] if chosen.tiny else TARGETS
    start = time.perf_counter()
    solve(Problem(Target(0.3)))
    build_and_first = time.perf_counter() - start
    cold, warm = [], []
    for target in targets:
        solution = solve(Problem(target))
        cold.append(solution.seconds)
        for offset in (-NEIGHBOUR_M, NEIGHBOUR_M):
            neighbour = Target(target.x_m + offset, target.z_m)
            warm.append(solve(Problem(neighbour), near=solution).seconds)
    plain = plain_seconds(targets)
    result = {
        "cold_seconds_median": float(np.median(cold)),
        "cold_seconds_worst": max(cold),
        "warm_seconds_median": float(np.median(warm)),
        "warm_seconds_worst": max(warm),
        "plain_seconds_median": float(np.median(plain)),
        "plain_seconds_worst": max(plain),
        "ratio": float(np.median(cold) / np.median(plain)),
        "build_and_first_seconds": build_and_first,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, CasADi {ca.__version__}",
    }
    write_json(file, result)
    for name, value in result.items():
        print(f"{name}: {value if isinstance(value, str) else f'{value:.3f}'}")


if __name__ == "__main__":
    run_benchmark(main)
