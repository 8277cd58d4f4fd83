"""Cases on a Ray cluster of two nodes, each a raylet of its own on this machine: what a lost worker or node costs."""

import hashlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from leapgap.runtime.executor import Executor

pytest.importorskip("ray", reason="no ray: pip install 'ray>=2.60,<3' (extra ray)")

NUMBERS = list(range(12))
JOB_S = 0.5


def job(folder: Path, fatal: int | None, number: int) -> tuple[int, np.ndarray]:
    """A result that is too large to be sent along with its task, so that it lies on the node that computed it.

    It notes the node that ran it. Number ``fatal`` kills its own process the first time.
    """
    import ray

    node = ray.get_runtime_context().get_node_id() if ray.is_initialized() else "local"
    (folder / f"{number}.{node}.{os.getpid()}").touch()
    if number == fatal and len(list(folder.glob(f"{number}.*"))) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(JOB_S)
    return number, np.random.default_rng(number).standard_normal(40_000)


def digests(results: Iterator[tuple[int, np.ndarray]]) -> list[tuple[int, str]]:
    return [(number, hashlib.sha256(values.tobytes()).hexdigest()) for number, values in results]


def expected() -> list[tuple[int, str]]:
    return digests((n, np.random.default_rng(n).standard_normal(40_000)) for n in NUMBERS)


@pytest.fixture
def cluster() -> Iterator[object]:
    """Two nodes of one core each; the first is the head."""
    import ray
    from ray.cluster_utils import Cluster

    soon = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 1000, "health_check_failure_threshold": 5}
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "_system_config": soon})
    cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    yield cluster
    ray.shutdown()
    cluster.shutdown()


def nodes_of(folder: Path) -> set[str]:
    """The nodes that have begun a job."""
    return {path.name.split(".")[1] for path in folder.iterdir()}


def test_a_function_that_workers_cannot_import_is_sent_whole(cluster: object) -> None:
    """As one of the script that was started is."""
    with Executor("ray", 2, cluster.address).pool() as pool:  # type: ignore[attr-defined]
        assert list(pool.map(lambda number: 2 * number, [1, 2])) == [2, 4]


def test_a_killed_worker_loses_no_case_and_changes_no_byte(cluster: object, tmp_path: Path) -> None:
    executor = Executor("ray", 2, cluster.address)  # type: ignore[attr-defined]
    with executor.pool() as pool:
        found = digests(pool.map(partial(job, tmp_path, 3), NUMBERS))
    assert found == expected()
    assert len(list(tmp_path.glob("3.*"))) == 2, "the case whose worker was killed ran again"
    assert len(nodes_of(tmp_path)) == 2, "both nodes worked"


def test_a_killed_node_loses_no_case_and_changes_no_byte(cluster: object, tmp_path: Path) -> None:
    """The node that is killed holds results that were computed but not fetched: those cases run again, too."""
    executor, (_, second) = Executor("ray", 2, cluster.address), cluster.list_all_nodes()  # type: ignore[attr-defined]

    def kill_second() -> None:
        while sum(second.node_id in path.name for path in tmp_path.iterdir()) < 2:
            time.sleep(0.05)
        cluster.remove_node(second, allow_graceful=False)  # type: ignore[attr-defined]

    killer = threading.Thread(target=kill_second, daemon=True)
    killer.start()
    results = executor.map(partial(job, tmp_path, None), NUMBERS)
    first = next(results)
    killer.join()
    assert digests(iter([first, *results])) == expected()
    again = [number for number in NUMBERS if len(list(tmp_path.glob(f"{number}.*"))) > 1]
    assert again, "what the killed node had computed or was computing ran again"
