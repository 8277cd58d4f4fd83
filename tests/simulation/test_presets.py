"""Hardware by name: drawn values, and effects without a name."""

import pytest

from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.presets import NAMELESS, BentCalf, Variant
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout


def test_a_range_is_drawn_by_seed_and_a_number_stays() -> None:
    variant = Variant([{"name": "joint_damping", "damping": [0.5, 2.0]}, {"name": "command_delay", "delay_s": 0.003}])
    values = [variant.draw(seed)[0].values["damping"] for seed in range(50)]
    assert values[3] == variant.draw(3)[0].values["damping"]
    assert 0.5 <= min(values) < 0.6 < 1.9 < max(values) <= 2.0
    assert all(variant.draw(seed)[1].values["delay_s"] == 0.003 for seed in range(3))


def test_nameless_effects_act_and_no_diagnosis_knows_them(robot: Robot, reference: Log) -> None:
    (bent,) = Variant(nameless=[{"name": "bent_calf", "location": "RR", "offset_m": 0.015}]).draw(0)
    assert isinstance(bent, BentCalf)
    assert not set(NAMELESS) & set(effects.known())
    straight, crooked = Replayer(robot).motions([Rollout(reference), Rollout(reference, (bent,))])
    assert abs(straight.qpos[-1, 0] - crooked.qpos[-1, 0]) > 0.01


def test_an_unknown_nameless_effect_is_refused() -> None:
    with pytest.raises(InputError, match="nameless effect: found curse; expected one of bent_calf"):
        Variant(nameless=[{"name": "curse"}]).draw(0)
