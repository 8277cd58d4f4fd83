"""Trials, and what came of them: kept as files the moment they are done, so that a killed run goes on."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.effects.base import Effect
from leapgap.experiment.aimed import AimedJump
from leapgap.experiment.aiming import Tried
from leapgap.experiment.conduct import Conduct, pair_force
from leapgap.experiment.methods.base import Method
from leapgap.experiment.tasks import Task
from leapgap.experiment.trial import Outcome, World, attempt_task
from leapgap.files import read_json, write_json
from leapgap.keys import digest
from leapgap.recording import jump as jump_log
from leapgap.recording.jump import (
    BASE_POSITION,
    BASE_QUATERNION,
    BASE_VELOCITY,
    Jump,
)
from leapgap.robot.model import Robot
from leapgap.robot.pair_force import PAIR_FORCE_AXES
from leapgap.robot.rigid_body import GRAVITY
from leapgap.robot.rotations import pitch_of, yaw_of
from leapgap.robot.schedule import ContactSchedule
from leapgap.simulation.landing import Landing

LEAVES_WITHIN_S = 0.05
"""Feet that touch up to so long after the planned take-off have not left yet."""
UPRIGHT_RAD = 0.5
"""A jump that is pitched more when it lands teaches nothing about aiming."""


@dataclass(frozen=True)
class Trial:
    """One run to make; data, so that it travels to worker processes."""

    place: str
    """Where its result is kept, ``<hardware>/<method>/<task>_<number>``: different for every trial of an experiment."""
    task: Task
    method: Method
    reference: Jump
    """The plan of its jumps from level ground."""
    effects: tuple[Effect, ...]
    world: World
    seed: int
    with_log: bool = False

    def done(self) -> "Done":
        """Make it."""
        outcome = attempt_task(
            self.task, self.method, self.reference, self.effects, self.world, np.random.default_rng(self.seed)
        )
        return Done(
            landings=outcome.landings,
            total_error_cm=outcome.total_error_cm,
            fallbacks=outcome.fallbacks,
            substituted=outcome.substituted,
            conduct=outcome.conduct,
            tried=tried_in(outcome),
            log=log_of(outcome, self.world.robot, Path(self.place).name) if self.with_log else None,
        )


@dataclass(frozen=True)
class Done:
    """What came of a trial."""

    landings: tuple[Landing, ...]
    total_error_cm: float | None
    fallbacks: Mapping[str, int]
    substituted: tuple[tuple[float, str], ...]
    """When, s, and why a controller sent something else than what it stands for."""
    conduct: Conduct
    tried: Tried = field(default_factory=Tried)
    log: Jump | None = None

    def to_json(self) -> dict[str, Any]:
        """All but the log."""
        return {
            "landings": [asdict(one) for one in self.landings],
            "total_error_cm": self.total_error_cm,
            "fallbacks": dict(self.fallbacks),
            "substituted": [list(one) for one in self.substituted],
            "conduct": asdict(self.conduct),
            "tried": {name: values.tolist() for name, values in asdict(self.tried).items()},
        }

    @staticmethod
    def from_json(raw: Mapping[str, Any], log: Jump | None) -> "Done":
        """Read it back; numbers in JSON keep all their digits."""
        empty = Tried()
        tried = {n: np.array(v, float).reshape(-1, *getattr(empty, n).shape[1:]) for n, v in raw["tried"].items()}
        return Done(
            landings=tuple(Landing(**one) for one in raw["landings"]),
            total_error_cm=raw["total_error_cm"],
            fallbacks=raw["fallbacks"],
            substituted=tuple((time_s, reason) for time_s, reason in raw["substituted"]),
            conduct=Conduct(**raw["conduct"]),
            tried=Tried(**tried),
            log=log,
        )


Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterator[Any]]
"""Applies a function to items, maybe at the same time; results in the order of the items."""


@dataclass(frozen=True)
class Shelf:
    """Makes trials that are not kept yet, and keeps them: ``<place>.json``, and ``<place>.parquet`` of a log."""

    folder: Path
    code: str
    """Hash of the code behind the results: others are made anew."""
    map: Mapper
    said: Callable[[Trial, Done], None] | None = None
    """Told of every trial that is made, in their order."""
    used: set[str] = field(default_factory=set)
    """Places that were asked for; ``sweep`` removes all others."""

    def results(self, trials: Sequence[Trial]) -> list[Done]:
        """In the order of the trials; what was made just now reads like what was kept before."""
        keys = [digest((self.code, trial)) for trial in trials]
        self.used.update(trial.place for trial in trials)
        missing = [(t, key) for t, key in zip(trials, keys, strict=True) if self._stored_key(t.place) != key]
        made = self.map(Trial.done, [trial for trial, _ in missing])
        for (trial, key), done in zip(missing, made, strict=True):
            self._keep(trial, done, key)
            if self.said is not None:
                self.said(trial, done)
        return [self._read(trial) for trial in trials]

    def value(self, place: str, inputs: Any, make: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
        """Any other result that takes a while, as JSON."""
        key, path = digest((self.code, inputs)), self.folder / f"{place}.json"
        self.used.add(place)
        if self._stored_key(place) != key:
            write_json(path, {"key": key, "value": make()})
        return read_json(path)["value"]

    def sweep(self) -> None:
        """Remove what nobody asked for."""
        for path in sorted(self.folder.rglob("*"), reverse=True):
            if path.is_dir():
                if not any(path.iterdir()):
                    path.rmdir()
            elif path.relative_to(self.folder).with_suffix("").as_posix() not in self.used:
                path.unlink()

    def _stored_key(self, place: str) -> str | None:
        path = self.folder / f"{place}.json"
        return read_json(path).get("key") if path.is_file() else None

    def _keep(self, trial: Trial, done: Done, key: str) -> None:
        """The log first: a result with a key is whole."""
        path = self.folder / f"{trial.place}.json"
        log = path.with_suffix(".parquet")
        if done.log is not None:
            jump_log.write(done.log, log)
        else:
            log.unlink(missing_ok=True)
        write_json(path, {"key": key, **done.to_json()})

    def _read(self, trial: Trial) -> Done:
        path = self.folder / f"{trial.place}.json"
        return Done.from_json(read_json(path), jump_log.read(path.with_suffix(".parquet")) if trial.with_log else None)


@dataclass(frozen=True)
class Bench:
    """One simulated robot, and what all its trials share."""

    hardware: str
    """As in places: no character that a file's name may not have."""
    effects: tuple[Effect, ...]
    world: World
    references: Mapping[Any, Jump]
    shelf: Shelf
    seed: int = 0

    @property
    def robot(self) -> Robot:
        """The robot that controllers believe in."""
        return self.world.robot

    @cached_property
    def level(self) -> Jump:
        """Any plan from level ground, to start from its first pose."""
        return next(iter(self.references.values()))

    def trial(self, name: str, method: Method, task: Task, number: int, with_log: bool = False) -> Trial:
        """The same task and number give the same ground and sensors to every method."""
        seed = int(np.random.SeedSequence([self.seed, number, *task.name.encode()]).generate_state(1)[0])
        place = f"{self.hardware}/{name}/{task.name}_{number}"
        level = self.references[task.target]
        return Trial(place, task, method, level, self.effects, self.world, seed, with_log)


def log_of(outcome: Outcome, robot: Robot, name: str) -> Jump:
    """The log with what a simulation knows besides: contacts, and the true forces of the ground."""
    columns = dict(outcome.run.log.columns)
    columns |= {f"contact/{foot}": outcome.run.touching[:, i].astype(float) for i, foot in enumerate(robot.feet)}
    force = pair_force(outcome.run, robot)
    columns |= {f"ground_force/{axis}": force[:, i] for i, axis in enumerate(PAIR_FORCE_AXES)}
    return replace(outcome.run.log, name=name, columns=columns)


def tried_in(outcome: Outcome) -> Tried:
    """What a method that aims has tried in a run, and where it came down as its sensors tell."""
    rows = []
    for first, jump in zip(outcome.starts, outcome.controllers, strict=False):  # those never begun have no start
        if not isinstance(jump, AimedJump) or jump.goal is None:
            continue
        landing = came_down(outcome, first, jump.reference.schedule, jump.standing_height_m)
        if abs(landing[2]) <= UPRIGHT_RAD:
            rows.append((jump.goal, jump.stance_pitch, landing))
    if not rows:
        return Tried()
    goals, stances, landings = (np.array(column) for column in zip(*rows, strict=True))
    return Tried(goals, stances, landings)


def came_down(outcome: Outcome, first: int, schedule: ContactSchedule, standing_height_m: float) -> np.ndarray:
    """Pose (x, z, pitch) that the jump begun at row ``first`` has at the end of its scheduled flight, by its log.

    A foot that touches earlier stops the flight: from there on it is continued as a free one, so that landings
    depend smoothly on what was tried. x from the start along the heading, z over a robot that stands on the floor.
    """
    log, period = outcome.run.log, outcome.run.log.info.sample_period_s
    take_off, end = (first + round(seconds / period) for seconds in (schedule.take_off_s, schedule.landing_s))
    settled = take_off + round(LEAVES_WITHIN_S / period)
    touched = np.flatnonzero(outcome.run.touching[settled:end].any(axis=1))
    row = settled + touched[0] - 1 if len(touched) else end
    left_s = (end - row) * period
    quaternion = log.stack(BASE_QUATERNION)
    yaw = yaw_of(quaternion[first])
    ahead = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    position, velocity = (log.stack(columns) for columns in (BASE_POSITION, BASE_VELOCITY))
    flown = position[row] + left_s * velocity[row] - np.array([0.0, 0.0, GRAVITY * left_s**2 / 2])
    pitch = pitch_of(quaternion[row]) + left_s * log["base_angvel_y"][row]
    return np.array([(flown - position[first]) @ ahead, flown[2] - standing_height_m, pitch])
