"""Runs trials and keeps each result in a cache as soon as it is there."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.atomic_io import read_json, write_json
from leapgap.cache import ResultCache, result_key
from leapgap.effects.base import Effect
from leapgap.jumping.experiments.method import Method
from leapgap.jumping.experiments.tasks import JumpTask
from leapgap.jumping.experiments.trial import TrialSetup
from leapgap.jumping.experiments.trial_spec import TrialResult, TrialSpec
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
"""Applies a function to items, possibly in parallel; results come in the order of the items."""


@dataclass(frozen=True)
class TrialRunner:
    """Runs the trials whose results are not in the cache: ``<place>.json``, and ``<place>.parquet`` of a log."""

    cache: ResultCache
    map: Mapper
    progress: Callable[[TrialSpec, TrialResult], None] | None = None
    """Called after every trial that was run, in their order."""

    def results(self, trials: Sequence[TrialSpec]) -> list[TrialResult]:
        """Results in the order of the trials. New ones are read back from the cache, like earlier ones."""
        keys = [result_key(TrialSpec.run, trial) for trial in trials]
        missing = [(t, key) for t, key in zip(trials, keys, strict=True) if self.cache.get(t.place, key) is None]
        new = self.map(TrialSpec.run, [trial for trial, _ in missing])
        for (trial, key), result in zip(missing, new, strict=True):
            self._store(trial, result, key)
            if self.progress is not None:
                self.progress(trial, result)
        return [self._read(trial) for trial in trials]

    def value(self, place: str, make: Callable[..., Mapping[str, Any]], *inputs: Any) -> Mapping[str, Any]:
        """``make(*inputs)``, from the cache where it is there; JSON must be able to hold it."""
        key = result_key(make, inputs)
        if self.cache.get(place, key) is None:
            with self.cache.store(place, key) as folder:
                write_json(folder / f"{Path(place).name}.json", make(*inputs))
        return read_json(self._json(place))

    def _store(self, trial: TrialSpec, result: TrialResult, key: str) -> None:
        with self.cache.store(trial.place, key) as folder:
            path = folder / f"{Path(trial.place).name}.json"
            write_json(path, result.to_json())
            if result.log is not None:
                jump_log.write_log(result.log, path.with_suffix(".parquet"))

    def _read(self, trial: TrialSpec) -> TrialResult:
        path = self._json(trial.place)
        log = jump_log.read_log(path.with_suffix(".parquet")) if trial.with_log else None
        return TrialResult.from_json(read_json(path), log)

    def _json(self, place: str) -> Path:
        return self.cache.folder / f"{place}.json"


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
        """One of the plans from level ground: practice starts from its first pose."""
        return next(iter(self.references.values()))

    def trial(self, name: str, method: Method, task: JumpTask, number: int, with_log: bool = False) -> TrialSpec:
        """A trial of a method. Only task and number decide its seed: all methods get the same ground and noise."""
        seed = int(np.random.SeedSequence([self.seed, number, *task.name.encode()]).generate_state(1)[0])
        place = f"{self.hardware}/{name}/{task.name}_{number}"
        level = self.references[task.target]
        return TrialSpec(place, task, method, level, self.effects, self.world, seed, with_log)
