"""How long does an MPC update take, from the estimate to joint torques, beside a plain torch + numpy + OSQP version?

With networks of the paper's sizes (h 7-400-400-3, G 7-1000-1000-12, random orthogonal weights: time does not depend
on their values), on the states of logged jumps at 40 Hz, one thread. Versions take turns jump by jump, each of them
once untimed (a robot stands before it jumps, and its controller has long been running). The plain version
evaluates all networks in torch for the K samples at every update, multiplies the condensed matrices out as the paper
writes them, and solves with OSQP at its default tolerance, set up once and updated. Accuracy, N, is the largest
deviation of any force of a plan from the independent method of tests/jumping/control/test_qp.py. Run as
``python -m tests.benchmarks.mpc_tick --json <file>``; on a shared machine only ratios of one run mean something.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy and torch read it

import argparse
import gc
import platform
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from leapgap.jumping.control.mpc import ForcePlan, JumpMpc, MpcConfig
from leapgap.jumping.control.qp import QpConfig
from leapgap.jumping.control.tracking import PhaseGains, Reference
from leapgap.jumping.experiments.rig import LearnedMpcConfig
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import DeviationModel, PredictionModel
from leapgap.logs.pair_force import per_axis
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.controller import StateEstimate
from tests.benchmarks import run_benchmark
from tests.benchmarks.tick.plain_mpc import Plain
from tests.benchmarks.tick.random_networks import PAPER, SMALL, Networks, Weights, along_plan
from tests.benchmarks.tick.recorded_states import recorded_jumps
from tests.benchmarks.tick.timings import Timings, busy_cores, load
from tests.jumping.control.test_qp import by_least_distance

GRIDS = {"k10": TimeGrid(0.025, 0.1, 10), "k22": TimeGrid(0.025, 0.025, 22)}
"""As in the paper: variable steps, and fixed ones that see the landing too."""
ROUNDS = 2
LEARNED = LearnedMpcConfig().mpc
"""Weights and limits of the learned MPC, in deviations from the plan."""
TINY_STATES = 4
"""States of the one jump of a run that only shows that it starts."""
PLAIN_WHERE_BARS_WERE_SET_US = 1708.0
"""Median of torch + OSQP with the paper's networks on the machine for which the bars were set in microseconds."""


@dataclass
class VersionTimings(Timings):
    """Times and errors of one version of the controller."""

    qp_microseconds: list[float] = field(default_factory=list)
    error_n: float = 0.0

    def row(self) -> dict[str, float]:
        """See ``Timings``, and the largest error of a force, N."""
        return {**super().row(), "force_error_n": float(f"{self.error_n:.2g}")}


def measure(
    grid: TimeGrid, jumps: list[tuple[Reference, list[StateEstimate]]], robot: Robot, rounds: int
) -> dict[str, VersionTimings]:
    """All versions at all recorded states, taking turns jump by jump."""
    weights, small = Weights.of(PAPER), Weights.of(SMALL)
    kinds: dict[str, tuple[PredictionModel | DeviationModel, MpcConfig]] = {
        "daqp": (Networks(weights), MpcConfig(grid)),
        "osqp": (Networks(weights), MpcConfig(grid, qp=QpConfig("osqp"))),
        "daqp_small_networks": (Networks(small), MpcConfig(grid)),
        "daqp_along_plan": (along_plan(), replace(LEARNED, grid=grid)),
    }
    plain_kinds = {"torch_osqp": weights, "torch_osqp_small_networks": small}
    timed = {name: VersionTimings() for name in (*plain_kinds, *kinds)}
    for reference, told in jumps * rounds:
        warm, ours = (
            {name: JumpMpc(reference, robot, PhaseGains(), model, config) for name, (model, config) in kinds.items()}
            for _ in range(2)
        )
        plain = {name: Plain(reference, robot, w, MpcConfig(grid)) for name, w in plain_kinds.items()}
        gc.collect()
        gc.freeze()  # as a robot would: nothing of before is looked at again
        gc.disable()
        plans = {}
        for name, mpc in ours.items():
            follow_jump(warm[name], told, VersionTimings())
            plans[name] = follow_jump(mpc, told, timed[name])
        forces = {name: [] for name in plain}  # type: dict[str, list[np.ndarray]]
        for name, version in plain.items():
            for estimate in told:
                version.command(estimate)
            for estimate in told:
                timed[name].tick(lambda version=version, estimate=estimate: version.command(estimate))
                forces[name].append(version.force)
        gc.enable()
        judge(plans, forces, timed)
    return timed


def follow_jump(mpc: JumpMpc, told: list[StateEstimate], timed: VersionTimings) -> list[ForcePlan]:
    """The plans of one jump, timed; a fallback would be no measurement."""
    plans = []
    for estimate in told:
        timed.tick(lambda estimate=estimate: mpc.command(estimate))
        plan = mpc.plan_now
        if plan is None or plan.fallback is not None:
            raise SystemExit(f"at {estimate.time_s:g} s: {plan.fallback if plan else 'no plan'}")
        if plan.solution is not None:
            timed.qp_microseconds.append(1e6 * plan.solution.seconds)
        plans.append(plan)
    return plans


def judge(
    plans: dict[str, list[ForcePlan]], forces: dict[str, list[np.ndarray]], timed: dict[str, VersionTimings]
) -> None:
    """Largest deviation of each version's forces from the exact ones of the same networks."""
    for name in ("daqp", "daqp_small_networks", "daqp_along_plan"):
        same_networks = [name.replace("daqp", kind) for kind in ("daqp", "osqp", "torch_osqp")]
        for i, exact in enumerate(plans[name]):
            if exact.solution is None:
                raise SystemExit(f"{name}: a plan without its problem")
            x = by_least_distance(exact.solution.problem)
            pushing = per_axis(exact.horizon.share > 0)
            for kind in same_networks:
                force = plans[kind][i].force if kind in plans else forces[kind][i] if kind in forces else None
                if force is not None:
                    error = float(np.abs(force[pushing] - x).max())
                    timed[kind].error_n = max(timed[kind].error_n, error)


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    chosen = parser.parse_args()
    file = chosen.json
    torch.set_num_threads(1)
    robot = Robot.load()
    source, jumps = recorded_jumps(robot, 1 if chosen.tiny else 4)
    rounds = ROUNDS
    if chosen.tiny:
        jumps, rounds = [(reference, states[:TINY_STATES]) for reference, states in jumps[:1]], 1
    before = load()
    results = {name: measure(grid, jumps, robot, rounds) for name, grid in GRIDS.items()}
    after = load()
    with busy_cores():
        loaded = measure(GRIDS["k10"], jumps[:4], robot, 1)
    ours = {k: results[k]["daqp"].row() for k in GRIDS}
    result = {
        **{f"tick_us_{part}": {k: ours[k][part] for k in GRIDS} for part in ("median", "p99", "p99_9", "worst")},
        "qp_us_median": {
            b: {k: round(float(np.median(results[k][b].qp_microseconds)), 1) for k in GRIDS} for b in ("daqp", "osqp")
        },
        "force_error_n": {name: {k: results[k][name].row()["force_error_n"] for k in GRIDS} for name in results["k10"]},
        "ratio_to_torch_osqp": {k: ratio(results[k], "daqp", "torch_osqp", "median") for k in GRIDS},
        "ratio_to_torch_osqp_cpu": {k: ratio(results[k], "daqp", "torch_osqp", "cpu_median") for k in GRIDS},
        "bars": bars(results["k10"]),
        "versions": {k: {name: timed.row() for name, timed in results[k].items()} for k in GRIDS},
        "under_load": {"k10": {name: timed.row() for name, timed in loaded.items()}},
        "updates": {k: len(results[k]["daqp"].microseconds) for k in GRIDS},
        "states": f"{len(jumps)} {source} jumps",
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, one thread, torch {torch.__version__}",
        "load": {"before": before, "after": after},
    }
    write_json(file, result)
    for k, versions in {**results, "k10, one busy process a core": loaded}.items():
        print(f"{k}, µs a tick (median, p99, p99.9, worst; the same of this thread) and largest force error, N:")
        for name, timed in versions.items():
            print(f"  {name:27}" + "".join(f" {value:9.3g}" for value in timed.row().values()))
    for bar, figures in result["bars"].items():
        print(f"  {bar:33} " + ", ".join(f"{name} {value}" for name, value in figures.items()))
    print(f"{result['states']}, {result['machine']}")


def ratio(
    versions: dict[str, VersionTimings], ours: str, plain: str, part: str, plain_part: str | None = None
) -> float:
    """A figure of one version as a share of one of another."""
    return round(versions[ours].row()[part] / versions[plain].row()[plain_part or part], 4)


def bars(versions: dict[str, VersionTimings]) -> dict[str, dict[str, float]]:
    """What a tick may take, as shares of the median of torch + OSQP in this run, and what it took."""
    shares = {}
    for networks, limits in (("paper", {"median": 160, "p99": 300}), ("small", {"median": 100, "p99": 150})):
        ours = "daqp_small_networks" if networks == "small" else "daqp"
        for part, limit_us in limits.items():
            shares[f"{networks}_networks_{part}"] = {
                "bar": round(limit_us / PLAIN_WHERE_BARS_WERE_SET_US, 4),
                "share": ratio(versions, ours, "torch_osqp", part, "median"),
                "share_cpu": ratio(versions, ours, "torch_osqp", f"cpu_{part}", "cpu_median"),
            }
    return shares


if __name__ == "__main__":
    run_benchmark(main)
