"""The page of a diagnosis: what its map calls the legs of a robot, and how its curves are drawn."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from leapgap.diagnosis.channels import JUMP
from leapgap.diagnosis.gap import Interval
from leapgap.diagnosis.localisation import Place
from leapgap.diagnosis.report import Cause, ParameterEstimate
from leapgap.effects import sentence_words
from leapgap.logs.log import Log, LogInfo
from leapgap.reports.channels_data import channels_data, row_of
from leapgap.reports.diagnosis import cause_in_words, largest_errors
from leapgap.reports.diagnosis_figures import closures
from leapgap.reports.page import CORRECTED
from leapgap.reports.report import loudest, next_words, tiles
from leapgap.robot.model import Robot
from tests.conftest import standing

LEG = """
    <body name="{leg}_HIP" pos="{x} {y} 0">
      <joint name="{leg}_HAA" axis="1 0 0"/><geom type="sphere" size="0.05" mass="1.4"/>
      <body name="{leg}_THIGH" pos="0 {out} 0">
        <joint name="{leg}_KFE" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" mass="1"/>
        <geom name="{leg}_FOOT" type="sphere" size="0.03" pos="0 0 -0.3" mass="0.1"/>
      </body>
    </body>"""
LEGS = {"LF": (0.3, 0.1), "RF": (0.3, -0.1), "LH": (-0.3, 0.1), "RH": (-0.3, -0.1)}


@pytest.fixture(scope="module")
def hind_legged(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """A quadruped whose legs are named side first, as an ANYmal's are: left or right, then front or hind."""
    legs = "".join(LEG.format(leg=leg, x=x, y=y, out=y) for leg, (x, y) in LEGS.items())
    motors = "".join(f'<motor joint="{leg}_{joint}"/>' for leg in LEGS for joint in ("HAA", "KFE"))
    path: Path = tmp_path_factory.mktemp("model") / "side_first.xml"
    path.write_text(
        f"""<mujoco model="side_first"><worldbody>
  <body name="base" pos="0 0 0.5"><freejoint/><geom type="box" size="0.3 0.1 0.1" mass="18"/>{legs}</body>
</worldbody><actuator>{motors}</actuator></mujoco>"""
    )
    return Robot.load(path)


@pytest.mark.parametrize(
    ("channel", "row"),
    [
        ("joint_vel/RF_KFE", "front KFE velocity"),
        ("joint_vel/LF_KFE", "front KFE velocity"),
        ("joint_pos/RH_HAA", "rear HAA position"),
        ("joint_pos/LH_HAA", "rear HAA position"),
        ("base_pos_z", "height z"),
    ],
)
def test_a_leg_is_front_or_rear_by_where_it_stands_and_not_by_its_name(
    hind_legged: Robot, channel: str, row: str
) -> None:
    assert row_of(channel, hind_legged) == row


def test_rows_of_the_a1_are_its_pairs_and_joint_groups(robot: Robot) -> None:
    assert row_of("joint_vel/FR_calf", robot) == "front calf velocity"
    assert row_of("joint_pos/RL_hip", robot) == "rear hip position"


def test_a_joint_that_has_none_alike_keeps_its_name(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        """<mujoco model="arm"><worldbody><body name="upper"><joint name="L_shoulder" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></worldbody>
  <actuator><motor joint="L_shoulder"/></actuator></mujoco>"""
    )
    assert row_of("joint_pos/L_shoulder", Robot.load(tmp_path / "arm.xml")) == "L_shoulder position"


def report_on(where: tuple[str, ...], preset: str | None = None, **more: object) -> SimpleNamespace:
    places = tuple(SimpleNamespace(channel=channel) for channel in where)
    known = {"median_log": "log", "headline": SimpleNamespace(preset=preset), "where": places}
    return SimpleNamespace(**(known | more))


@pytest.mark.parametrize("rate_hz", [1000, 500, 100])
def test_curves_have_a_point_every_4_ms_or_every_row(robot: Robot, rate_hz: int) -> None:
    still = standing(robot, rate_hz)
    columns = dict(still.columns) | {"time": np.arange(rate_hz) / rate_hz}
    jump = replace(still, columns=columns, info=replace(still.info, sample_period_s=1 / rate_hz))
    data = channels_data(report_on((), "jump"), [jump], robot, {jump.name: jump}, None)  # type: ignore[arg-type]
    assert np.diff(data["logs"][jump.name]["time"]) == pytest.approx(max(0.004, 1 / rate_hz), abs=1e-9)
    assert data["groups"]["largest errors"] == list(JUMP)


def test_each_channel_has_its_log_its_replays_and_the_noise_of_its_sensor(two_joints: Robot) -> None:
    """A replay that is 1e-3 rad off, beside noise of 2e-4 rad on a swing of 1 rad."""
    rng, log = np.random.default_rng(0), arm_log(2)
    noisy = dict(log.columns) | {"joint_pos/j0": log["joint_pos/j0"] + 2e-4 * rng.standard_normal(len(log))}
    measured = replace(log, columns=noisy)
    off = replace(log, columns=dict(noisy) | {"joint_pos/j0": noisy["joint_pos/j0"] + 1e-3})
    found = report_on(("joint_vel/j1", "joint_pos/j0", "joint_vel/j1"))
    data = channels_data(found, [measured], two_joints, {"log": off}, {"log": measured})  # type: ignore[arg-type]
    assert data["groups"]["largest errors"] == ["joint_vel/j1", "joint_pos/j0"]
    curves = data["logs"]["log"]
    shown = [np.array(of) for of in curves["channels"]["joint_pos/j0"]]
    assert shown[1] - shown[0] == pytest.approx(1e-3, abs=2e-6)  # a difference keeps its digits
    assert np.abs(shown[2] - shown[0]).max() == 0
    assert curves["noise"]["joint_pos/j0"] == pytest.approx(2e-4, rel=0.1)
    assert curves["noise"]["joint_pos/j1"] < 1e-6


def test_tiles_say_the_error_of_the_worst_channel_in_its_unit(two_joints: Robot) -> None:
    log = arm_log(2)
    off = {
        by: replace(log, columns=dict(log.columns) | {"joint_pos/j1": log["joint_pos/j1"] + math.radians(by)})
        for by in (3.0, 0.25)
    }
    closed = Interval(0.9, 0.8, 0.95)
    figures = {"gap_nominal": 0.3, "gap_corrected": 0.02, "noise_floor": 0.01, "landing_misplaced_m": {}}
    found = report_on(("joint_pos/j1",), answer=(("x",),), closure_of_answer=closed, **figures)
    error, share, gap, logs = tiles(found, [log], {"log": off[3.0]}, {"log": off[0.25]})  # type: ignore[arg-type]
    assert (error.nominal, error.corrected, error.unit) == ("3.00", "0.25", "°")
    assert error.says == "j1 position, rms error, corrected on held-out logs"
    assert (share.nominal, share.unit, share.says) == ("90", "%", "of the gap explained (95 %: 80 to 95 %)")
    assert (gap.nominal, gap.corrected) == ("0.30", "0.02")
    assert (logs.nominal, logs.unit, logs.says) == ("1", "logs", "4 s of motion")
    nothing = report_on(("joint_pos/j1",), answer=(), closure_of_answer=None, **figures)
    assert [one.corrected for one in tiles(nothing, [log], {"log": off[3.0]}, {})] == [""] * 3  # type: ignore[arg-type]


def test_a_ratio_is_printed_without_a_unit() -> None:
    scale = ParameterEstimate(0.918, (0.907, 0.928), 1.0, "1", False)
    cause = Cause("torque_gain", "all", 0.72, {"scale": scale}, {}, Interval(0.5, 0.4, 0.6), 0.1, ())
    assert cause_in_words(cause) == "  torque_gain: scale 0.918 (0.907 to 0.928), explains 50 %, probability 0.72"


@pytest.fixture
def two_joints(tmp_path: Path) -> Robot:
    link = '<body name="{0}"><joint name="{0}" axis="0 1 0"/><geom size="0.1" mass="1"/>{1}</body>'
    motors = '<motor joint="j0"/><motor joint="j1"/>'
    path = tmp_path / "two.xml"
    arm = link.format("j0", link.format("j1", ""))
    path.write_text(f"<mujoco><worldbody>{arm}</worldbody><actuator>{motors}</actuator></mujoco>")
    return Robot.load(path)


def arm_log(joints: int) -> Log:
    time = np.arange(4000) / 1000
    quantities = ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    names = [f"{quantity}/j{i}" for quantity in quantities for i in range(joints)]
    return Log("log", {"time": time, **{name: np.sin(time) for name in names}}, LogInfo("arm", 0.001, "a test"))


def test_only_the_place_that_was_selected_is_blue() -> None:
    """The same effect at another place is a rival, and grey."""

    def cause(effect: str, location: str, closes: float) -> Cause:
        return Cause(effect, location, 0.5, {}, {}, Interval(closes, closes, closes), 1.0, ())

    found = [cause("joint_damping", "RR_calf", 0.9), cause("joint_damping", "rear", 0.6), cause("payload", "all", 0.7)]
    report = SimpleNamespace(causes=tuple(found), answer=(("joint_damping",),))
    (bars,) = closures(report).data  # type: ignore[arg-type]
    blue = [label for label, colour in zip(bars.y, bars.marker.color, strict=True) if colour == CORRECTED]
    assert blue == ["viscous friction (RR_calf)"]
    nothing = SimpleNamespace(causes=tuple(found), answer=())
    assert CORRECTED not in closures(nothing).data[0].marker.color  # type: ignore[arg-type]


def test_of_left_and_right_that_logs_do_not_separate_the_page_lists_one() -> None:
    left, right = (Place("trot", f"joint_pos/{side}_calf", 0.2, 0.1, "rad") for side in ("FL", "FR"))
    pair = [replace(left, as_one_with=right.channel), replace(right, as_one_with=left.channel)]
    later = replace(pair[1], phase="stand")
    assert loudest([*pair, later]) == [pair[0], later]
    assert loudest([left, right]) == [left, right]


@pytest.mark.parametrize("module", ["api", "cli", "reports.diagnosis"])
def test_pages_import_plotly_and_jinja_only_when_one_is_written(module: str) -> None:
    code = f"import sys, leapgap.{module}; print([m for m in ('plotly', 'jinja2', 'rerun') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_an_unknown_answer_prints_where_its_errors_lie() -> None:
    places = [Place(f"part_{k}", "joint_vel/elbow", 0.4 / k, 0.1, "rad/s") for k in range(1, 7)]
    (line,) = largest_errors(places)
    assert line.startswith("largest errors: elbow velocity, part_1 40 %; elbow velocity, part_2 20 %; ")
    assert "part_4" in line and "part_5" not in line
    assert largest_errors([]) == []


def test_the_heading_of_the_page_has_no_names_of_code() -> None:
    found = sentence_words(
        "command latency (command_delay at RR: delay_s 0.0097 s), which cannot be separated from link_mass, and a "
        "centre of mass (com_offset: x_m -0.01 m, z_m 0.02 m) explain 92 % (95 %: 82 to 100) of the gap"
    )
    assert found == (
        "command latency (at RR: delay 0.0097 s), which cannot be separated from link mass error, and a "
        "centre of mass (x -0.01 m, z 0.02 m) explain 92 % (95 %: 82 to 100) of the gap"
    )


def test_the_next_experiment_is_told_without_names_of_code() -> None:
    said = "There joint_damping and velocity_gain differ by 4.5 times the noise in joint_vel/knee; today by 0.19."
    expected = [{"rival": "velocity_gain", "channel": "joint_vel/knee"}]
    content = SimpleNamespace(next_experiment={"sentence": said, "expected": expected})
    assert next_words(content) == (  # type: ignore[arg-type]
        "There viscous friction and velocity gain (kd) of the joint PD differ by 4.5 times the noise in knee velocity; "
        "today by 0.19."
    )
    numbers = [{"number": "leg_geometry.lower_m", "spread": 0.1, "spread_today": 0.2}]
    unsure = {"sentence": "The least sure number is lower_m of leg_geometry, 1 m: …", "expected": numbers}
    found = next_words(SimpleNamespace(next_experiment=unsure))  # type: ignore[arg-type]
    assert found == "The least sure number is lower of leg geometry error, 1 m: …"
