"""What a closed loop sends at a tick is the last row of what a replay sends, bit for bit, for every effect."""

import numpy as np
import pytest

from leapgap import effects
from leapgap.effects.base import Commands, Effect
from leapgap.robot.model import Robot

PERIOD_S = 0.001
OF_COMMANDS = [name for name, kind in effects.known().items() if kind.change_commands is not Effect.change_commands]


def test_there_are_effects_to_test() -> None:
    assert {"command_delay", "computation_delay", "dropped_commands", "loop_delay", "torque_offset"} <= {*OF_COMMANDS}


@pytest.mark.parametrize("name", OF_COMMANDS)
@pytest.mark.parametrize("location", ["all", "thigh", "RR_calf"])
def test_the_newest_commands_are_the_last_row(name: str, location: str, robot: Robot) -> None:
    rng = np.random.default_rng(sum(name.encode()))
    kind = effects.known()[name]
    places = location if kind.places == "joints" else "all"
    for rows in (1, 2, 5, 64):
        commands = Commands(*rng.standard_normal((3, rows, len(robot.joints))))
        for about in kind.parameters(robot, places):
            shares = [0.0, 0.12, *rng.uniform(size=20)]
            values = [about.nominal, about.upper, *(about.lower + s * (about.upper - about.lower) for s in shares)]
            for value in values:
                effect = kind(places, **{about.name: value})
                newest = effect.change_newest_commands(commands, PERIOD_S, robot)
                every = effect.change_commands(commands, PERIOD_S, robot)
                for quantity in ("torque", "position", "velocity"):
                    assert np.array_equal(getattr(newest, quantity), getattr(every, quantity)[-1:]), (value, quantity)
