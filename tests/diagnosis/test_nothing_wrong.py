"""Robots with nothing wrong are told so: an A1 by plain MuJoCo, whose jumps are at the edge of slipping.

Its logs come from ``mj_step`` and a joint PD that is written here and runs in steps of 0.5 ms; masses, friction and
gains are wrong by up to 3 %. Of the project are only the commands, the plans of the jumps, and the form of a log.
"""

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.settings import Settings
from leapgap.jumping.planning.reference import plan_reference, select_planar_robot
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.code import ROOT

A1 = ROOT / "src" / "leapgap" / "robot" / "a1.xml"
STEP_S, STANDS_S, SHARE = 0.0005, 0.5, 0.03
NOISE = {"base_pos": 0.0012, "base_linvel": 0.012, "base_angvel": 0.018, "joint_pos": 0.0006, "joint_vel": 0.06}
SETTINGS = Settings(effects=["joint_damping", "encoder_bias", "command_delay"], folds=2, best=False)
Change = Callable[[mujoco.MjModel], None]


@pytest.fixture(scope="module")
def a1() -> Robot:
    return Robot.load(A1)


@pytest.fixture(scope="module")
def plans(a1: Robot) -> list[Log]:
    """Two jumps planned for the robot's own model."""
    planar = select_planar_robot("own", a1)
    return [plan_reference(Target(x, 0.0), planar) for x in (0.38, 0.55)]


def simulated_robot(rng: np.random.Generator, change: Change) -> mujoco.MjModel:
    """The A1 by semi-implicit Euler in half the steps, with all that a maker's numbers are wrong by."""
    model = mujoco.MjModel.from_xml_path(str(A1))

    def factors(number: int) -> np.ndarray:
        return 1 + SHARE * rng.uniform(-1, 1, number)

    mass = factors(model.nbody)
    model.body_mass[:] *= mass
    model.body_inertia[:] *= mass[:, None]
    for own in (model.dof_damping, model.dof_frictionloss, model.dof_armature):
        own[6:] *= factors(model.nv - 6)
    model.geom_friction[[model.geom(foot).id for foot in ("FR", "FL", "RR", "RL")], 0] *= factors(4)
    model.opt.timestep, model.opt.integrator = STEP_S, int(mujoco.mjtIntegrator.mjINT_EULER)
    change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def jump(model: mujoco.MjModel, plan: Log, name: str, rng: np.random.Generator, bias: np.ndarray) -> Log:
    """One jump from standing, its joint angles reported with a bias (joints,) that the joint PD has, too."""
    joints = [model.joint(j).name for j in range(1, model.njnt)]
    data, rows = mujoco.MjData(model), len(plan)
    sent = {key: np.stack([plan[f"cmd_{key}/{joint}"] for joint in joints], axis=1) for key in ("pos", "vel", "tau")}
    kp, kd = (np.array([plan[f"cmd_{key}/{joint}"][0] for joint in joints]) for key in ("kp", "kd"))
    wrong = 1 + SHARE * rng.uniform(-1, 1, 2) / 3
    data.qpos[:3] = [plan[f"base_pos_{axis}"][0] for axis in "xyz"]
    data.qpos[3:7] = [plan[f"base_quat_{part}"][0] for part in "wxyz"]
    data.qpos[7:] = [plan[f"joint_pos/{joint}"][0] for joint in joints]
    qpos, qvel = np.empty((rows, model.nq)), np.empty((rows, model.nv))
    for row in range(-round(STANDS_S / plan.info.sample_period_s), rows):
        at = max(row, 0)
        if row >= 0:
            qpos[row], qvel[row] = data.qpos, data.qvel
        for _ in range(round(plan.info.sample_period_s / STEP_S)):
            angle = data.qpos[7:] + bias
            torque = kp * wrong[0] * (sent["pos"][at] - angle) + kd * wrong[1] * (sent["vel"][at] - data.qvel[6:])
            data.ctrl[:] = sent["tau"][at] + torque
            mujoco.mj_step(model, data)
    qpos[:, 7:] += bias
    columns = {key: plan[key] for key in plan.columns if key == "time" or key.startswith("cmd_")}

    def measure(quantity: str, ends: list[str], values: np.ndarray) -> None:
        noisy = values + NOISE.get(quantity, 0.0) * rng.standard_normal(values.shape)
        for end, column in zip(ends, noisy.T, strict=True):
            columns[f"{quantity}{end}"] = np.ascontiguousarray(column)

    axes, of_joints = ["_x", "_y", "_z"], [f"/{joint}" for joint in joints]
    turned = qpos[:, 3:7] + 0.00075 * rng.standard_normal((rows, 4))
    measure("base_quat", ["_w", "_x", "_y", "_z"], turned / np.linalg.norm(turned, axis=1)[:, None])
    measure("base_pos", axes, qpos[:, :3])
    measure("base_linvel", axes, qvel[:, :3])
    measure("base_angvel", axes, qvel[:, 3:6])
    measure("joint_pos", of_joints, qpos[:, 7:])
    measure("joint_vel", of_joints, qvel[:, 6:])
    return Log(name, columns, replace(plan.info, source="plain MuJoCo"))


def report_of(
    plans: list[Log],
    a1: Robot,
    change: Change = lambda _: None,
    bias: dict[str, float] | None = None,
    settings: Settings = SETTINGS,
) -> ReportContent:
    """Report on the jumps of one robot."""
    rng = np.random.default_rng(500)
    model = simulated_robot(rng, change)
    biases = np.array([(bias or {}).get(joint, 0.0) for joint in a1.joints])
    logs = [jump(model, plan, f"jump_{k}", rng, biases) for k, plan in enumerate(plans)]
    return diagnose(logs, a1, settings, threads=1).report


@pytest.mark.long
def test_a_gap_that_steps_and_integrator_open_is_nobodys_fault(plans: list[Log], a1: Robot) -> None:
    """The gap is five noise floors and more, of a slip that the length of a step decides; no cause is needed."""
    report = report_of(plans, a1)
    assert report.gap_nominal > 4 * report.noise_floor
    assert (report.verdict, report.answer) == ("none", ()), report.sentence
    assert report.sentence.startswith("These 2 logs show no fault of the robot: ")
    assert "errors of contacts and time steps" in report.sentence


@pytest.mark.long
def test_a_stiffer_floor_of_another_simulation_is_no_cause(plans: list[Log], a1: Robot) -> None:
    """Feet on a pyramid of friction sink in less, which looks like a floor a millimetre lower, and a gap besides."""

    def contacts(model: mujoco.MjModel) -> None:
        model.opt.cone, model.opt.impratio = int(mujoco.mjtCone.mjCONE_PYRAMIDAL), 10.0

    report = report_of(plans, a1, contacts, settings=SETTINGS)
    assert (report.verdict, report.answer) == ("none", ()), report.sentence


@pytest.mark.long
def test_a_small_bias_is_still_named_beside_them(plans: list[Log], a1: Robot) -> None:
    """An angle that is 0.02 rad off at one knee is told from all that simulations differ by."""
    report = report_of(plans, a1, bias={"FL_calf": 0.02})
    assert report.answer == (("encoder_bias",),), report.sentence
    assert report.causes[0].location == "FL_calf"
    assert report.causes[0].parameters["bias_rad"].value == pytest.approx(0.02, rel=0.1)


@pytest.mark.long
def test_a_bias_of_all_knees_is_no_lower_floor(plans: list[Log], a1: Robot) -> None:
    """Knees that are 0.02 rad off lower all feet alike. Where a foot lands is not linear in an angle."""
    settings = replace(SETTINGS, effects=["encoder_bias", "ground_height"])
    knees = dict.fromkeys(("FR_calf", "FL_calf", "RR_calf", "RL_calf"), -0.022)
    report = report_of(plans, a1, bias=knees, settings=settings)
    assert report.answer == (("encoder_bias",),), report.sentence
    assert report.causes[0].location == "calf"
    assert report.causes[0].parameters["bias_rad"].value == pytest.approx(-0.022, rel=0.15)


@pytest.mark.long
def test_a_slow_cause_beside_a_fast_one_is_told_by_whole_logs(plans: list[Log], a1: Robot) -> None:
    """A slippery floor gains a hundredth of what friction at the thighs does in short pieces."""
    thighs, feet = ("FR_thigh", "FL_thigh", "RR_thigh", "RL_thigh"), ("FR", "FL", "RR", "RL")

    def worn(model: mujoco.MjModel) -> None:
        for thigh in thighs:
            model.dof_frictionloss[model.joint(thigh).dofadr[0]] += 2.0
        model.geom_friction[[model.geom(foot).id for foot in feet], 0] *= 0.65

    settings = replace(SETTINGS, effects=["joint_friction", "joint_damping", "foot_friction"])
    report = report_of(plans, a1, worn, settings=settings)
    assert report.answer == (("joint_friction",), ("foot_friction",)), report.sentence
    friction, floor = report.causes[:2]
    assert friction.location == "thigh"
    assert friction.parameters["torque_nm"].value == pytest.approx(2.0, rel=0.05)
    assert floor.parameters["mu"].value == pytest.approx(0.65 * 0.8, rel=0.05)
