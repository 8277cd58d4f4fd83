"""Withheld cases written: logs for the diagnosis, truths for the score, and the seals of these beside the logs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from leapgap.logs.log import Log
from leapgap.robot.mjcf import OWN_MODEL, self_contained
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import sha256, write_json, write_text
from leapgap.runtime.executor import Executor
from leapgap.validation.case import CaseSetup, published_case, withhold, write_case
from leapgap.validation.case_draw import Case
from leapgap.validation.owners.cases import OwnersCase, write_owners_case
from leapgap.validation.seal import PUBLISHED, SEALS, seal


@dataclass(frozen=True)
class ClassCases:
    """The cases of one class with what generates them."""

    robot: Robot
    plans: Sequence[Log]
    setup: CaseSetup
    cases: Sequence[Case]


@dataclass(frozen=True)
class DrawnCases:
    """All cases to withhold, with what their logs are generated from."""

    robot: Robot  # the pipeline's own, which ``cases`` are of
    setup: CaseSetup
    references: Sequence[Log]
    cases: Sequence[Case]
    classes: Mapping[str, ClassCases]
    owners: Sequence[OwnersCase]
    owners_models: Path  # folder of the model files of owners' robots
    published: Sequence[Log]

    def write(self, logs: Path, truths: Path, executor: Executor) -> None:
        """Generate and write every case, and the seals."""
        jumps = ClassCases(self.robot, self.references, self.setup, self.cases)
        seals = dict(executor.map(partial(write_simulated, jumps, None, logs, truths), numbered("case", self.cases)))
        for name, own in self.classes.items():
            of_class = partial(write_simulated, own, (name, self_contained(own.robot)), logs, truths)
            seals |= executor.map(of_class, numbered(name, own.cases))
        seals |= executor.map(partial(write_owners, self.owners_models, logs, truths), numbered("owners", self.owners))
        if self.has_published:
            case = published_case(self.published, len(self.published))
            truth = write_case(case, logs / PUBLISHED, truths / PUBLISHED)
            seals |= [write_truth(truth, truths, PUBLISHED)]
        write_json(logs / SEALS, seals)

    @property
    def has_published(self) -> bool:
        """Whether there are published jumps enough for a case."""
        return len(self.published) > 1

    @property
    def in_words(self) -> list[str]:
        """How many cases of each kind there are, a line a kind."""
        lines = [f"{name}: {len(own.cases)} cases withheld" for name, own in self.classes.items()]
        lines += [f"owners: {len(self.owners)} cases withheld"] if self.owners else []
        return [*lines, f"{len(self.cases)} cases{' and the published jumps' if self.has_published else ''} withheld"]


def numbered(name: str, cases: Sequence[Any]) -> list[tuple[str, Any]]:
    """Cases with their names, ``case_000`` and so on."""
    return [(f"{name}_{i:03d}", case) for i, case in enumerate(cases)]


def write_simulated(
    own: ClassCases, of_class: tuple[str, str] | None, logs: Path, truths: Path, named: tuple[str, Case]
) -> tuple[str, str]:
    """Write the logs and the truth of one case, and where its class has one its model; return its name and seal.

    ``of_class``: name and model of a class; None for the pipeline's own robot.
    """
    name, case = named
    truth = write_case(withhold(case, own.plans, own.robot, own.setup), logs / name, truths / name)
    if of_class is not None:
        write_text(logs / name / OWN_MODEL, of_class[1])
        truth |= {"robot": of_class[0], "model": {OWN_MODEL: sha256(logs / name / OWN_MODEL)}}
    return write_truth(truth, truths, name)


def write_owners(models: Path, logs: Path, truths: Path, named: tuple[str, OwnersCase]) -> tuple[str, str]:
    """Write the logs, the model and the truth of one case of owners' errors; return its name and seal."""
    name, case = named
    return write_truth(write_owners_case(case, models, logs / name, truths / name), truths, name)


def write_truth(truth: dict[str, Any], truths: Path, name: str) -> tuple[str, str]:
    """Write a truth; return the case's name and seal."""
    write_json(truths / f"{name}.json", truth)
    return name, seal(truth)
