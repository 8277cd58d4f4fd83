"""Execution of independent cases: in this process, in parallel processes, or on a Ray cluster."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from leapgap.errors import InputError, needs
from leapgap.processes import starting_workers

UNUSED = r"\d+ tasks (have been|which were)"
"""What joblib warns of where an error ends the work; the error itself is the message."""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Executor:
    """How and where independent cases run; configuration group ``executor``."""

    kind: str
    """One of local, joblib and ray."""
    workers: int
    """Number of processes; unused by local."""
    address: str | None = None
    """Address of the Ray cluster; None starts one on this machine."""

    def __post_init__(self) -> None:
        """Refuse a number of processes that means nothing; −1 is one for each core, as joblib has it."""
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
        elif self.kind == "ray":
            yield from self._by_ray(function, items)
        else:
            raise InputError("executor.kind", self.kind, "local, joblib or ray", "choose one: executor=joblib")

    def _by_ray(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
        try:
            import ray
        except ImportError:
            raise InputError(
                "executor", "ray, which is not installed", "an installed package", "pip install ray, or executor=joblib"
            ) from None
        ray.init(address=self.address, num_cpus=None if self.address else self.workers, ignore_reinit_error=True)
        remote = ray.remote(num_cpus=1)(function)
        yield from (ray.get(handle) for handle in [remote.remote(item) for item in items])
