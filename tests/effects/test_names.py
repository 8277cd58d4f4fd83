"""Effects of several names: found by each of them, and called on a robot what people call it there."""

from pathlib import Path

import pytest

from leapgap import effects
from leapgap.diagnosis.diagnose import chosen_kinds, tolerances_on
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.settings import Settings
from leapgap.effects.base import Effect
from leapgap.effects.bodies import LegMass, LinkInertia
from leapgap.errors import InputError
from leapgap.reports.written import effect_rows
from leapgap.robot.model import Robot

BOTH = ("leg_mass", "link_mass")


@pytest.mark.parametrize("name", BOTH)
def test_an_effect_is_found_by_each_of_its_names(name: str) -> None:
    assert name in effects.known() and effects.known()[name] is effects.known().get(name) is LegMass
    assert effects.effect(name, "elbow", scale=1.2) == LegMass("elbow", scale=1.2)
    assert effects.from_config([{"name": name, "scale": 1.2}]) == (LegMass(scale=1.2),)
    assert effects.first_name(name) == "leg_mass"


def test_no_name_counts_twice_and_others_are_unknown() -> None:
    assert list(effects.known().values()).count(LegMass) == 1
    assert effects.first_name("wind") == "wind" and effects.known().get("wind") is None
    with pytest.raises(KeyError):
        effects.known()["wind"]


def test_nobody_elses_effect_may_have_a_further_name() -> None:
    taken = type(
        "Mine", (LinkInertia,), {"name": "link_mass", "__dataclass_fields__": LinkInertia.__dataclass_fields__}
    )
    with pytest.raises(InputError, match="a name of its own"):
        effects.registry([taken])


@pytest.mark.parametrize("name", BOTH)
def test_settings_take_both_names_and_reports_use_that_of_the_robot(name: str, robot: Robot, robot_arm: Robot) -> None:
    kinds = chosen_kinds(Settings(effects=[name, "armature"]))
    assert kinds[0] is LegMass
    assert LegMass not in chosen_kinds(Settings(without=[name]))
    for of, called in ((robot, "leg_mass"), (robot_arm, "link_mass")):
        assert {one.name for one in list_hypotheses([name], of, None)} == {called}
        assert set(tolerances_on(of, Settings(tolerances={f"{name}.scale": 0.01}))) == {f"{called}.scale"}
        assert called in {row[0] for row in effect_rows(of)}


def lacking(robot: Robot) -> dict[str, str]:
    """What a robot lacks, by the effects that do not exist on it."""
    return {name: what for name, kind in effects.known().items() if (what := kind.lacks(robot)) is not None}


OF_BASE = (
    *("aerodynamic_drag", "com_offset", "contact_damping", "foot_compliance", "foot_friction", "frame_tilt"),
    *("ground_height", "leg_geometry", "payload", "state_latency", "trunk_inertia"),
)


def test_a_held_arm_has_every_effect_but_those_of_a_base_and_of_stated_motors(robot_arm: Robot) -> None:
    """Its floor is there to be touched, its torques have limits, its joints armatures."""
    expected = dict.fromkeys(OF_BASE, "a free base") | {"torque_speed_limit": "constants of its motors"}
    assert lacking(robot_arm) == expected


def test_the_a1_has_every_effect_but_two(robot: Robot) -> None:
    assert lacking(robot) == {
        "duty_limit": "motors without stated constants (see torque_speed_limit)",
        "gravity_compensation": "a base that is held",
    }


def test_a_bench_without_limits_floor_gravity_and_armature_says_so(tmp_path: Path) -> None:
    (tmp_path / "bench.xml").write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="a"/><geom size="0.1"/></body></worldbody>'
        '<actuator><motor joint="a"/></actuator></mujoco>'
    )
    found = lacking(Robot.load(tmp_path / "bench.xml"))
    for name in ("duty_limit", "supply_sag", "thermal_fade", "torque_limit"):
        assert found.pop(name) == "limits of its torques"
    assert found.pop("ground_slope") == "ground"
    assert found.pop("gravity_compensation") == found.pop("gravity_direction") == "gravity"
    assert "armature" in found.pop("joint_elasticity") and "armature" in found.pop("joint_play")
    assert found == dict.fromkeys(OF_BASE, "a free base") | {"torque_speed_limit": "constants of its motors"}


def test_an_arm_whose_first_joint_is_passive_has_no_weight_to_compensate(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1"/><body pos="0.3 0 0">'
        '<joint name="b" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody>'
        '<actuator><motor joint="b"/></actuator></mujoco>'
    )
    kind: type[Effect] = effects.known()["gravity_compensation"]
    assert kind.lacks(Robot.load(tmp_path / "arm.xml")) == "links that motors alone hold"
