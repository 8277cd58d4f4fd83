"""How long does a diagnosis take against all effects at all places, and how near is that to the roll-outs it needs?

Sixteen logs (the published jumps where they are, else simulated ones) and a blind case of four. Beside them roll-outs
of one log a second, in the same run. Run as ``python -m tests.benchmarks.diagnose --json <file>`` on an idle machine.
"""

import argparse
import itertools
import os
import platform
import time
from dataclasses import replace
from pathlib import Path

from omegaconf import OmegaConf

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.log import Log, read_logs
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.runtime.atomic_io import write_json
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from stages.common import read_config
from tests.benchmarks import run_benchmark

ROWS = 1101


class Counting(Replayer):
    """A replayer that counts what it simulates."""

    steps = 0

    def replay_pieces(self, trials, starts, rows):  # type: ignore[no-untyped-def]
        """Count the steps of pieces."""
        lengths = [rows] * len(trials) if isinstance(rows, int) else rows
        each = zip(trials, starts, lengths, strict=True)
        Counting.steps += sum(len(s.rows) * self.substeps(t.log) * (length - 1) for t, s, length in each)
        return super().replay_pieces(trials, starts, rows)

    def true_motions(self, trials: list[Rollout], rows: int | None = None) -> list[Motion]:  # type: ignore[override]
        """Count the steps of whole logs."""
        Counting.steps += sum(min(len(t.log), rows or len(t.log)) * self.substeps(t.log) for t in trials)
        return super().true_motions(trials, rows)


def tiny(settings: Settings) -> Settings:
    """Settings of a diagnosis of one effect in seconds."""
    return replace(
        settings, effects=["joint_damping"], folds=2, most_pieces=4, noise_draws=1, bootstrap_draws=20, best=False
    )


def logs(folder: str, number: int) -> list[Log]:
    """So many logs of a folder, repeated where it has fewer."""
    jumps = read_logs(Path(folder)) if Path(folder).is_dir() else []
    if not jumps:
        raise InputError(folder, "no jumps", "jumps of the pipeline", "run dvc repro first")
    repeated = itertools.islice(itertools.cycle(enumerate(jumps)), number)
    return [Log(f"{jump.name}_{i}", jump.columns, jump.info) for i, (_, jump) in enumerate(repeated)]


def time_diagnosis(jumps: list[Log], robot: Robot, settings: Settings) -> tuple[float, int]:
    """Seconds of one diagnosis, and simulated steps."""
    Counting.steps = 0
    began = time.perf_counter()
    diagnose(jumps, robot, settings)
    return time.perf_counter() - began, Counting.steps


def raw_limit(jumps: list[Log], robot: Robot) -> float:
    """Steps a second of plain roll-outs of whole logs on all cores."""
    replayer = Replayer(robot, terrain_slots=max(1, *(len(j.info.terrain) for j in jumps)))
    trials = [Rollout(jump) for jump in jumps]
    replayer.motions(trials, ROWS)
    began = time.perf_counter()
    motions = replayer.motions(trials, ROWS)
    return sum(len(m.qpos) - 1 for m in motions) / (time.perf_counter() - began)


def main() -> None:
    """Run the measurement and write its figures as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--json", type=Path)
    parser.add_argument("--tiny", action="store_true", help="smallest counts, to see that it runs")
    arguments = parser.parse_args()
    import leapgap.diagnosis.diagnose as engine

    engine.Replayer = Counting  # type: ignore[misc]
    robot = Robot.load()
    settings = read_config(Settings, OmegaConf.load("params.yaml").diagnose.settings, "diagnose.settings")
    settings = tiny(settings) if arguments.tiny else settings
    real = "data/jumps/published" if any(Path("data/jumps/published").glob("*.parquet")) else "data/jumps/damped"
    many, few = (2, 2) if arguments.tiny else (16, 4)
    sixteen, four = logs(real, many), logs("data/jumps/damped", few)
    limit = raw_limit(sixteen, robot)
    seconds_16, steps_16 = time_diagnosis(sixteen, robot, settings)
    seconds_4, steps_4 = time_diagnosis(four, robot, settings)
    found = {
        "seconds_16_jumps": seconds_16,
        "seconds_blind_case": seconds_4,
        "steps_16_jumps": steps_16,
        "steps_blind_case": steps_4,
        "steps_per_second": (steps_16 + steps_4) / (seconds_16 + seconds_4),
        "steps_per_second_rollout": limit,
        "share_of_rollout": (steps_16 + steps_4) / (seconds_16 + seconds_4) / limit,
        "jumps": f"{many} of {real}",
        "machine": f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores",
    }
    for key, value in found.items():
        print(f"{key}: {value if isinstance(value, str) else f'{value:.4g}'}")
    if arguments.json is not None:
        write_json(arguments.json, found)


if __name__ == "__main__":
    run_benchmark(main)
