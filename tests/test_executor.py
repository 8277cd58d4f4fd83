"""Jobs of several threads on shared workers."""

import os
import threading
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import pytest

from leapgap.errors import InputError
from leapgap.runtime.executor import Executor, JobPool


def square(x: int) -> int:
    if x < 0:
        raise InputError("x", str(x), "0 or more", "correct it")
    return x * x


def process_of(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


@pytest.mark.parametrize("kind", ["local", "joblib"])
def test_threads_share_a_pool_and_get_their_own_results_in_order(kind: str) -> None:
    with Executor(kind, 2).pool() as pool, ThreadPoolExecutor(3) as threads:
        asked = [threads.submit(lambda n=n: list(pool.map(square, range(n, n + 5)))) for n in (0, 10, 20)]
        assert [one.result() for one in asked] == [[x * x for x in range(n, n + 5)] for n in (0, 10, 20)]


def test_a_pool_of_processes_uses_all_of_them_and_leaves_none() -> None:
    with Executor("joblib", 2).pool() as pool:
        processes = set(pool.map(process_of, [0.5] * 8))
        assert len(processes) == 2
        assert os.getpid() not in processes
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_what_others_wait_for_goes_before_what_fills_the_time() -> None:
    begun: list[int] = []
    first, go = threading.Event(), threading.Event()

    def run(function: object, item: int) -> int:
        begun.append(item)
        first.set()
        go.wait()
        return item

    pool = JobPool(run, 1)
    fillers = pool.map_last(square, [1, 2])
    first.wait()
    needed = pool.map(square, [3, 4])
    go.set()
    assert list(needed) == [3, 4]
    assert list(fillers) == [1, 2]
    assert begun == [1, 3, 4, 2]
    pool.close()


@dataclass(frozen=True)
class Rig:
    """Something that several threads share; the first one that asks for ``total`` keeps it in here."""

    part: "Part"
    name: str = "rig"

    @cached_property
    def total(self) -> int:
        return 7


@dataclass(frozen=True)
class Part:
    """A part of which, while it is pickled, another thread asks for the total of the whole."""

    whole: list[Rig]

    def __getstate__(self) -> dict[str, list[Rig]]:
        for rig in self.whole:
            other = threading.Thread(target=getattr, args=(rig, "total"))
            other.start()
            other.join()
        return {"whole": []}


def parts_left(rig: Rig) -> int:
    return len(rig.part.whole) + rig.total


def test_a_job_is_sent_though_another_thread_keeps_a_value_in_what_they_share() -> None:
    rig = Rig(Part([]))
    rig.part.whole.append(rig)
    with Executor("joblib", 2).pool() as pool:
        assert list(pool.map(parts_left, [rig])) == [7]
    assert "total" in vars(rig)


@pytest.mark.parametrize("kind", ["local", "joblib"])
def test_an_error_reaches_who_asked_and_closing_cancels_the_rest(kind: str) -> None:
    with Executor(kind, 2).pool() as pool:
        with pytest.raises(InputError, match="0 or more"):
            list(pool.map(square, [1, -1]))
        assert list(pool.map(square, [3])) == [9], "the pool works on"
        late = pool.map(process_of, [0.3] * 20)
    with pytest.raises(CancelledError):
        list(late)
    with pytest.raises(CancelledError):
        list(pool.map(square, [1]))


def test_an_unknown_kind_is_told() -> None:
    with pytest.raises(InputError, match="local, joblib or ray"):
        Executor("slurm", 1)
