"""How much faster do independent cases get with more Ray workers, on one node and on two?

A case simulates a robot with a hidden effect and replays its logs by the nominal robot, about a second of a processor.
Arrangements take turns (A B C A B C …) on clusters that stay up, so that other work on the machine meets them all; a
speed-up is the median over rounds of the time with one worker over that of the same round. Workers are started and have
imported everything before the clock starts. Results are compared: an arrangement that changes a byte ends it.
Without Ray, and with ``--tiny``, cases run in this process alone. ``python -m tests.benchmarks.ray_workers --json
<file>``.
"""

import argparse
import hashlib
import os
import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from statistics import median
from typing import Any

import leapgap as lg
from leapgap import demo
from leapgap.atomic_io import write_json
from leapgap.executor import Executor
from tests.code import ROOT

CASES, ROUNDS = 8, 5
ARRANGEMENTS = {"1 worker": (1,), "2 workers": (2,), "2 nodes of 1 worker": (1, 1)}
"""Workers of each node; the first is the one that others are compared with."""
WARM_UP_S = 3.0


def case(number: int) -> str:
    """Digest of the logs of a robot with a hidden effect and of their replays by the nominal robot."""
    found, digest = demo.simulate(number), hashlib.sha256()
    for log in [*found.logs, *lg.replay(found.logs, found.robot)]:
        for name in sorted(log.columns):
            digest.update(log[name].tobytes())
    return digest.hexdigest()


def warm_up(_: int) -> int:
    """Runs a case, so that everything is imported, and holds the worker, so that every worker gets one."""
    case(0)
    time.sleep(WARM_UP_S)
    return os.getpid()


@contextmanager
def clusters(wanted: Mapping[str, Sequence[int]]) -> Iterator[dict[str, Executor]]:
    """An executor for each arrangement, each on a Ray cluster of its own on this machine."""
    import ray
    from ray.cluster_utils import Cluster

    started: dict[str, Any] = {}
    try:
        for name, workers in wanted.items():
            cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": workers[0]})
            started[name] = cluster
            for number in workers[1:]:
                cluster.add_node(num_cpus=number)
            cluster.wait_for_nodes()
        yield {name: Executor("ray", sum(wanted[name]), cluster.address) for name, cluster in started.items()}
    finally:
        ray.shutdown()
        for cluster in started.values():
            cluster.shutdown()


def timed(executor: Executor) -> tuple[float, list[str]]:
    """Seconds of all cases on workers that are ready, and the results."""
    if executor.kind == "ray":
        import ray

        ray.shutdown()  # leaves the cluster before, which stays up
        ready = set(executor.map(warm_up, range(executor.workers)))
        assert len(ready) == executor.workers, "every worker took part in the warm-up"
    began = time.monotonic()
    results = list(executor.map(case, range(CASES)))
    return time.monotonic() - began, results


def measure(executors: Mapping[str, Executor], rounds: int) -> dict[str, list[float]]:
    """Seconds of each arrangement in each round, those of a round one after another."""
    seconds: dict[str, list[float]] = {name: [] for name in executors}
    expected = None
    for number in range(rounds):
        for name, executor in executors.items():
            took, results = timed(executor)
            expected = expected or results
            if results != expected:
                raise SystemExit(f"{name}: results differ from those of the first arrangement")
            seconds[name].append(took)
            print(f"round {number + 1}, {name}: {took:.1f} s", flush=True)
    return seconds


def summary(seconds: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Median seconds, and the median, smallest and largest speed-up over the first arrangement in the same round."""
    first = next(iter(seconds.values()))
    found = {}
    for name, own in seconds.items():
        gains = sorted(one / other for one, other in zip(first, own, strict=True))
        found[name] = {
            "seconds_median": round(median(own), 2),
            "speed_up": {"median": round(median(gains), 2), "min": round(gains[0], 2), "max": round(gains[-1], 2)},
        }
    return found


def main() -> None:
    """Measure, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, default=ROOT / "metrics" / "timing" / "ray_workers.json")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--tiny", action="store_true", help="this process alone; what it measures means nothing")
    chosen = parser.parse_args()
    load = os.getloadavg()[0]
    if chosen.tiny or find_spec("ray") is None:
        seconds = measure({"this process": Executor("local", 1)}, 1 if chosen.tiny else chosen.rounds)
    else:
        with clusters(ARRANGEMENTS) as executors:
            seconds = measure(executors, chosen.rounds)
    machine = f"{platform.machine()}, {os.cpu_count()} cores, load average {load:.1f} before"
    write_json(chosen.json, {"machine": machine, "cases": CASES, "rounds": chosen.rounds, **summary(seconds)})


if __name__ == "__main__":
    main()
