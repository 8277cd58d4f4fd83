"""Digests: the same for what holds the same, another for anything else."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from leapgap.keys import digest

from leapgap import effects
from leapgap.recording.jump import Jump, Target
from leapgap.robot.model import Robot
from tests.conftest import standing


@dataclass(frozen=True)
class Pair:
    first: float = 1.0
    second: float = 2.0


@dataclass(frozen=True)
class Other:
    first: float = 1.0
    second: float = 2.0


def adder(weight: np.ndarray) -> Callable[[float], np.ndarray]:
    def added(x: float) -> np.ndarray:
        return weight + x

    return added


def test_what_holds_the_same_has_the_same_digest(robot: Robot) -> None:
    assert digest(Pair()) == digest(Pair(1.0, 2.0))
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})
    assert digest(adder(np.arange(3.0))) == digest(adder(np.arange(3.0)))
    assert digest(robot) == digest(Robot.load())
    jump = standing(robot)
    assert digest(jump) == digest(Jump(jump.name, {k: v.copy() for k, v in jump.columns.items()}, jump.info))


@pytest.mark.parametrize(
    ("one", "another"),
    [
        (Pair(), Pair(second=2.0000000000000004)),
        (Pair(), Other()),
        (1, 1.0),
        (1, True),
        ("ab", ["a", "b"]),
        (["ab", "c"], ["a", "bc"]),
        ({"a": 1, "b": 2}, {"a": 2, "b": 1}),
        (np.zeros(4), np.zeros((2, 2))),
        (np.zeros(4), np.zeros(4, np.float32)),
        (adder(np.zeros(3)), adder(np.ones(3))),
        (effects.effect("joint_damping", damping=0.4), effects.effect("joint_friction", torque_nm=0.4)),
        ({Target(0.5): 1}, {Target(0.6): 1}),
    ],
)
def test_any_difference_shows(one: object, another: object) -> None:
    assert digest(one) != digest(another)


def test_one_changed_sample_of_a_log_shows(robot: Robot) -> None:
    jump = standing(robot)
    moved = dict(jump.columns) | {"base_pos_x": jump["base_pos_x"] + np.eye(1, len(jump), 7)[0] * 1e-12}
    assert digest(jump) != digest(replace(jump, columns=moved))


def test_what_has_no_digest_is_refused() -> None:
    with pytest.raises(TypeError, match="no digest of a generator"):
        digest(x for x in range(3))
