"""How long does a tick of the exported C controller take, from the estimate to the joint commands?

A controller with tables as large as those of a robot that practised (108 simulated and 36 own jumps), compiled with
``gcc -O2``, on the estimates of one jump in closed loop from unseen blocks with a kick. Every tick is timed in C.
Given apart are the ticks that measure the stance, the one that decides what follows from it, and those in which a
quadratic program is solved, one in 25; and those of the learned MPC, with and without its quadratic program.
``python -m tests.benchmarks.exported_tick --json <file>``.
"""

import argparse
import os
import platform
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from leapgap.jumping.export.write import write_controller
from leapgap.jumping.models.planar import planar_robot
from leapgap.jumping.planning.reference import plan_reference
from leapgap.jumping.task import ContactSchedule, Target
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from tests.benchmarks import run_benchmark
from tests.benchmarks.tick.goal_shift_ticks import KINDS, OWN, kind_of
from tests.benchmarks.tick.timings import load
from tests.jumping.export.conftest import new_tracker, raw, record_jump
from tests.jumping.export.test_force_controller import export_learned

PROGRAM = """
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "jump_controller.h"
static JumpEstimate ticks[100000];
int main(int count, char **arguments) {
    size_t n = fread(ticks, sizeof *ticks, 100000, stdin);
    for (int r = 0; count > 1 && r < atoi(arguments[1]); r++) {
        jump_reset();
        for (size_t i = 0; i < n; i++) {
            struct timespec begin, end;
            JumpCommand command;
            clock_gettime(CLOCK_MONOTONIC, &begin);
            jump_tick(&ticks[i], &command);
            clock_gettime(CLOCK_MONOTONIC, &end);
            double us = (end.tv_sec - begin.tv_sec) * 1e6 + (end.tv_nsec - begin.tv_nsec) * 1e-3;
            fwrite(&us, sizeof us, 1, stdout);
        }
    }
    return 0;
}
"""


def tick_times(folder: Path, estimates: bytes, repeats: int) -> np.ndarray:
    """Times of all ticks of the controller in a folder, µs, (repeats, ticks)."""
    (folder / "timing.c").write_text(PROGRAM)
    sources = sorted(path.name for path in folder.glob("*.c") if path.name != "main.c")
    subprocess.run(["gcc", "-std=gnu99", "-O2", *sources, "-o", "timing", "-lm"], cwd=folder, check=True)
    done = subprocess.run([str(folder / "timing"), str(repeats)], input=estimates, capture_output=True, check=True)
    return np.frombuffer(done.stdout).reshape(repeats, -1)


def row(times: np.ndarray) -> dict[str, float]:
    """Median, p99, p99.9 and worst, µs."""
    values = {"median": np.median(times), "p99": np.percentile(times, 99), "p99_9": np.percentile(times, 99.9)}
    return {name: round(float(value), 2) for name, value in (values | {"worst": times.max()}).items()}


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=200, help="how often the jump is made")
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    chosen = parser.parse_args()
    repeats = 1 if chosen.tiny else chosen.repeats
    robot = Robot.load()
    before = load()
    reference = plan_reference(Target(0.5), planar_robot(robot), ContactSchedule())
    jump = record_jump(robot, reference, late=True)
    with tempfile.TemporaryDirectory() as name:
        tracker = new_tracker(robot, own=OWN, late=True)
        tables = write_controller(tracker, Path(name), {})
        times = tick_times(Path(name), raw(jump.estimates), repeats)
    with tempfile.TemporaryDirectory() as name:
        learned = tick_times(Path(name), raw(export_learned(robot, reference, Path(name))), repeats)
    solved = np.isin(np.arange(learned.shape[1]), np.arange(0, 800, 25))
    updates = int(tables.numbers["UPDATES"])
    kinds = np.array([kind_of(tick, updates) for tick in range(times.shape[1])])
    result = {
        "tick_us": row(times),
        **{f"{kind}_us": row(times[:, kinds == kind]) for kind in KINDS},
        "learned_us": row(learned[:, ~solved]),
        "learned_solved_us": row(learned[:, solved]),
        "ticks": int(times.size),
        "samples": int(tables.numbers["SAMPLES"]),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, gcc -O2, one thread",
        "load": {"before": before, "after": load()},
    }
    write_json(chosen.json, result)
    for name in ("tick_us", *(f"{kind}_us" for kind in KINDS), "learned_us", "learned_solved_us"):
        print(f"{name:18} " + ", ".join(f"{key} {value}" for key, value in result[name].items()))


if __name__ == "__main__":
    run_benchmark(main)
