"""A bench with a robot that has no effects, and trials that take a second."""

from collections.abc import Callable
from pathlib import Path

import pytest

from leapgap.jumping.experiments.method import JointPdMethod
from leapgap.jumping.experiments.rig import Bench, TrialRunner
from leapgap.jumping.experiments.trial import TrialSetup
from leapgap.jumping.task import target_of
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.runtime.cache import ResultCache


@pytest.fixture
def bench(robot: Robot, reference: Log, tmp_path: Path) -> Bench:
    """On which jumps of 50 cm are planned."""
    runner = TrialRunner(ResultCache(tmp_path / "runs"), map)
    return Bench("ideal", (), TrialSetup(robot), {target_of(reference): reference}, runner, seed=1)


@pytest.fixture
def joint_pd(bench: Bench) -> JointPdMethod:
    return JointPdMethod(bench.robot, bench.references)


@pytest.fixture
def counted() -> tuple[list[str], Callable]:
    """Places that were made, and a mapper that notes them; it dies before the ones named ``deadly``."""
    made: list[str] = []

    def mapper(function: Callable, items: list) -> object:
        for item in items:
            made.append(item.place)
            yield function(item)

    return made, mapper
