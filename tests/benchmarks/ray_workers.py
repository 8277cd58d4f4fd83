"""How much faster do independent cases get with a second Ray worker, on the same node and on another?

Two kinds of cases: one waits for a second, so that other work on the machine matters little and the figure is that of
Ray's own overhead; the other simulates a robot with a hidden effect and replays its logs by the nominal robot in one
thread, about a second of a processor. On each cluster one case at a time and two at a time take turns, so that other
work meets both; a speed-up is the median over rounds of the time of the one over that of the other in the same round.
Workers have imported everything before the clock starts. Results are compared: where they differ, it ends. Without Ray,
and with ``--tiny``, a case runs in this process alone. What the file has is not measured again.
``python -m tests.benchmarks.ray_workers --json <file>``.
"""

import argparse
import hashlib
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import leapgap as lg
from leapgap import demo
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.executor import Executor, JobPool
from tests.benchmarks import run_benchmark
from tests.code import ROOT

CASES, ROUNDS = 6, 5
WAIT_S = 1.0
CLUSTERS = {"one node of two workers": (2,), "two nodes of one worker": (1, 1)}
"""Workers of each node."""
WARM_UP_S = 3.0


def case(number: int) -> str:
    """Digest of the logs of a robot with a hidden effect and of their replays by the nominal robot."""
    digest = hashlib.sha256()
    with patch("os.cpu_count", return_value=1):  # rollouts take a thread a core, and a worker is one core
        found = demo.simulate(number)
        replays = lg.replay(found.logs, found.robot)
    for log in [*found.logs, *replays]:
        for name in sorted(log.columns):
            digest.update(log[name].tobytes())
    return digest.hexdigest()


def wait(number: int) -> str:
    """A case that costs a second and no processor."""
    time.sleep(WAIT_S)
    return str(number)


KINDS: dict[str, Callable[[int], str]] = {"waiting": wait, "simulating": case}


def warm_up(_: int) -> int:
    """Runs a case, so that everything is imported, and holds the worker, so that every worker gets one."""
    case(0)
    time.sleep(WARM_UP_S)
    return os.getpid()


@contextmanager
def cluster(workers: Sequence[int]) -> Iterator[Executor]:
    """An executor on a Ray cluster of its own on this machine, with so many workers on each node, all of them ready."""
    import ray
    from ray.cluster_utils import Cluster

    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": workers[0]})
    try:
        for number in workers[1:]:
            nodes.add_node(num_cpus=number)
        nodes.wait_for_nodes()
        executor = Executor("ray", sum(workers), nodes.address)
        ready = set(executor.map(warm_up, range(sum(workers))))
        assert len(ready) == sum(workers), "every worker took part in the warm-up"
        yield executor
    finally:
        ray.shutdown()
        nodes.shutdown()


def timed(executor: Executor, function: Callable[[int], str], at_once: int) -> tuple[float, list[str]]:
    """Seconds of all cases, so many at a time, and the results."""
    pool = JobPool(executor._on_ray()[0], at_once)
    try:
        began = time.monotonic()
        results = list(pool.map(function, range(CASES)))
        return time.monotonic() - began, results
    finally:
        pool.close()


def measure(executor: Executor, function: Callable[[int], str], rounds: int) -> dict[str, Any]:
    """Median seconds of one and of two cases at a time, and the median, smallest and largest speed-up of a round."""
    seconds: dict[int, list[float]] = {1: [], 2: []}
    expected = None
    for number in range(rounds):
        for at_once in (1, 2) if number % 2 else (2, 1):
            took, results = timed(executor, function, at_once)
            expected = expected or results
            if results != expected:
                raise SystemExit("results differ from those of the first round")
            seconds[at_once].append(took)
            print(f"round {number + 1}, {at_once} at a time: {took:.1f} s", flush=True)
    gains = sorted(one / two for one, two in zip(seconds[1], seconds[2], strict=True))
    return {
        "rounds": rounds,
        "load_average": round(os.getloadavg()[1], 1),
        "seconds_one_worker": round(median(seconds[1]), 2),
        "seconds_two_workers": round(median(seconds[2]), 2),
        "speed_up": round(median(gains), 2),
        "speed_up_smallest": round(gains[0], 2),
        "speed_up_largest": round(gains[-1], 2),
    }


def main() -> None:
    """Measure what is not measured yet, and write the figures after each part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=ROOT / "metrics" / "timing" / "ray_workers.json")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--kind", choices=KINDS, default=None, help="one kind of cases alone")
    parser.add_argument("--tiny", action="store_true", help="this process alone; what it measures means nothing")
    chosen = parser.parse_args()
    known: dict[str, Any] = dict(read_json(chosen.json)) if chosen.json.is_file() else {}
    found = known | {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "cases": CASES}
    if chosen.tiny or find_spec("ray") is None:
        write_json(chosen.json, {**found, "digest": case(0)})
        return
    for name, workers in CLUSTERS.items():
        figures = found.setdefault(name, {})
        todo = [kind for kind in KINDS if kind not in figures and chosen.kind in (kind, None)]
        if not todo:
            continue
        with cluster(workers) as executor:
            for kind in todo:
                figures[kind] = measure(executor, KINDS[kind], chosen.rounds)
                write_json(chosen.json, found)


if __name__ == "__main__":
    run_benchmark(main)
