"""Execution of independent cases: in this process, in parallel processes, or on a Ray cluster."""

import copyreg
import io
import itertools
import os
import pickle
import queue
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from types import FunctionType
from typing import Any, TypeVar

from leapgap.errors import InputError, needs
from leapgap.runtime.processes import starting_workers

UNUSED = r"\d+ tasks (have been|which were)|A worker stopped"
"""What joblib warns of where an error ends the work, which says enough, and where it replaces a worker that grew."""

Item = TypeVar("Item")
Result = TypeVar("Result")
Run = Callable[[Callable[[Any], Any], Any], Any]  # applies a function to one item somewhere, and waits for the result


class JobPool:
    """Runs the jobs of several threads on shared workers; a job of a lower rank goes before those that wait.

    Results do not depend on the order. ``close`` ends it: jobs that wait are cancelled.
    """

    def __init__(self, run: Run, workers: int) -> None:
        """``run`` is called from as many threads as there are workers."""
        self._run = run
        self._waiting: queue.PriorityQueue[tuple[float, int, tuple[Future[Any], Any, Any] | None]] = (
            queue.PriorityQueue()
        )
        self._numbers = itertools.count()
        self._closed = False
        self._lock = threading.Lock()
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(workers)]
        for thread in self._threads:
            thread.start()

    def map(self, function: Callable[[Item], Result], items: Sequence[Item], rank: float = 0) -> Iterator[Result]:
        """Results in the order of the items, all of which wait for a worker from now on."""
        futures = [self._submit(function, item, rank) for item in items]
        return (future.result() for future in futures)

    def map_last(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """``map`` for items whose results no further item waits for: they fill the time of idle workers."""
        return self.map(function, items, rank=1)

    def close(self) -> None:
        """Cancel what waits, and wait for what runs."""
        with self._lock:
            self._closed = True
            for _ in self._threads:
                self._waiting.put((-1, next(self._numbers), None))
        for thread in self._threads:
            thread.join()
        while not self._waiting.empty():
            _, _, job = self._waiting.get()
            if job is not None:
                job[0].cancel()

    def _submit(self, function: Callable[[Item], Result], item: Item, rank: float) -> "Future[Result]":
        future: Future[Result] = Future()
        with self._lock:
            if self._closed:
                future.cancel()
            else:
                self._waiting.put((rank, next(self._numbers), (future, function, item)))
        return future

    def _work(self) -> None:
        while (job := self._waiting.get()[2]) is not None:
            future, function, item = job
            try:
                future.set_result(self._run(function, item))
            except BaseException as error:
                future.set_exception(error)


@dataclass(frozen=True)
class Executor:
    """How and where independent cases run; configuration group ``executor``."""

    kind: str  # one of local, joblib and ray
    workers: int  # number of processes; unused by local
    address: str | None = None  # address of the Ray cluster; None starts one on this machine

    def __post_init__(self) -> None:
        """Refuse an unknown kind, and a number of processes that means nothing; −1 is one for each core, as joblib."""
        if self.kind not in ("local", "joblib", "ray"):
            raise InputError("executor.kind", self.kind, "local, joblib or ray", "choose one: executor=joblib")
        if self.workers < 1 and self.workers != -1:
            raise ValueError(f"workers {self.workers}: 1 or more, or -1 for all cores")

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        """Results in the order of the items; items are independent, so that the kind changes no result."""
        if self.kind == "local":
            yield from map(function, items)
        elif self.kind == "joblib":
            with needs("pipeline"):
                import joblib

            warnings.filterwarnings("ignore", UNUSED)
            with starting_workers() as (initializer, arguments):
                parallel = joblib.Parallel(
                    self.workers, return_as="generator", batch_size=1, initializer=initializer, initargs=arguments
                )
                results = parallel(joblib.delayed(function)(item) for item in items)
            yield from results
        else:
            ray = self._ray()
            remote = ray.remote(num_cpus=1)(_apply)  # Ray takes functions alone, and a case may be a partial one
            yield from map(ray.get, [remote.remote(function, item) for item in items])

    @contextmanager
    def pool(self) -> Iterator[JobPool]:
        """Workers for several threads at once, which end with this block; without processes, one job at a time."""
        workers = (os.cpu_count() or 1) if self.workers == -1 else self.workers
        processes: ProcessPoolExecutor | None = None
        run: Run = _apply
        if self.kind == "joblib" and workers > 1:
            with starting_workers() as (initializer, arguments):
                processes = ProcessPoolExecutor(
                    workers, mp_context=get_context("spawn"), initializer=initializer, initargs=arguments
                )
                for _ in range(workers):  # each starts a process, while Ctrl-C is ignored
                    processes.submit(int)
            started = processes

            def run(function: Callable[[Any], Any], item: Any) -> Any:
                return started.submit(_apply_pickled, snapshot((function, item))).result()

        elif self.kind == "ray":
            run, workers = self._on_ray()
        pool = JobPool(run, 1 if run is _apply else workers)
        try:
            yield pool
        finally:
            pool.close()
            if processes is not None:
                processes.shutdown(cancel_futures=True)

    def _on_ray(self) -> tuple[Run, int]:
        """How a job runs on the cluster, and how many do at once."""
        ray = self._ray()
        from ray.cloudpickle import CloudPickler

        class Pickler(SnapshotPickler, CloudPickler):
            """Sends functions of the script that was started, too, which workers cannot import."""

        remote = ray.remote(num_cpus=1)(_apply_pickled)
        cores = int(ray.cluster_resources()["CPU"])
        return lambda function, item: ray.get(remote.remote(snapshot((function, item), Pickler))), cores

    def _ray(self) -> Any:
        """The package, connected to the cluster."""
        try:
            import ray
        except ImportError:
            raise InputError(
                "executor", "ray, which is not installed", "an installed package", "pip install ray, or executor=joblib"
            ) from None
        ray.init(address=self.address, num_cpus=None if self.address else self.workers, ignore_reinit_error=True)
        return ray


class SnapshotPickler(pickle.Pickler):
    """Pickles objects that other threads use: these may keep a cached property there while attributes are written."""

    def reducer_override(self, value: Any) -> Any:
        """The usual reduction of an object, with a copy of its attributes; other values are reduced as usual.

        What is usual is for the class beside this one to say, where there is one.
        """
        usual = getattr(super(), "reducer_override", lambda _: NotImplemented)(value)
        table = getattr(self, "dispatch_table", copyreg.dispatch_table)
        named = isinstance(value, type | FunctionType) or type(value) in table
        if usual is not NotImplemented or named or not isinstance(getattr(value, "__dict__", None), dict):
            return usual
        reduced = value.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
        if isinstance(reduced, str) or len(reduced) < 3 or not isinstance(reduced[2], dict):
            return reduced
        return (*reduced[:2], dict(reduced[2]), *reduced[3:])


def snapshot(value: Any, pickler: type[pickle.Pickler] = SnapshotPickler) -> bytes:
    """A pickle of a value that other threads may use meanwhile."""
    file = io.BytesIO()
    pickler(file, pickle.HIGHEST_PROTOCOL).dump(value)
    return file.getvalue()


def _apply(function: Callable[[Item], Result], item: Item) -> Result:
    return function(item)


def _apply_pickled(call: bytes) -> Any:
    function, item = pickle.loads(call)
    return function(item)
