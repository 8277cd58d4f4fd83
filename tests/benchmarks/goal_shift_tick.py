"""How long does a tick of the goal-shift controller take in Python, and the one that measures a stance late?

The estimates of one jump from unseen blocks with a kick, in closed loop, are given to new controllers, one jump each.
Kinds of ticks: those in the first 49 ms, in which the stance is measured; the one at 49 ms, which chooses goal and
target for it; the updates until the kick, one in 25 ticks, which watch for something sudden; those after it, each of
which predicts the landing and solves a program; all others, the first thirty of which prepare the programs for that
goal. The landing model is as large as that of a robot that practised 36 jumps.
``python -m tests.benchmarks.goal_shift_tick --json <file>``.
"""

import os

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy reads it

import argparse
import gc
import platform
from pathlib import Path

import numpy as np

from leapgap.jumping.control.goal_shift_jump import ShiftTracker
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.planning.reference import plan_reference
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.controller import StateEstimate
from tests.benchmarks import run_benchmark
from tests.benchmarks.tick.goal_shift_ticks import KINDS, OWN, SUDDEN_TICK, UPDATE_TICKS, kind_of
from tests.benchmarks.tick.timings import Timings, load
from tests.jumping.export.conftest import new_tracker, record_jump


def follow_jump(tracker: ShiftTracker, estimates: list[StateEstimate], timed: dict[str, Timings]) -> None:
    """One jump, timed tick by tick."""
    gc.collect()
    gc.freeze()  # as a robot would: nothing of before is looked at again
    gc.disable()
    for number, estimate in enumerate(estimates):
        timed[kind_of(number, tracker.grid.updates)].tick(lambda estimate=estimate: tracker.command(estimate))
    gc.enable()
    if tracker.fallbacks or tracker.late is not None:
        raise SystemExit(f"a jump that measures nothing: {dict(tracker.fallbacks)}")
    if tracker.watch is None or tracker.watch.age != tracker.grid.updates - SUDDEN_TICK // UPDATE_TICKS:
        raise SystemExit("the kick does not show at its update")


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--jumps", type=int, default=60)
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    chosen = parser.parse_args()
    robot, before = Robot.load(), load()
    jump = record_jump(robot, plan_reference(Target(0.5), planar_robot(robot), ContactSchedule()), late=True)
    timed = {kind: Timings() for kind in KINDS}
    jumps = 1 if chosen.tiny else chosen.jumps
    follow_jump(tracker(robot), jump.estimates, {kind: Timings() for kind in KINDS})  # untimed
    for _ in range(jumps):
        follow_jump(tracker(robot), jump.estimates, timed)
    result = {
        **{f"{kind}_us": times.row() for kind, times in timed.items()},
        "jumps": jumps,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, one thread, NumPy {np.__version__}",
        "load": {"before": before, "after": load()},
    }
    write_json(chosen.json, result)
    for kind in KINDS:
        print(f"{kind:16}" + ", ".join(f"{name} {value}" for name, value in result[f"{kind}_us"].items()))
    print(f"{jumps} jumps, {result['machine']}, load {result['load']}")


def tracker(robot: Robot) -> ShiftTracker:
    """A controller before its jump."""
    return new_tracker(robot, own=OWN, late=True)


if __name__ == "__main__":
    run_benchmark(main)
