"""Where the base is, what feet are, URDF, and the hash of a robot, on models written here."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.errors import InputError
from leapgap.robot.kinematics import body_poses, centre_of_mass, configurations, feet_positions
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PartNames
from leapgap.simulation.corrected import read_corrected, write_corrected
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.plain_simulation import Pd, by_force, simulate

HOPPER = """
<mujoco model="hopper">
  <option timestep="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 0.1"/>
    <body name="table" pos="2 0 0"><geom name="top" type="box" size="0.2 0.2 0.1" mass="50"/></body>
    <body name="torso" pos="0 0 0.7">
      {base}
      <geom type="box" size="0.1 0.1 0.05" mass="5" contype="0" conaffinity="0"/>
      <body name="thigh" pos="0 0 -0.05">
        <joint name="hip" axis="0 1 0"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.3" mass="0.5" contype="0" conaffinity="0"/>
        <body name="shank" pos="0 0 -0.3">
          <joint name="knee" axis="0 1 0"/>
          <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.28" mass="0.4" contype="0" conaffinity="0"/>
          <geom type="box" size="0.08 0.04 0.01" pos="0.02 0 -0.29" mass="0.1"/>
          <site name="sole" pos="0.02 0 -0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip"/><motor joint="knee"/></actuator>
</mujoco>"""


def hopper(folder: Path, base: str = "<freejoint/>", **options: object) -> Robot:
    path = folder / "hopper.xml"
    path.write_text(HOPPER.format(base=base))
    return Robot.load(path, names=PartNames(feet=("sole",)), **options)  # type: ignore[arg-type]


def test_the_base_is_the_body_with_the_free_joint(tmp_path: Path) -> None:
    robot = hopper(tmp_path)
    assert robot.model.body(1).name == "table"
    assert robot.model.body(robot.base_body).name == "torso"
    assert robot.total_mass == pytest.approx(6.0)
    com = centre_of_mass(robot, robot.model.qpos0[None])[0]
    assert com == pytest.approx([0.1 * 0.02 / 6, 0, (5 * 0.7 + 0.5 * 0.5 + 0.4 * 0.21 + 0.1 * 0.06) / 6])
    assert body_poses(robot, configurations(robot, np.zeros((1, 2)))).bodies == ("torso", "thigh", "shank")
    changed = robot.on_terrain(())
    effects.effect("payload", mass_kg=1.0).change_model(changed, robot)
    assert changed.body("torso").mass == pytest.approx(6.0)
    assert changed.body("table").mass == pytest.approx(50.0)


def test_a_robot_of_a_fixed_base_has_no_trunk_to_load(tmp_path: Path) -> None:
    trunk = {"payload", "com_offset", "trunk_inertia", "aerodynamic_drag", "state_latency"}
    assert trunk <= {h.name for h in list_hypotheses(list(effects.known()), hopper(tmp_path), None)}
    for robot in (hopper(tmp_path, base=""), hopper(tmp_path, fix_base=True)):
        assert not robot.has_free_base
        assert not trunk & {h.name for h in list_hypotheses(list(effects.known()), robot, None)}


def test_a_site_is_a_foot_where_it_is_and_its_box_touches(tmp_path: Path) -> None:
    robot = hopper(tmp_path)
    assert robot.feet == ("sole",)
    assert feet_positions(robot, robot.model.qpos0[None])[0] == pytest.approx(np.array([[0.02, 0, 0.05]]))
    assert robot.foot_radius == pytest.approx([0.0], abs=1e-12)
    box = robot.model.geom(robot.foot_geoms[0])
    assert box.type == int(mujoco.mjtGeom.mjGEOM_BOX)
    slippery = robot.on_terrain(())
    effects.effect("foot_friction", mu=0.3).change_model(slippery, robot)
    assert slippery.geom(robot.foot_geom_names[0]).friction[0] == 0.3


def test_a_hopper_on_its_box_foot_is_replayed_as_plain_mujoco_moves_it(tmp_path: Path) -> None:
    robot = hopper(tmp_path)
    plain = simulate(robot.path, by_force, Pd(kp=30.0, kd=1.0, swing=0.05), rows=301, lift_m=-0.049)
    assert plain.qpos[:, 2].min() < 0.66
    (motion,) = Replayer(robot).motions([Rollout(plain.log)])
    assert motion.qpos == pytest.approx(plain.qpos, abs=1e-6)


def test_a_foot_that_touches_nothing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "hopper.xml"
    path.write_text(
        HOPPER.format(base="<freejoint/>").replace('<joint name="hip"', '<site name="s"/><joint name="hip"')
    )
    with pytest.raises(InputError, match="the foot s on a body without a geom that touches"):
        Robot.load(path, names=PartNames(feet=("s",))).foot_geoms  # noqa: B018


def test_a_floating_robot_without_a_floor_falls_and_says_so(tmp_path: Path) -> None:
    assert hopper(tmp_path).notes == ()
    path = tmp_path / "hopper.xml"
    lines = [line for line in path.read_text().splitlines() if "floor" not in line and "table" not in line]
    path.write_text("\n".join(lines))
    assert "the model has no ground" in Robot.load(path).notes[0]


@pytest.mark.parametrize(
    "effect", [None, effects.effect("ground_slope", pitch_rad=0.1), effects.effect("ground_height", height_m=0.03)]
)
def test_a_floor_that_is_a_geom_of_a_body_is_ground(tmp_path: Path, effect: effects.Effect | None) -> None:
    """Sloped and raised too, it lies where the same geom of the world would."""
    floor = '<geom name="floor" type="plane" size="5 5 0.1"/>'
    frames = []
    for name, moved in (("world", floor), ("body", f'<body pos="0.5 0 0">{floor}</body>')):
        (tmp_path / name).mkdir()
        robot = hopper(tmp_path / name)
        robot.path.write_text(robot.path.read_text().replace(floor, moved))
        robot = Robot.load(robot.path, names=PartNames(feet=("sole",)))
        assert robot.notes == ()
        spec = robot.spec()
        if effect:
            effect.change_spec(spec, robot)
        model = spec.compile()
        if effect:
            effect.change_model(model, robot)
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        planes = np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE))
        normal = data.geom_xmat[planes].reshape(-1, 3, 3)[:, :, 2]
        frames.append(np.concatenate([normal, (normal * data.geom_xpos[planes]).sum(axis=1)[:, None]], axis=1))
    assert frames[0] == pytest.approx(frames[1])
    assert len(frames[0]) == (2 if effect and effect.name == "ground_height" else 1)


URDF = """<robot name="leg">
  <link name="base"><inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>
    </inertial><visual><geometry><mesh filename="package://leg_description/meshes/base.dae"/></geometry></visual></link>
  {mount}
  <link name="thigh"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://leg_description/meshes/thigh.obj"/></geometry></visual></link>
  <link name="shank"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hip" type="revolute"><parent link="base"/><child link="thigh"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="9" velocity="20"/><dynamics damping="0.1" friction="0.2"/></joint>
  <joint name="knee" type="continuous"><parent link="thigh"/><child link="shank"/><origin xyz="0 0 -0.2"/>
    <axis xyz="0 1 0"/></joint>
</robot>"""
MOUNT = '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def urdf(folder: Path, mount: str = MOUNT, **options: object) -> Robot:
    """A URDF in a ROS package, with a mesh that MuJoCo reads and one that it does not."""
    package = folder / "leg_description"
    (package / "urdf").mkdir(parents=True, exist_ok=True)
    (package / "meshes").mkdir(exist_ok=True)
    (package / "meshes" / "thigh.obj").write_text(TETRAHEDRON)
    (package / "urdf" / "leg.urdf").write_text(URDF.format(mount=mount))
    return Robot.load(package / "urdf" / "leg.urdf", **options)  # type: ignore[arg-type]


def test_a_urdf_is_a_robot_with_a_motor_at_each_joint(tmp_path: Path) -> None:
    robot = urdf(tmp_path)
    assert robot.joints == robot.driven_joints == ("hip", "knee")
    assert robot.torque_limits.tolist() == [9, np.inf]
    assert robot.model.dof_damping.tolist() == [0.1, 0]
    assert robot.model.dof_frictionloss.tolist() == [0.2, 0]
    assert robot.model.nmesh == 1
    assert "1 shapes are left out" in robot.notes[0] and "base.dae" in robot.notes[0]
    assert not robot.has_free_base


def test_a_urdf_moves_as_an_mjcf_of_the_same_figures(tmp_path: Path) -> None:
    """The same two links written by hand as an MJCF; a joint without commands in the log moves by itself."""

    def link(name: str, joint: str, mass: float, at: str, more: str = "", inside: str = "") -> str:
        inertial = f'<inertial pos="0 0 -0.1" mass="{mass}" diaginertia="0.01 0.01 0.001"/>'
        return f'<body name="{name}" pos="{at}">{inertial}<joint name="{joint}" axis="0 1 0" {more}/>{inside}</body>'

    shank = link("shank", "knee", 0.5, "0 0 -0.2")
    thigh = link("thigh", "hip", 1.0, "0 0 0", 'damping="0.1" frictionloss="0.2" range="-114.592 114.592"', shank)
    (tmp_path / "leg.xml").write_text(f"<mujoco model='leg'><worldbody>{thigh}</worldbody></mujoco>")
    plain = simulate(tmp_path / "leg.xml", by_force, Pd(push=2.0), commanded=lambda joint: joint == "hip")
    (motion,) = Replayer(urdf(tmp_path)).motions([Rollout(plain.log)])
    assert motion.qpos == pytest.approx(plain.qpos, abs=1e-6)


def test_a_urdf_floats_where_that_is_asked_for(tmp_path: Path) -> None:
    assert urdf(tmp_path, mount="", fix_base=False).has_free_base
    assert not urdf(tmp_path, mount="").has_free_base


def meshed(folder: Path, geom: str) -> Path:
    """A pendulum with a mesh whose file is missing."""
    path = folder / "pendulum.xml"
    path.write_text(f"""<mujoco><asset><mesh name="shell" file="nowhere/shell.stl"/></asset><worldbody>
      <body name="rod"><inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/><joint name="hinge"/>
      <geom type="mesh" mesh="shell" {geom}/></body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>""")
    return path


def test_a_namespace_on_the_robot_of_a_urdf_changes_nothing(tmp_path: Path) -> None:
    plain = urdf(tmp_path)
    other = plain.path.with_name("other.urdf")
    other.write_text(plain.path.read_text().replace("<robot ", '<robot xmlns="http://www.ros.org/urdf" '))
    assert Robot.load(other).sha256 == plain.sha256


def test_visual_meshes_whose_files_are_missing_are_left_out_with_a_note(tmp_path: Path) -> None:
    robot = Robot.load(meshed(tmp_path, 'contype="0" conaffinity="0"'))
    assert robot.notes == ("1 visual meshes are left out, since their files are missing: nowhere/shell.stl",)
    assert robot.total_mass == 1.0
    with pytest.raises(InputError, match=r"no file nowhere/shell\.stl, of a mesh that collides"):
        Robot.load(meshed(tmp_path, ""))


def test_a_urdf_is_corrected_as_an_mjcf(tmp_path: Path) -> None:
    robot = urdf(tmp_path)
    write_corrected(tmp_path / "corrected", robot, (effects.effect("joint_friction", torque_nm=0.3),))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected" / "robot.xml"))
    assert model.dof_frictionloss == pytest.approx([0.5, 0.3])
    assert model.nu == 2
    again, _ = read_corrected(tmp_path / "corrected")
    assert again.torque_limits.tolist() == [9, np.inf]
    assert again.model.body_mass == pytest.approx(robot.model.body_mass)


def test_the_hash_is_that_of_the_compiled_model(tmp_path: Path) -> None:
    first = hopper(tmp_path).sha256
    path = tmp_path / "hopper.xml"
    path.write_text("<!-- a comment -->\n" + path.read_text().replace('mass="0.50"', 'mass="0.5"'))
    assert Robot.load(path, names=PartNames(feet=("sole",))).sha256 == first
    path.write_text(path.read_text().replace('mass="0.4"', 'mass="0.4001"'))
    assert Robot.load(path, names=PartNames(feet=("sole",))).sha256 != first
    assert hopper(tmp_path, fix_base=True).sha256 != first


def test_included_files_and_meshes_count_in_the_hash(tmp_path: Path) -> None:
    inner = hopper(tmp_path).path
    outer = tmp_path / "scene.xml"
    outer.write_text(f'<mujoco model="scene"><include file="{inner.name}"/></mujoco>')
    first = Robot.load(outer).sha256
    inner.write_text(inner.read_text().replace('mass="0.4"', 'mass="0.45"'))
    assert Robot.load(outer).sha256 != first
    leg = urdf(tmp_path)
    first = leg.sha256
    (tmp_path / "leg_description" / "meshes" / "thigh.obj").write_text(TETRAHEDRON.replace("v 1 0 0", "v 1.5 0 0"))
    assert Robot.load(leg.path).sha256 != first


OVERLAP = """<mujoco model="overlap"><worldbody>
  <body name="base" pos="0 0 1"><freejoint/><geom size=".1" mass="5"/>
    <body name="shell"><geom size=".1" pos="0 .05 0" mass="1"/>
      <body pos="0 .1 0"><joint name="hip" axis="1 0 0"/><geom size=".08" mass="1"/></body></body></body>
</worldbody><actuator><motor joint="hip"/></actuator></mujoco>"""


def test_a_held_base_does_not_touch_the_links_at_it(tmp_path: Path) -> None:
    """MuJoCo forbids contacts of a body with its parent, but not those of a parent that does not move."""
    path = tmp_path / "overlap.xml"
    path.write_text(OVERLAP)
    for held in (None, True):
        model = Robot.load(path, fix_base=held).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon == 0, held


def test_blocks_carry_a_foot_whatever_its_collision_bits(tmp_path: Path) -> None:
    """A foot that the file's floor alone asks to collide (its own conaffinity is 0) stands on a block as well."""
    robot = hopper(tmp_path)
    own = 'contype="4" conaffinity="0"'
    text = robot.path.read_text().replace('<geom type="box" size="0.08', f'<geom {own} type="box" size="0.08')
    robot.path.write_text(text.replace('name="floor"', 'name="floor" conaffinity="4"'))
    model = Robot.load(robot.path, names=PartNames(feet=("sole",))).on_terrain((Box(0.0, 0.0, (0.5, 0.5, 0.1), 0.1),))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    block = model.geom("terrain_0").id
    assert any(block in contact.geom for contact in data.contact)
