"""Runs trials and keeps each result in a cache as soon as it is there."""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup
from leapgap.jumping.experiments.trial_spec import TrialResult, TrialSpec
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json, write_json
from leapgap.runtime.cache import ResultCache, result_key

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
"""Applies a function to items, possibly in parallel; results come in the order of the items."""


@dataclass(frozen=True)
class TrialRunner:
    """Runs the trials whose results are not in the cache: ``<place>.json``, and ``<place>.parquet`` of a log.

    Threads may share it where they may share ``map``; what one of them computes another waits for.
    """

    cache: ResultCache
    map: Mapper
    progress: Callable[[TrialSpec, TrialResult], None] | None = None
    """Called after every trial that was run, in their order."""
    map_last: Mapper | None = None
    """``map`` for trials whose results no further trial waits for; None: ``map``."""
    side_by_side: bool = False
    """Whether threads may share ``map``, so that methods are prepared side by side."""
    earlier: ResultCache | None = None
    """Of another stage: results that are there are read, and none is written."""
    _running: "dict[str, Future[None]]" = field(default_factory=dict)
    """Places that a thread computes."""
    _lock: Any = field(default_factory=threading.Lock)

    def results(self, trials: Sequence[TrialSpec], last: bool = False) -> list[TrialResult]:
        """Results in the order of the trials. New ones are read back from the cache, like earlier ones.

        ``last``: no further trial waits for them.
        """
        keys = {trial.place: result_key(TrialSpec.run, trial) for trial in trials}
        with self._claimed(keys) as claimed:
            missing = [trial for trial in trials if trial.place in claimed]
            new = ((last and self.map_last) or self.map)(TrialSpec.run, missing)
            for trial, result in zip(missing, new, strict=True):
                self._store(trial, result, keys[trial.place])
                if self.progress is not None:
                    with self._lock:
                        self.progress(trial, result)
        return [self._read(trial, keys[trial.place]) for trial in trials]

    def value(self, place: str, make: Callable[..., Mapping[str, Any]], *inputs: Any) -> Mapping[str, Any]:
        """``make(*inputs)``, from the cache where it is there; JSON must be able to hold it."""
        key = result_key(make, inputs)
        with self._claimed({place: key}) as claimed:
            if claimed:
                made = self.call(make, *inputs)
                with self.cache.store(place, key) as folder:
                    write_json(folder / f"{Path(place).name}.json", made)
        return read_json(self._path(place, key).with_suffix(".json"))

    def call(self, make: Callable[..., Any], *inputs: Any) -> Any:
        """``make(*inputs)``, on a worker where threads share them, so that this process is free to give them work."""
        if not self.side_by_side:
            return make(*inputs)
        (made,) = self.map(apply_to, [(make, inputs)])
        return made

    @contextmanager
    def _claimed(self, wanted: Mapping[str, str]) -> Iterator[set[str]]:
        """Yield those places, of a mapping to their keys, that are not in the cache, nor computed by another thread.

        The block has to compute them. It ends when those are there, too, that others compute.
        """
        done: Future[None] = Future()
        with self._lock:
            missing = [place for place, key in wanted.items() if self._found(place, key) is None]
            others = {self._running[place] for place in missing if place in self._running}
            claimed = {place for place in missing if place not in self._running}
            self._running.update(dict.fromkeys(claimed, done))
        try:
            yield claimed
        except BaseException as error:
            done.set_exception(error)
            raise
        else:
            done.set_result(None)
        finally:
            with self._lock:
                for place in claimed:
                    del self._running[place]
        for other in others:
            other.result()

    def _store(self, trial: TrialSpec, result: TrialResult, key: str) -> None:
        with self.cache.store(trial.place, key) as folder:
            path = folder / f"{Path(trial.place).name}.json"
            write_json(path, result.to_json())
            if result.log is not None:
                jump_log.write_log(result.log, path.with_suffix(".parquet"))

    def _read(self, trial: TrialSpec, key: str) -> TrialResult:
        path = self._path(trial.place, key)
        log = jump_log.read_log(path.with_suffix(".parquet")) if trial.with_log else None
        return TrialResult.from_json(read_json(path.with_suffix(".json")), log)

    def _path(self, place: str, key: str) -> Path:
        found = self._found(place, key)
        assert found is not None, f"{place} was made"
        return found

    def _found(self, place: str, key: str) -> Path | None:
        """Path of a result without its ending, where it is."""
        own = self.cache.get(place, key)
        return own if own or self.earlier is None else self.earlier.get(place, key)


def apply_to(call: tuple[Callable[..., Any], Sequence[Any]]) -> Any:
    """The value of a function at its inputs."""
    function, inputs = call
    return function(*inputs)


@dataclass(frozen=True)
class Bench:
    """One simulated robot, and everything that its trials have in common."""

    hardware: str
    """Its name in the places of its trials; it must be a valid file name."""
    effects: tuple[Effect, ...]
    world: TrialSetup
    references: Mapping[Any, Log]
    runner: TrialRunner
    seed: int = 0

    @property
    def robot(self) -> Robot:
        """The nominal robot, which controllers assume."""
        return self.world.robot

    @cached_property
    def level(self) -> Log:
        """The first plan to the ground itself: practice starts from its first pose, and on no box."""
        return next(plan for target, plan in self.references.items() if target.z_m == 0)

    def trial(self, name: str, method: Method, task: JumpTask, number: int, with_log: bool = False) -> TrialSpec:
        """A trial of a method. Only task and number decide its seed: all methods get the same ground and noise."""
        seed = int(np.random.SeedSequence([self.seed, number, *task.name.encode()]).generate_state(1)[0])
        place = f"{self.hardware}/{name}/{task.name}_{number}"
        level = self.references[task.target]
        return TrialSpec(place, task, method, level, self.effects, self.world, seed, with_log)
