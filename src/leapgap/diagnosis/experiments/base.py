"""What an experiment is, and the one that repeats what was done."""

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from leapgap.diagnosis.experiments.given import Given
from leapgap.diagnosis.experiments.plans import plan_of
from leapgap.logs.log import Log

REPEATS = "repeats"  # Key of a proposal's settings: how many times each log is to be made


@dataclass(frozen=True)
class Experiment(ABC):
    """Further logs, and what they need beside commands."""

    name: ClassVar[str]
    cost: ClassVar[int]  # Order of the effort that it takes: of those that tell causes apart, the least is proposed

    @classmethod
    @abstractmethod
    def candidates(cls, given: Given) -> list["Experiment"]:
        """Those of this kind that are possible."""

    @abstractmethod
    def plans(self, given: Given) -> list[Log]:
        """The logs to make, with commands and no measurements."""

    @abstractmethod
    def words(self, given: Given) -> str:
        """What to do, as an imperative with numbers."""

    def number(self, given: Given) -> int:
        """How many logs to make."""
        return len(self.plans(given))

    def is_alike(self, given: Given) -> bool:
        """Whether its motions are nearly the logged ones, so that they tell causes apart in the same proportion."""
        return False

    @property
    def short(self) -> str:
        """The experiment in a few words, after "at" or "with"."""
        return self.name.replace("_", " ")

    def gentler(self) -> "Experiment | None":
        """The same with a smaller motion, where the robot cannot make it; None where it has no size."""
        return None

    @property
    def sensors(self) -> tuple[str, ...]:
        """Columns of sensors that are logged besides."""
        return ()

    @property
    def settings(self) -> dict[str, Any]:
        """The experiment as data, from which ``experiment_of`` restores it."""
        return {"kind": self.name, **asdict(self)}


@dataclass(frozen=True)
class Repetition(Experiment):
    """The same motions again; it tells what the logs tell today."""

    name = "repetition"
    cost = 0

    @classmethod
    def candidates(cls, given: Given) -> list[Experiment]:
        """None: it is never proposed."""
        return []

    def plans(self, given: Given) -> list[Log]:
        """The logs' own commands from their own starts."""
        return [plan_of(log, k, given.robot) for k, log in enumerate(given.logs)]

    def words(self, given: Given) -> str:
        """What to do: the same motions once more."""
        return "record the same motions again"
