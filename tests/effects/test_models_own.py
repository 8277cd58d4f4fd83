"""Effects start from what the robot at hand has, and may take it away."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.log import Log
from leapgap.robot.actuators import MotorConstants
from leapgap.robot.model import DEFAULT_MODEL, Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.conftest import standing

FOOT = 'condim="3" friction="0.8 0.02 0.01"\n            priority="1" solref="0.02 1" solimp="0.9 0.95 0.001"'
JOINTS = '<joint damping="0.01" frictionloss="0.2" armature="0.01"/>'


def modified_a1(folder: Path, *changes: tuple[str, str]) -> Robot:
    """The A1 with numbers of its file changed."""
    text = DEFAULT_MODEL.read_text()
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    folder.mkdir(exist_ok=True)
    (folder / "changed.xml").write_text(text)
    return Robot.load(folder / "changed.xml")


def with_feet(folder: Path, friction: float = 0.8, solref: str = "0.02 1", priority: int = 1) -> Robot:
    foot = FOOT.replace('"0.8 ', f'"{friction} ').replace("0.02 1", solref)
    return modified_a1(folder, (FOOT, foot.replace('priority="1"', f'priority="{priority}"')))


def with_feet_of(folder: Path, **friction: float) -> Robot:
    """Sliding friction of each foot by its name."""
    own = [
        (f'<geom name="{foot}" class="foot"', f'<geom name="{foot}" class="foot" friction="{mu} 0.02 0.01"')
        for foot, mu in friction.items()
    ]
    return modified_a1(folder, *own)


def slide(robot: Robot, *found: effects.Effect) -> Motion:
    """Thrown forward while it stands: the feet slide and the contacts give."""
    jump = standing(robot, 400)
    thrown = Log("thrown", dict(jump.columns) | {"base_linvel_x": np.full(400, 1.5)}, jump.info)
    return Replayer(robot).motions([Rollout(thrown, found)])[0]


def same(one: Motion, other: Motion) -> bool:
    return np.array_equal(one.qpos, other.qpos) and np.array_equal(one.qvel, other.qvel)


def test_friction_acts_on_the_robots_own_and_not_on_the_a1s(tmp_path: Path) -> None:
    rough, usual = with_feet(tmp_path / "rough", 1.0), with_feet(tmp_path / "usual", 0.8)
    bare = slide(rough)
    assert same(slide(rough, effects.effect("foot_friction", mu=0.8)), slide(usual))
    assert same(slide(rough, effects.effect("foot_friction", mu=1.0)), bare)
    assert same(slide(rough, effects.effect("foot_friction")), bare)
    assert not same(slide(usual), bare)


def test_contact_time_acts_on_the_robots_own_and_not_on_the_a1s(tmp_path: Path) -> None:
    soft, usual = with_feet(tmp_path / "soft", solref="0.05 1"), with_feet(tmp_path / "usual")
    bare = slide(soft)
    assert same(slide(soft, effects.effect("foot_compliance", time_constant_s=0.02)), slide(usual))
    assert same(slide(soft, effects.effect("foot_compliance", time_constant_s=0.05)), bare)
    assert not same(slide(usual), bare)


def test_contact_time_of_stiffness_and_damping_keeps_the_damping_ratio(tmp_path: Path) -> None:
    """−k, −b of MuJoCo's direct form: T = 2/b, ratio = 1/(T √k); twice the time is a quarter of k and half of b."""
    direct, softer = with_feet(tmp_path / "a", solref="-2000 -80"), with_feet(tmp_path / "b", solref="-500 -40")
    (about,) = effects.known()["foot_compliance"].parameters(direct)
    assert about.nominal == pytest.approx(0.025)
    assert same(slide(direct, effects.effect("foot_compliance", time_constant_s=0.05)), slide(softer))


def test_feet_of_different_friction_keep_their_ratio(tmp_path: Path) -> None:
    robot = with_feet_of(tmp_path / "four", FR=0.5, FL=0.7, RR=0.9, RL=1.1)
    half = with_feet_of(tmp_path / "half", FR=0.25, FL=0.35, RR=0.45, RL=0.55)
    (about,) = effects.known()["foot_friction"].parameters(robot)
    assert about.nominal == about.scale == pytest.approx(0.8)
    (of_rear,) = effects.known()["foot_friction"].parameters(robot, "rear")
    assert of_rear.nominal == pytest.approx(1.0)
    assert same(slide(robot, effects.effect("foot_friction", mu=about.nominal)), slide(robot))
    found, wanted = slide(robot, effects.effect("foot_friction", mu=about.nominal / 2)), slide(half)
    assert found.qpos == pytest.approx(wanted.qpos, abs=1e-9)
    assert np.abs(wanted.qpos - slide(robot).qpos).max() > 1e-3


def test_feet_that_share_their_contact_with_the_ground_start_from_what_mujoco_mixes(tmp_path: Path) -> None:
    """Of equal priority the rougher one decides: feet of 0.5 on a floor of 0.8 have 0.8."""
    robot = with_feet(tmp_path / "shared", 0.5, solref="0.06 1", priority=0)
    (about,) = effects.known()["foot_friction"].parameters(robot)
    assert about.nominal == 0.8
    bare = slide(robot)
    assert same(slide(robot, effects.effect("foot_friction", mu=0.8)), bare)
    almost = slide(robot, effects.effect("foot_friction", mu=0.8 - 1e-9))
    assert almost.qpos == pytest.approx(bare.qpos, abs=1e-6)
    assert not np.allclose(slide(robot, effects.effect("foot_friction", mu=0.5)).qpos, bare.qpos, atol=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_what_holds_in_a_contact_is_what_mujoco_takes(tmp_path: Path, seed: int) -> None:
    """Against MuJoCo's own contacts, for random priorities, weights and both forms of solref."""
    from leapgap.effects.contacts import foot_contacts

    rng = np.random.default_rng(seed)

    def geom() -> str:
        solref = f"{rng.uniform(0.01, 0.1)} 1" if rng.random() < 0.7 else f"{-rng.uniform(100, 900)} -30"
        return (
            f'priority="{rng.integers(2)}" solmix="{rng.choice([0.0, 0.5, 2.0])}" condim="{rng.choice([1, 3, 4])}" '
            f'friction="{rng.uniform(0.2, 1.5)} {rng.uniform(0.001, 0.1)} {rng.uniform(0.001, 0.1)}" '
            f'solref="{solref}" solimp="{rng.uniform(0.5, 0.8)} 0.9 0.01 0.5 2"'
        )

    (tmp_path / "ball.xml").write_text(
        f"""<mujoco><worldbody><geom name="floor" type="plane" size="5 5 0.1" {geom()}/>
        <body pos="0 0 0.099"><freejoint/><geom name="S" type="sphere" size="0.1" {geom()}/>
        <body name="b"><joint name="S_j" axis="1 0 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
        </body></worldbody><actuator><motor joint="S_j"/></actuator></mujoco>"""
    )
    ball = Robot.load(tmp_path / "ball.xml")
    data = mujoco.MjData(ball.model)
    mujoco.mj_forward(ball.model, data)
    contact, said = data.contact[0], foot_contacts(ball, "all")
    assert said.condim[0] == contact.dim
    assert said.friction[0] == pytest.approx(contact.friction[[0, 2, 3]])
    assert said.solref[0] == pytest.approx(contact.solref)
    assert said.solimp[0] == pytest.approx(contact.solimp)


PENDULUM = """<mujoco model="pendulum"><option timestep="0.001" integrator="implicitfast"/><worldbody>
  <body><joint name="L_swing" axis="0 1 0" {joint}/><geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/>
  <body pos="0.3 0 0"><joint name="L_elbow" axis="0 1 0" damping="0.3" frictionloss="0.1" armature="0.05"/>
  <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.5"/></body></body></worldbody>
  <actuator><general joint="L_swing" biastype="affine"/><general joint="L_elbow" biastype="affine"/></actuator></mujoco>
"""
OWN = {"damping": 0.2, "frictionloss": 0.3, "armature": 0.02}


def swing(folder: Path, *found: effects.Effect) -> np.ndarray:
    """Angles of the pendulum that falls from level, (300, 2), by a replay."""
    (folder / "pendulum.xml").write_text(PENDULUM.format(joint=" ".join(f'{k}="{v}"' for k, v in OWN.items())))
    robot, rows = Robot.load(folder / "pendulum.xml"), 300
    quantities = ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    columns = {f"{quantity}/{joint}": np.zeros(rows) for quantity in quantities for joint in robot.joints}
    info = jump_info("pendulum", 0.001, ContactSchedule(), Target(0.0), "made for a test")
    jump = Log("fall", {"time": np.arange(rows) / 1000} | columns, info)
    return Replayer(robot).motions([Rollout(jump, found)])[0].qpos


def plain(**numbers: float) -> np.ndarray:
    """The same by MuJoCo alone, with other numbers of the swinging joint in the file."""
    joint = " ".join(f'{k}="{v}"' for k, v in (OWN | numbers).items())
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(joint=joint))
    data, found = mujoco.MjData(model), [np.zeros(2)]
    for _ in range(299):
        mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


@pytest.mark.parametrize(
    ("name", "parameter", "number"),
    [
        ("joint_damping", "damping", "damping"),
        ("joint_friction", "torque_nm", "frictionloss"),
        ("armature", "inertia", "armature"),
    ],
)
def test_the_models_own_can_be_taken_away(tmp_path: Path, name: str, parameter: str, number: str) -> None:
    own = OWN[number]
    for taken, left in ((own, 0.0), (own / 2, own / 2), (3 * own, 0.0)):
        found = swing(tmp_path, effects.effect(name, "L_swing", **{parameter: -taken}))
        assert found == pytest.approx(plain(**{number: left}), abs=1e-9)
        assert np.abs(found - plain()).max() > 1e-3
    robot = Robot.load(tmp_path / "pendulum.xml")
    (about,) = effects.known()[name].parameters(robot, "L_swing")
    assert (about.lower, about.scale, about.lower_is_physical) == (-own, own, True)


def test_a_joint_that_has_less_than_is_taken_from_all_ends_at_zero(tmp_path: Path) -> None:
    """Damping 0.2 and 0.3, 0.25 taken from both."""
    robot = modified_a1(tmp_path, (JOINTS, JOINTS.replace("0.01", "0.2", 1)))
    jump = standing(robot, 5)
    weak = effects.effect("joint_damping", "calf", damping=0.1)
    less = effects.effect("joint_damping", damping=-0.25)
    model = Replayer(robot).model(Rollout(jump, (weak, less)))
    of_joints = model.dof_damping[robot.joint_dofs].reshape(4, 3)
    assert of_joints == pytest.approx(np.tile([0.0, 0.0, 0.05], (4, 1)))


def test_trunk_and_legs_may_weigh_far_less_than_the_model_says(robot: Robot) -> None:
    trunk = robot.model.body_mass[robot.base_body]
    (payload,) = effects.known()["payload"].parameters(robot)
    assert payload.lower == pytest.approx(-0.9 * trunk) and payload.scale == trunk
    jump = standing(robot, 5)
    light = (effects.effect("payload", mass_kg=-4.0), effects.effect("leg_mass", scale=0.2))
    model = Replayer(robot).model(Rollout(jump, light))
    legs = robot.total_mass - trunk
    assert model.body_mass.sum() == pytest.approx(trunk - 4.0 + 0.2 * legs)
    emptied = Replayer(robot).model(Rollout(jump, (effects.effect("payload", mass_kg=-50.0),)))
    assert emptied.body_mass[robot.base_body] == pytest.approx(0.1 * trunk)


def test_a_voltage_that_limits_nothing_is_computed_from_the_robot(tmp_path: Path) -> None:
    """Next whole volt above R τ + q̇ at the largest torque and speed: 0.34602 · 33.5 + 21 = 32.6."""
    kind = effects.known()["torque_speed_limit"]
    assert kind.parameters(Robot.load())[0].nominal == 33.0
    strong = modified_a1(tmp_path, ("-33.5 33.5", "-80 80"))
    assert kind.parameters(strong)[0].nominal == 49.0  # 48.7
    slow = Robot.load(DEFAULT_MODEL, MotorConstants(resistance=0.1, top_speed_rad_s=4.0))
    assert kind.parameters(slow)[0].nominal == 8.0  # 7.35
    law = effects.effect("torque_speed_limit", voltage_v=33.0)
    jump = standing(strong, 5)
    assert law.is_nominal_for(Robot.load()) and not law.is_nominal_for(strong)
    assert np.isfinite(Replayer(strong).drive(Rollout(jump, (law,))).voltage_v).all()
    assert np.isinf(Replayer(Robot.load()).drive(Rollout(jump, (law,))).voltage_v).all()


def test_the_resistance_is_the_robots(tmp_path: Path) -> None:
    """At a velocity of 5 rad/s, 10 V leave (10 − 5)/R of torque."""
    jump = standing(Robot.load(), 5)
    for resistance in (0.5, 1.0):
        robot = Robot.load(DEFAULT_MODEL, MotorConstants(resistance, 21.0))
        assert robot.sha256 != Robot.load().sha256
        model = Replayer(robot).model(Rollout(jump, (effects.effect("torque_speed_limit", voltage_v=10.0),)))
        data = mujoco.MjData(model)
        data.qvel[robot.joint_dofs] = 5.0
        data.ctrl[robot.joint_actuators] = 1000.0
        mujoco.mj_forward(model, data)
        assert data.actuator_force[robot.joint_actuators] == pytest.approx(5.0 / resistance)


def test_an_effect_left_to_the_models_own_survives_configuration_and_digest() -> None:
    from leapgap.runtime.content_hash import digest

    absent = effects.effect("foot_friction", "rear")
    assert absent.values == {} and absent.is_nominal
    assert effects.from_config(effects.to_config((absent,))) == (absent,)
    assert digest(absent) == digest(effects.effect("foot_friction", "rear"))
    assert digest(absent) != digest(effects.effect("foot_friction", "rear", mu=0.8))


def test_ranges_grow_with_a_heavy_robot(tmp_path: Path) -> None:
    """As much may be added as the model has; a fifth of it is noticed."""
    heavy = modified_a1(tmp_path, (JOINTS, '<joint damping="10" frictionloss="20" armature="1"/>'))
    for name, own in (("joint_damping", 10.0), ("joint_friction", 20.0), ("armature", 1.0)):
        (about,) = effects.known()[name].parameters(heavy)
        assert (about.lower, about.upper, about.moderate, about.scale) == (-own, own, own / 5, own)
        written = effects.from_config([{"name": name, **{about.name: about.upper}}])
        assert written[0].values == {about.name: own}


@pytest.mark.parametrize(
    ("name", "small", "large"),
    [
        ("joint_friction", 6.0, 45.0),
        ("static_friction", 6.0, 45.0),
        ("joint_damping", 4.0, 30.0),
        ("armature", 0.15, 1.2),
    ],
)
def test_what_grows_with_motors_is_looked_for_further_on_larger_ones(
    name: str, small: float, large: float, tmp_path: Path
) -> None:
    """A hip of 300 N·m has more friction than any joint of the A1 could; that of the A1 is looked for as declared."""
    text = "<mujoco><worldbody><body><joint name='hip'/><geom size='0.1'/></body></worldbody>{}</mujoco>"
    motor = "<actuator><motor joint='hip' ctrllimited='true' ctrlrange='-300 300'/></actuator>"
    (tmp_path / "large.xml").write_text(text.format(motor))
    kind = effects.known()[name]
    assert kind.parameters(Robot.load())[0].upper == small
    assert kind.parameters(Robot.load(tmp_path / "large.xml"), "hip")[0].upper == pytest.approx(large)
