"""The table of real robots: what counts as right, and that absent data are left out."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from omegaconf import OmegaConf

from leapgap.diagnosis.gap import Interval
from leapgap.diagnosis.outside_forces.outside_force import OutsideForce
from leapgap.diagnosis.report import Cause, ParameterEstimate
from leapgap.diagnosis.settings import Settings
from leapgap.errors import InputError
from leapgap.logs.importers import log_format
from leapgap.logs.log import Log, LogInfo
from leapgap.reports.diagnosis import diagnose_logs
from leapgap.reports.real_robots import corrected_by, judge
from leapgap.robot.model import Robot
from leapgap.runtime.cache import ResultCache
from leapgap.validation.real_robots import (
    PublishedPush,
    RealCase,
    absent,
    compare_pushes,
    is_expected,
    outcome_of,
    published_pushes,
    read_case,
    refusal,
    toss_loss,
)
from tests.code import ROOT
from tests.commands import stage

NO_PD = ("cmd_pos/hinge", "cmd_vel/hinge", "cmd_kp/hinge", "cmd_kd/hinge")
FRICTION = {"joint_friction": {"torque_nm": [-0.1, 0.9]}}


def cause(effect: str, **values: float) -> Cause:
    """A cause with these values."""
    numbers = {name: ParameterEstimate(value, (value, value), 0.0, "1", False) for name, value in values.items()}
    return Cause(effect, "all", 1.0, numbers, {}, Interval(1, 1, 1), 0.1, ())


@pytest.mark.parametrize(
    ("found", "right"),
    [
        (cause("joint_friction", torque_nm=0.5), True),
        (cause("joint_friction", torque_nm=1.5), False),
        (cause("joint_damping", damping=0.5), False),
    ],
)
def test_a_cause_is_right_if_it_is_listed_with_its_value_in_the_range(found: Cause, right: bool) -> None:
    assert is_expected(found, FRICTION) is right
    assert not is_expected(found, {})


def naming(named: Cause, **further: object) -> SimpleNamespace:
    """The content of a report that names one cause."""
    return SimpleNamespace(
        causes=(named,),
        answer=((named.effect,),),
        closure_of_answer=None,
        verdict="named",
        gap_nominal=1.0,
        headline=SimpleNamespace(horizon_s=None),
        gap_per_log={},
        **further,
    )


def test_a_case_without_a_published_answer_is_neither_right_nor_false() -> None:
    """Whatever is named; a case whose answer is to name nothing is another matter."""
    content = naming(cause("joint_friction", torque_nm=0.5))
    case = RealCase("arm", "logs", "robot.xml", "nothing", None, False, None)
    for expected, right, false_name in ((None, None, False), ({}, False, True), (FRICTION, True, False)):
        row = outcome_of(replace(case, expected=expected), content, 1.0)
        assert (row["right"], row["false_name"]) == (right, false_name)


def test_a_case_is_left_out_where_its_files_are_absent(tmp_path: Path) -> None:
    case = RealCase("acrobot", "logs", "robot.xml", "nothing", {}, False, None)
    assert "no files in" in str(absent(case, tmp_path)) and "stages.fetch logs" in str(absent(case, tmp_path))
    (tmp_path / "logs").mkdir()
    assert "robot.xml" in str(absent(case, tmp_path))
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    assert absent(case, tmp_path) is None
    assert "no files in" in str(absent(replace(case, source="others"), tmp_path))
    assert absent(replace(case, robot="package:leapgap/validation/cube.xml"), tmp_path) is None
    lacking = str(absent(replace(case, robot="package:no_such_package/robot.xml"), tmp_path))
    assert "pip install --no-deps no-such-package" in lacking and "\n" not in lacking


def test_an_answer_without_what_a_motion_was_made_for_is_not_right() -> None:
    content = naming(cause("joint_friction", torque_nm=0.5))
    case = RealCase("arm", "logs", "robot.xml", "friction", FRICTION, False, None, asked=["joint_friction"])
    assert outcome_of(case, content, 1.0)["right"]
    row = outcome_of(replace(case, asked=["joint_play"]), content, 1.0)
    assert not row["right"] and not row["false_name"]


BALL = """
<mujoco><worldbody><body name="rod"><joint type="ball"/><geom size="0.1"/></body></worldbody></mujoco>"""


def test_a_model_that_is_refused_has_a_row_with_the_reason(tmp_path: Path) -> None:
    """Once such a model loads, the case has to say how its logs are imported."""
    case = RealCase(None, "logs", "robot.xml", "heights", {}, False, None)
    (tmp_path / "robot.xml").write_text(BALL)
    row = refusal(case, tmp_path, "robots.cases.rod")
    assert (row["verdict"], row["right"], row["false_name"]) == ("refused", None, False)
    assert "ball joints of the bodies rod" in row["reason"]
    (tmp_path / "robot.xml").write_text(ARM)
    with pytest.raises(InputError, match=r"^robots\.cases\.rod\.import_logs: found null"):
        refusal(case, tmp_path, "robots.cases.rod")


def toss(shift_m: float = 0.0, turn_rad: float = 0.0) -> Log:
    """A cube in flight by the laws of motion, turning about its upright axis; shifted and turned after its start."""
    time = np.arange(30) / 148
    angle, after = 2.0 * time, time > 0
    place = np.column_stack([0.3 * time, 0 * time, 1 + 0.5 * time - 0.5 * 9.81 * time**2]) + shift_m * after[:, None]
    half = (angle + turn_rad * after) / 2
    columns = dict(zip(("base_pos_x", "base_pos_y", "base_pos_z"), place.T, strict=True))
    columns |= {"base_quat_w": np.cos(half), "base_quat_x": 0 * time, "base_quat_y": 0 * time}
    columns |= {"base_quat_z": np.sin(half), "base_linvel_x": 0 * time + 0.3, "base_linvel_y": 0 * time}
    columns |= {"base_linvel_z": 0.5 - 9.81 * time, "base_angvel_x": 0 * time, "base_angvel_y": 0 * time}
    columns |= {"base_angvel_z": 0 * time + 2.0, "time": time}
    return Log("toss", columns, LogInfo("cube", 1 / 148, "by hand"))


@pytest.mark.parametrize(("shift", "turn", "expected"), [(0.0, 0.0, 0.0), (0.1, 0.0, 0.03 / 0.0524), (0.0, 0.4, 0.16)])
def test_the_loss_of_tosses_is_that_of_place_and_angle(shift: float, turn: float, expected: float) -> None:
    """A thirtieth of the rows is the start. MuJoCo's steps do not meet the rows exactly."""
    model = Path(find_spec("leapgap.validation").submodule_search_locations[0]) / "cube.xml"
    assert toss_loss(model, [toss(shift, turn)], 0.0524) == pytest.approx(29 / 30 * expected, rel=0.03, abs=5e-4)


def test_a_case_after_another_is_judged_against_the_robot_that_was_corrected_there(tmp_path: Path) -> None:
    loaded = RealCase("arm", "logs", "robot.xml", "200 g", {}, False, "empty")
    assert corrected_by(replace(loaded, after=None), tmp_path, "loaded") is None
    with pytest.raises(InputError, match=r"^robots\.cases\.loaded\.after: found empty; expected the name"):
        corrected_by(loaded, tmp_path, "loaded")
    model = tmp_path / "empty" / "corrected" / "robot.xml"
    model.parent.mkdir(parents=True)
    model.write_text("<mujoco/>")
    assert corrected_by(loaded, tmp_path, "loaded") == model


def test_without_any_data_the_stage_says_so_and_writes_no_metrics(tmp_path: Path) -> None:
    arguments = {"raw": tmp_path / "raw", "out": tmp_path / "out", "metrics": tmp_path / "metrics.json"}
    given = [f"robots.{key}={value}" for key, value in arguments.items()]
    done = stage("robots", *given, f"hydra.run.dir={tmp_path / 'run'}")
    assert done.returncode == 0, done.stderr
    cases = OmegaConf.load(ROOT / "conf/robots/default.yaml").cases
    assert done.stdout.count("left out") == len(cases) > 6
    assert not (tmp_path / "metrics.json").exists()
    assert not (tmp_path / "out").exists(), "reports of an earlier run would have been replaced by none"


ARM = """
<mujoco><worldbody><body name="link">
  <joint name="hinge" type="hinge" axis="0 1 0" damping="0.6" frictionloss="0.2" armature="0.01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>
</body></worldbody><actuator><motor joint="hinge" name="hinge" ctrlrange="-5 5"/></actuator></mujoco>"""


def test_a_case_may_change_the_model_file_to_another_published_description(tmp_path: Path) -> None:
    """What MuJoCo reads from the written file is the file's number and the change, and nothing else has moved."""
    (tmp_path / "arm.xml").write_text(ARM)
    time = np.arange(200) * 0.005
    table = np.column_stack([time, np.sin(time), np.cos(time), np.zeros_like(time)])
    np.savetxt(tmp_path / "logs.csv", table, delimiter=",", header="t,q,v,u", comments="")
    columns = {"time": "t", "joint_pos/hinge": "q", "joint_vel/hinge": "v", "cmd_tau/hinge": "u"}
    layout = log_format("csv")
    options = layout.Options(columns=columns, constants=dict.fromkeys(NO_PD, 0.0))
    changes = [{"name": "joint_damping", "location": "all", "damping": 1.4}]
    case = RealCase("arm", "logs.csv", "arm.xml", "damping of 2", {}, False, None, changes)
    robot, (log,) = read_case(case, tmp_path, layout, options, tmp_path / "models")
    assert len(log) == 200
    told = mujoco.MjModel.from_xml_path(str(robot.path))
    assert (told.dof_damping[0], told.dof_frictionloss[0], told.dof_armature[0]) == pytest.approx((2.0, 0.2, 0.01))
    assert Path(tmp_path / "arm.xml").read_text() == ARM


@pytest.mark.long  # twelve seconds: a diagnosis
def test_a_finished_case_is_kept_and_a_changed_one_is_diagnosed_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Plain MuJoCo moves an arm with more damping than its file has; two logs of it."""
    raw, model = tmp_path / "raw", mujoco.MjModel.from_xml_string(ARM)
    (raw / "logs").mkdir(parents=True)
    (raw / "arm.xml").write_text(ARM)
    model.dof_damping[0] += 0.5
    for number in range(2):
        data, rows = mujoco.MjData(model), []
        for step in range(1000):
            data.ctrl[0] = 2.0 * np.sin((4.0 + number) * data.time) + np.sin(11.0 * data.time)
            if step % 2 == 0:
                rows.append([data.time, data.qpos[0], data.qvel[0], data.ctrl[0]])
            mujoco.mj_step(model, data)
        np.savetxt(raw / f"logs/log_{number}.csv", rows, delimiter=",", header="t,q,v,u", comments="")
    case = RealCase("arm", "logs", "arm.xml", "damping of 1.1", {"joint_damping": {"damping": [0.4, 0.6]}}, False, None)
    columns = {"time": "t", "joint_pos/hinge": "q", "joint_vel/hinge": "v", "cmd_tau/hinge": "u"}
    layout = log_format("csv")
    source = layout, layout.Options(columns=columns, constants=dict.fromkeys(NO_PD, 0.0))
    settings = Settings(effects=("joint_damping", "joint_friction"), bootstrap_draws=20)
    cache = ResultCache(tmp_path / "out")

    first = judge(cache, "arm", case, raw, source, settings, {})
    assert first["right"] and (tmp_path / "out/arm/report.html").is_file()
    capsys.readouterr()
    assert judge(cache, "arm", case, raw, source, settings, {}) == first
    assert capsys.readouterr().out.splitlines()[0].startswith("arm: right."), "nothing was diagnosed"
    judge(cache, "arm", case, raw, source, replace(settings, bootstrap_draws=21), {})
    assert not capsys.readouterr().out.splitlines()[0].startswith("arm: right."), "a new setting was not looked at"


@pytest.mark.long  # a diagnosis
def test_the_friction_of_a_tossed_cube_is_found(tmp_path: Path) -> None:
    """Plain MuJoCo tosses the cube with half of the file's friction, 148 rows a second; it has no motor to command."""
    path = Path(find_spec("leapgap.validation").submodule_search_locations[0]) / "cube.xml"
    model, period, logs = mujoco.MjModel.from_xml_path(str(path)), 0.007, []
    model.geom_friction[:, 0] = 0.25
    names = [f"base_pos_{axis}" for axis in "xyz"] + [f"base_quat_{axis}" for axis in "wxyz"]
    names += [f"base_linvel_{axis}" for axis in "xyz"] + [f"base_angvel_{axis}" for axis in "xyz"]
    for number in range(4):
        rng, data, rows = np.random.default_rng(number), mujoco.MjData(model), []
        data.qpos[2], data.qvel[:] = 0.15, [*rng.uniform(0.5, 1.0, 2), 0.3, *rng.uniform(-4, 4, 3)]
        for _ in range(100):
            rows.append([*data.qpos, *data.qvel])
            mujoco.mj_step(model, data, nstep=7)
        columns = {"time": period * np.arange(100), **dict(zip(names, np.array(rows).T, strict=True))}
        logs.append(Log(f"toss_{number}", columns, LogInfo("cube", period, "by hand")))
    settings = Settings(effects=["foot_friction"], best=False, bootstrap_draws=20, noise_draws=1)
    report = diagnose_logs(logs, Robot.load(path), settings).content
    assert report.answer[0] == ("foot_friction",)
    assert report.causes[0].parameters["mu"].value == pytest.approx(0.25, abs=0.05)


def pushes_of(folder: Path) -> list[PublishedPush]:
    """Those of a table with two triangular pushes at a joint, +0.1 N·m·s about 0.5 s and −0.2 N·m·s about 1.5 s."""
    time = np.arange(0, 2, 0.001)
    torque = 1.0 * np.maximum(1 - np.abs(time - 0.5) / 0.1, 0) - 2.0 * np.maximum(1 - np.abs(time - 1.5) / 0.1, 0)
    table = np.column_stack([time + 7.0, torque])
    np.savetxt(folder / "one.csv", table, delimiter=",", header="time,tau_pert1", comments="")
    return published_pushes(folder, {"shoulder": "tau_pert1"})


def force(time_s: float, impulse: float, at: str = "shoulder") -> OutsideForce:
    interval = (impulse - 0.01, impulse + 0.01)
    return OutsideForce("one", at, "", time_s, time_s - 0.1, time_s + 0.1, 10 * impulse, impulse, interval, "N·m", 9.0)


def test_published_pushes_are_read_with_their_time_and_impulse(tmp_path: Path) -> None:
    first, second = pushes_of(tmp_path)
    assert (first.log, first.joint) == ("one", "shoulder")
    assert (first.time_s, first.impulse) == (pytest.approx(0.5, abs=1e-3), pytest.approx(0.1, rel=0.01))
    assert (second.time_s, second.impulse) == (pytest.approx(1.5, abs=1e-3), pytest.approx(-0.2, rel=0.01))
    assert not published_pushes(tmp_path, {})


@pytest.mark.parametrize(
    ("told", "found", "false", "share"),
    [
        ((force(0.52, 0.3), force(1.47, -0.18)), 2, 0, (0.1 + 0.18) / 0.3),
        ((force(0.5, 0.1), force(1.44, -0.2)), 1, 1, 1 / 3),
        ((force(0.5, -0.1), force(1.5, -0.2, "elbow")), 0, 2, 0.0),
        ((), 0, 0, 0.0),
    ],
)
def test_a_push_is_found_at_its_joint_time_and_sign(
    tmp_path: Path, told: tuple[OutsideForce, ...], found: int, false: int, share: float
) -> None:
    compared = compare_pushes(pushes_of(tmp_path), told)
    assert (compared["found"], compared["false"]) == (found, false)
    assert compared["impulse_share"] == pytest.approx(share, rel=0.01)


@pytest.mark.parametrize(("impulse", "right"), [(-0.18, True), (-0.1, False)])
def test_pushes_are_right_where_most_of_their_impulse_is_told(tmp_path: Path, impulse: float, right: bool) -> None:
    case = RealCase("acrobot", "acrobot", "robot.xml", "pushes", {"external_push": {}}, False, None)
    content = naming(cause("external_push"), outside_forces=(force(0.5, 0.1), force(1.5, impulse)))
    row = outcome_of(case, content, 1.0, pushes_of(tmp_path))
    assert (row["right"], row["false_name"]) == (right, False)
