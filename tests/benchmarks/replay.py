"""How fast are whole jumps replayed, and how near is that to MuJoCo's own step?

Sixteen logs of 1.1 s on one core: the published jumps where they are, else as many simulated ones. Beside them, in the
same run, plain ``mj_step`` from the same first state with the same controls. Run as
``python -m tests.benchmarks.replay --json <file>``.
"""

import argparse
import itertools
import os
import platform
import time
from pathlib import Path

import mujoco
import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log, read_logs
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.benchmarks import run_benchmark

JUMPS, ROWS, REPEATS = 16, 1101, 7


def logs() -> list[Log]:
    """Sixteen jump logs of the pipeline."""
    for folder in ("data/jumps/published", "data/jumps/damped", "data/jumps/simulated"):
        if Path(folder).is_dir() and (jumps := read_logs(Path(folder))):
            return list(itertools.islice(itertools.cycle(jumps), JUMPS))
    raise InputError("data/jumps", "no jumps", "jumps of the pipeline", "run dvc repro first")


def raw_steps(replayer: Replayer, trial: Rollout, rows: int) -> float:
    """Seconds of plain ``mj_step`` over the same rows with the same controls, gains of the first row throughout."""
    model = replayer.model(trial)
    data = mujoco.MjData(model)
    state = replayer.first_state(trial)
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    controls = replayer._controls(trial, rows)
    began = time.perf_counter()
    for control in controls[:-1]:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
    return time.perf_counter() - began


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    chosen = parser.parse_args()
    count, rows, repeats = (1, 51, 1) if chosen.tiny else (JUMPS, ROWS, REPEATS)
    os.sched_setaffinity(0, {sorted(os.sched_getaffinity(0))[0]})
    jumps, robot = logs()[:count], Robot.load()
    replayer = Replayer(robot, terrain_slots=max(len(jump.info.terrain) for jump in jumps), threads=1)
    trials = [Rollout(jump) for jump in jumps]
    replayer.motions(trials, rows)  # compile the models
    whole, raw = [], []
    for _ in range(repeats):  # alternate, so that a busy machine slows both
        began = time.perf_counter()
        replayer.motions(trials, rows)
        whole.append(time.perf_counter() - began)
        raw.append(sum(raw_steps(replayer, trial, rows) for trial in trials))
    steps = count * (rows - 1)
    found = {
        "seconds_16_jumps": float(np.median(whole)),
        "steps_per_second": steps / float(np.median(whole)),
        "steps_per_second_mj_step": steps / float(np.median(raw)),
        "share_of_mj_step": float(np.median(np.array(raw) / np.array(whole))),
        "machine": f"{platform.processor() or platform.machine()}, one core",
    }
    for key, value in found.items():
        print(f"{key}: {value if isinstance(value, str) else f'{value:.4g}'}")
    if (path := chosen.json) is not None:
        write_json(path, found)


if __name__ == "__main__":
    run_benchmark(main)
