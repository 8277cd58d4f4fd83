import numpy as np
import pytest

from leapgap.jumping.planning.problem import Problem
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.planning.solve import Solution, solve
from leapgap.jumping.task import Target
from leapgap.logs.log import Log

# Optimal cost of the published references (their files' own cost, by the published weights).
PUBLISHED_COST = {
    "h00_d00": 3921.0,
    "h00_d10": 3890.3,
    "h00_d30": 3980.4,
    "h00_d40": 4145.8,
    "h00_d60": 4983.1,
    "h00_d80": 7996.1,
    "h20_d60": 5980.6,
    "h00_d-10": 3999.2,
    "h00_d-30": 4308.4,
}


def target_of(name: str) -> Target:
    height, distance = name.removeprefix("h").split("_d")
    return Target(x_m=int(distance) / 100, z_m=int(height) / 100)


@pytest.fixture(scope="session")
def solutions() -> dict[str, Solution]:
    """All published targets, each from a cold start."""
    return {name: solve(Problem(target_of(name))) for name in PUBLISHED_COST}


@pytest.fixture(scope="session")
def references(solutions: dict[str, Solution]) -> dict[str, Log]:
    return {name: to_jump(solution) for name, solution in solutions.items()}


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
