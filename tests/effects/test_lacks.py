"""What a robot lacks for an effect to exist on it, by model files written here."""

from pathlib import Path

import pytest

from leapgap import effects
from leapgap.robot.actuators import MotorConstants
from leapgap.robot.model import Robot

ARM = """<mujoco model="arm"><worldbody>{world}<body pos="0 0 1"><joint name="a" axis="0 1 0"/>
  <geom size="0.05" mass="1"/><body pos="0.2 0 0"><joint name="b" axis="0 1 0"/><geom size="0.05" mass="1"/></body>
  </body></worldbody><actuator><motor joint="a" {first}/><motor joint="b" {second}/></actuator></mujoco>"""
LIMITED = 'ctrlrange="-8 8"'


def arm(
    folder: Path, first: str = "", second: str = "", world: str = "", motors: MotorConstants | None = None
) -> Robot:
    """Two joints in a row whose motors, and whose world, have what is given."""
    (folder / "arm.xml").write_text(ARM.format(world=world, first=first, second=second))
    return Robot.load(folder / "arm.xml", motors)


@pytest.mark.parametrize("name", ["thermal_fade", "duty_limit"])
def test_effects_that_refer_to_the_largest_torques_need_all_of_them(name: str, tmp_path: Path) -> None:
    kind = effects.known()[name]
    assert kind.lacks(arm(tmp_path)) == "limits of its torques"
    assert kind.lacks(arm(tmp_path, LIMITED)) == "limits of its torques"
    assert kind.lacks(arm(tmp_path, LIMITED, LIMITED)) is None


def test_motors_of_stated_constants_have_a_limit_of_their_own_but_heat_alike(tmp_path: Path) -> None:
    robot = arm(tmp_path, LIMITED, LIMITED, motors=MotorConstants(0.2, 30.0))
    says = effects.known()["duty_limit"].lacks(robot)
    assert says == "motors without stated constants (see torque_speed_limit)"
    assert effects.known()["thermal_fade"].lacks(robot) is None


PLANE = '<geom type="plane" size="1 1 0.1" {}/>'
FLOATING = """<mujoco model="ball"><worldbody><body pos="0 0 1"><freejoint/><geom name="foot" size="0.05" mass="1"/>
  <body pos="0 0 0.2"><joint name="a" axis="0 1 0"/><geom size="0.05" mass="1"/></body></body></worldbody>
  <actuator><motor joint="a"/></actuator></mujoco>"""


def test_a_held_robot_has_no_slope_without_ground_that_it_can_touch(tmp_path: Path) -> None:
    slope = effects.known()["ground_slope"]
    assert slope.lacks(arm(tmp_path)) == "ground"
    assert slope.lacks(arm(tmp_path, world=PLANE.format('contype="0" conaffinity="0"'))) == "ground"
    assert slope.lacks(arm(tmp_path, world=PLANE.format('contype="2" conaffinity="2"'))) == "ground"
    assert slope.lacks(arm(tmp_path, world=PLANE.format(""))) is None


def test_a_floating_robot_may_stand_on_boxes_that_its_logs_state(tmp_path: Path) -> None:
    (tmp_path / "ball.xml").write_text(FLOATING)
    robot = Robot.load(tmp_path / "ball.xml")
    assert effects.known()["ground_slope"].lacks(robot) is None


@pytest.mark.parametrize("name", ["ground_height", "foot_friction", "foot_compliance"])
def test_effects_at_feet_need_a_floating_robot_with_feet(name: str, tmp_path: Path) -> None:
    kind = effects.known()[name]
    assert kind.lacks(arm(tmp_path, world=PLANE.format(""))) == "a free base"
    (tmp_path / "ball.xml").write_text(FLOATING)
    assert kind.lacks(Robot.load(tmp_path / "ball.xml")) is None
    (tmp_path / "ball.xml").write_text(FLOATING.replace('name="foot"', ""))
    assert kind.lacks(Robot.load(tmp_path / "ball.xml")) == "feet"
