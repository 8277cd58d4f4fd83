"""Any actuator a model file may have becomes the one that takes the commands of a log; compared with plain MuJoCo."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.plain_simulation import Pd, Plain, by_force, simulate

ARM = """
<mujoco model="arm">
  <compiler autolimits="true"/>
  <option timestep="0.001"/>
  <default>{defaults}</default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.2" frictionloss="0.1" {shoulder}/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3" mass="1"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" armature="0.02" {elbow}/>
        <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.3" mass="0.7"/>
        <site name="tip" pos="0 0 -0.3"/>
      </body>
    </body>
  </worldbody>
  {more}
  <actuator>{actuators}</actuator>
</mujoco>"""
KINDS = {
    "motor": "<motor joint='shoulder'/><motor joint='elbow'/>",
    "gear": "<motor joint='shoulder' gear='9'/><motor joint='elbow' gear='-0.5'/>",
    "position": "<position joint='shoulder' kp='80' ctrlrange='-1 1'/><position joint='elbow' kp='30' kv='2'/>",
    "menagerie": "<general joint='shoulder' gainprm='500' biastype='affine' biasprm='0 -500 -40' ctrlrange='-.1 .1'/>"
    "<general joint='elbow' gainprm='500' biastype='affine' biasprm='0 -500 -40' ctrlrange='-.1 .1'/>",
    "velocity": "<velocity joint='shoulder' kv='3'/><intvelocity joint='elbow' kp='9' actrange='-3 3'/>",
    "pair": "<position joint='shoulder' kp='80'/><velocity joint='shoulder' kv='3'/><motor joint='elbow'/>",
    "dcmotor": "<dcmotor joint='shoulder' motorconst='0.1' resistance='0.5'/><motor joint='elbow'/>",
    "filter": "<general joint='shoulder' dyntype='filter' dynprm='0.2'/><motor joint='elbow'/>",
    "other order": "<motor joint='elbow' gear='3'/><motor joint='shoulder'/>",
    "own names": "<motor name='elbow' joint='shoulder'/><motor joint='elbow'/>",
}


def arm(folder: Path, actuators: str, shoulder: str = "", elbow: str = "", more: str = "", defaults: str = "") -> Path:
    path = folder / "arm.xml"
    parts = {"shoulder": shoulder, "elbow": elbow, "more": more, "defaults": defaults}
    path.write_text(ARM.format(actuators=actuators, **parts))
    return path


def replay_error(plain: Plain, robot: Robot) -> float:
    (motion,) = Replayer(robot).motions([Rollout(plain.log)])
    return float(np.abs(motion.qpos - plain.qpos).max())


@pytest.mark.parametrize("kind", KINDS)
def test_the_pd_of_the_log_acts_whatever_actuators_the_file_has(tmp_path: Path, kind: str) -> None:
    """The truth is a model without actuators, with the PD as a force on its joints."""
    bare = arm(tmp_path, "")
    plain = simulate(bare, by_force, Pd(kp=40.0, kd=1.5, push=3.0))
    robot = Robot.load(arm(tmp_path, KINDS[kind]))
    assert robot.driven.all()
    assert replay_error(plain, robot) < 1e-9


def test_defaults_of_the_file_do_not_reach_our_actuators(tmp_path: Path) -> None:
    defaults = "<general gear='4' ctrlrange='-1 1' forcerange='-9 9' dyntype='filter' dynprm='0.1' gainprm='7'/>"
    plain = simulate(arm(tmp_path, ""), by_force, Pd(kp=40.0, kd=1.5, push=3.0))
    actuators = "<general joint='shoulder' forcelimited='false'/><general joint='elbow' forcelimited='false'/>"
    robot = Robot.load(arm(tmp_path, actuators, defaults=defaults))
    assert robot.torque_limits == pytest.approx([28, 28])  # gear × gain × control
    assert np.abs(plain.torque).max() < 28
    assert replay_error(plain, robot) < 1e-9


@pytest.mark.parametrize(
    ("actuators", "elbow", "limits"),
    [
        ("<motor joint='shoulder' forcerange='-5 5'/><motor joint='elbow' forcerange='-2 3' gear='-4'/>", "", (5, 12)),
        ("<motor joint='shoulder' ctrlrange='-1 1' gear='6'/><motor joint='elbow'/>", "", (6, np.inf)),
        ("<general joint='shoulder' ctrlrange='-1 1' gear='6' gainprm='2'/><motor joint='elbow'/>", "", (12, np.inf)),
        ("<position joint='shoulder' kp='9' ctrlrange='-1 1'/><motor joint='elbow'/>", "", (np.inf, np.inf)),
        ("<position joint='shoulder' kp='9' forcerange='-3 3' gear='2'/><motor joint='elbow'/>", "", (6, np.inf)),
        ("<motor joint='shoulder'/><motor joint='elbow'/>", "actuatorfrcrange='-7 7'", (np.inf, 7)),
        ("<motor joint='shoulder'/><motor joint='elbow' forcerange='-4 4'/>", "actuatorfrcrange='-7 7'", (np.inf, 4)),
        ("<motor joint='shoulder' ctrlrange='-9 9' forcerange='-4 4'/><motor joint='elbow'/>", "", (4, np.inf)),
        ("<motor joint='shoulder' ctrlrange='-3 3' forcerange='-4 4'/><motor joint='elbow'/>", "", (3, np.inf)),
        ("<motor joint='shoulder' forcerange='-4 4'/><motor joint='elbow' ctrlrange='-1 1'/>"
         "<motor joint='elbow' ctrlrange='-2 2' gear='3'/>", "", (4, 7)),
    ],
)  # fmt: skip
def test_torque_limits_are_those_that_the_file_states(
    tmp_path: Path, actuators: str, elbow: str, limits: tuple[float, float]
) -> None:
    assert Robot.load(arm(tmp_path, actuators, elbow=elbow)).torque_limits.tolist() == list(limits)


def test_a_limited_motor_delivers_its_limit_and_no_more(tmp_path: Path) -> None:
    plain = simulate(arm(tmp_path, ""), clipped, Pd(kp=40.0, kd=1.5, push=30.0))
    assert (plain.torque < -4).any() and (plain.torque > 6).any()
    actuators = "<motor joint='shoulder' forcerange='-4 6'/><motor joint='elbow' gear='-2' ctrlrange='-3 2'/>"
    assert replay_error(plain, Robot.load(arm(tmp_path, actuators))) < 1e-9


def clipped(_: mujoco.MjModel, data: mujoco.MjData, dofs: np.ndarray, torque: np.ndarray, *__: np.ndarray) -> None:
    data.qfrc_applied[dofs] = np.clip(torque, [-4, -4], [6, 6])


def test_inertia_and_damping_of_actuators_stay_at_their_joints(tmp_path: Path) -> None:
    """Through a gear of 9: inertia and damping count 81 times, and no control is sent to the makers' motors."""
    actuators = "<motor joint='shoulder' gear='9' armature='0.002' damping='0.004 0.001'/><motor joint='elbow'/>"
    path = arm(tmp_path, actuators)
    plain = simulate(path, by_force, Pd(kp=40.0, kd=1.5, push=3.0))
    robot = Robot.load(path)
    assert robot.model.dof_armature == pytest.approx([0.162, 0.02])
    assert replay_error(plain, robot) < 1e-9


def test_a_passive_joint_swings_and_is_logged_without_commands(tmp_path: Path) -> None:
    path = arm(tmp_path, "<motor joint='elbow' gear='3'/>")
    plain = simulate(path, by_force, Pd(kp=40.0, kd=1.5, push=2.0), commanded=lambda joint: joint == "elbow")
    robot = Robot.load(path)
    assert robot.joints == ("shoulder", "elbow")
    assert robot.driven_joints == ("elbow",)
    assert np.ptp(plain.qpos[:, 0]) > 0.05
    assert "cmd_tau/shoulder" not in plain.log
    assert replay_error(plain, robot) < 1e-9


def test_effects_of_motors_are_not_looked_for_at_a_passive_joint(tmp_path: Path) -> None:
    robot = Robot.load(arm(tmp_path, "<motor joint='elbow'/>"))
    found = {(h.name, h.location) for h in list_hypotheses(["torque_gain", "joint_friction"], robot, None)}
    assert found == {("torque_gain", "all"), *(("joint_friction", place) for place in ("all", "shoulder", "elbow"))}


def test_commands_of_a_passive_joint_are_refused(tmp_path: Path) -> None:
    plain = simulate(arm(tmp_path, ""), by_force)
    robot = Robot.load(arm(tmp_path, "<motor joint='elbow'/>"))
    with pytest.raises(InputError, match="found commands of shoulder; expected commands of elbow: arm has no actuator"):
        Replayer(robot).motions([Rollout(plain.log)])


def test_springs_and_coupled_joints_stay_in_the_model(tmp_path: Path) -> None:
    coupled = '<equality><joint joint1="elbow" joint2="shoulder" polycoef="0 0.5 0 0 0"/></equality>'
    path = arm(tmp_path, "<motor joint='shoulder'/>", "stiffness='6' springref='20'", more=coupled)
    plain = simulate(path, by_force, Pd(kp=40.0, kd=1.5), commanded=lambda joint: joint == "shoulder")
    assert plain.qpos[200:, 1] == pytest.approx(plain.qpos[200:, 0] / 2, abs=0.02)
    assert replay_error(plain, Robot.load(path)) < 1e-9


def test_sensors_and_keyframes_that_name_actuators_do_not_stop_a_load(tmp_path: Path) -> None:
    more = """<sensor><actuatorfrc actuator="a"/><actuatorpos actuator="b"/></sensor>
      <keyframe><key name="bent" qpos="0.3 0.4" ctrl="1 2 3"/></keyframe>"""
    actuators = "<motor name='a' joint='elbow'/><motor name='b' joint='elbow'/><motor name='c' joint='shoulder'/>"
    robot = Robot.load(arm(tmp_path, actuators, more=more))
    assert robot.model.key_qpos.tolist() == [[0.3, 0.4]]
    assert robot.model.nu == 2
    assert robot.notes == ("2 actuators at the joint elbow act as one; their torque limits add",)


MUSCLE = "<muscle name='biceps' joint='elbow' lengthrange='0 1'/>"
TENDON = '<tendon><fixed name="string"><joint joint="elbow" coef="1"/></fixed></tendon>'


@pytest.mark.parametrize(
    ("actuators", "more", "message"),
    [
        ("<motor name='pull' tendon='string'/>", TENDON, "the actuator pull drives a tendon"),
        ("<motor name='jet' site='tip'/>", "", "the actuator jet drives a site"),
        ("<adhesion name='glue' body='lower' ctrlrange='0 1'/>", "", "the actuator glue drives a body"),
        (MUSCLE, "", "the actuator biceps is a muscle"),
        ("", "", "no actuator at shoulder, elbow"),
        ("<motor joint='elbow'/>", '<option><flag actuation="disable"/></option>', "a joint PD at elbow gives 0"),
    ],
)
def test_actuators_that_no_log_commands_are_refused_by_name(
    tmp_path: Path, actuators: str, more: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        Robot.load(arm(tmp_path, actuators, more=more))


def test_joints_without_a_name_and_loose_bodies_are_refused(tmp_path: Path) -> None:
    path = arm(tmp_path, "<motor joint='elbow'/>")
    path.write_text(path.read_text().replace('<joint name="shoulder"', "<joint"))
    with pytest.raises(InputError, match="unnamed joints of the bodies upper"):
        Robot.load(path)
    path = arm(tmp_path, "<motor joint='elbow'/>")
    ball = '<body name="ball"><freejoint/><geom size="0.1"/></body></worldbody>'
    path.write_text(path.read_text().replace("</worldbody>", ball))
    with pytest.raises(InputError, match="free or ball joints of the bodies ball"):
        Robot.load(path)


def test_several_joints_of_one_body_are_driven_one_by_one(tmp_path: Path) -> None:
    wrist = "<joint name='turn' axis='0 0 1'/><joint name='tilt' axis='1 0 0'/><joint name='slide' type='slide'/>"
    text = f"""<mujoco model="wrist"><worldbody><body name="hand" pos="0 0 1">{wrist}
      <geom type="box" size="0.1 0.05 0.02" mass="1"/></body></worldbody>"""
    (tmp_path / "bare.xml").write_text(text + "</mujoco>")
    motors = "".join(f"<position joint='{j}' kp='7'/>" for j in ("slide", "turn", "tilt"))
    (tmp_path / "wrist.xml").write_text(text + f"<actuator>{motors}</actuator></mujoco>")
    plain = simulate(tmp_path / "bare.xml", by_force, Pd(kp=20.0, kd=0.5))
    robot = Robot.load(tmp_path / "wrist.xml")
    assert robot.joints == ("turn", "tilt", "slide")
    assert replay_error(plain, robot) < 1e-9
