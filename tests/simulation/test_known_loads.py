"""Known loads in a model: against a body that MuJoCo compiles with the same mass as a shape of its own."""

import mujoco
import numpy as np
import pytest

from leapgap.effects.bodies import LegMass
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, add_point_mass

BODY = """<mujoco model="link"><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
  <geom type="box" size="0.1 0.05 0.2" pos="0.02 0.01 -0.2" euler="10 20 30" mass="1.2" contype="0" conaffinity="0"/>
  {load}</body></worldbody><actuator><motor joint="hinge" ctrlrange="-9 9"/></actuator></mujoco>"""
SMALL = """<geom type="sphere" size="0.0001" pos="{at}" mass="0.7" contype="0" conaffinity="0"/>"""


def mass_matrix_of_free_body(model: mujoco.MjModel) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass, and inertia about it in the axes of the body."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    axes = turn.reshape(3, 3)
    return float(model.body_mass[1]), model.body_ipos[1], axes @ np.diag(model.body_inertia[1]) @ axes.T


@pytest.mark.parametrize("at", [(0.02, 0.01, -0.2), (0.1, -0.05, -0.3)])
def test_a_point_mass_is_what_mujoco_makes_of_a_small_sphere(at: tuple[float, float, float]) -> None:
    plain = mujoco.MjModel.from_xml_string(BODY.format(load=""))
    wanted = mujoco.MjModel.from_xml_string(BODY.format(load=SMALL.format(at=" ".join(map(str, at)))))
    add_point_mass(plain, 1, 0.7, np.array(at))
    for own, expected in zip(mass_matrix_of_free_body(plain), mass_matrix_of_free_body(wanted), strict=True):
        np.testing.assert_allclose(own, expected, atol=1e-6)


def test_a_heavier_link_does_not_make_its_load_heavier(tmp_path) -> None:
    (tmp_path / "link.xml").write_text(BODY.format(load=""))
    robot = Robot.load(tmp_path / "link.xml")
    names = ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    columns = {"time": np.arange(4) * 0.002} | {f"{name}/hinge": np.zeros(4) for name in names}
    log = Log("loaded", columns, LogInfo("link", 0.002, "", extra={"load": {"hinge": 0.7}}))
    model = Replayer(robot).model(Rollout(log, (LegMass(location="hinge", scale=1.5),)))
    assert model.body("link").mass[0] == pytest.approx(1.5 * 1.2 + 0.7)
