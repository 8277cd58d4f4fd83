"""The page of a diagnosis: what its map calls the legs of a robot, and how its curves are drawn."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from leapgap.diagnosis.closure import Interval
from leapgap.diagnosis.localisation import Place
from leapgap.diagnosis.report import Cause, ParameterEstimate, Profile
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.segments import Segment
from leapgap.reports.channel_names import row_of
from leapgap.reports.colours import CORRECTED
from leapgap.reports.diagnosis import cause_in_words, largest_errors
from leapgap.reports.diagnosis_figures import closures, profiles
from leapgap.reports.overlay import overlay, rounded
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


@pytest.mark.parametrize("rate_hz", [1000, 500, 100])
def test_curves_have_a_point_every_4_ms_or_every_row(robot: Robot, rate_hz: int) -> None:
    still = standing(robot, rate_hz)
    columns = dict(still.columns) | {"time": np.arange(rate_hz) / rate_hz}
    jump = replace(still, columns=columns, info=replace(still.info, sample_period_s=1 / rate_hz))
    report = SimpleNamespace(median_log=jump.name, answer=(), headline=SimpleNamespace(preset="jump"))
    figure = overlay(report, [jump], {jump.name: jump}, {})  # type: ignore[arg-type]
    assert all(np.diff(curve.x) == pytest.approx(max(0.004, 1 / rate_hz), abs=1e-9) for curve in figure.data)


@pytest.mark.parametrize("channels", [1, 3, 4, 6])
def test_list_and_legend_stand_above_the_titles_however_many_rows_there_are(tmp_path: Path, channels: int) -> None:
    """A share of the plot's height is another distance in pixels at each height; a title takes some 25."""
    log = arm_log(channels)
    where = tuple(SimpleNamespace(channel=f"joint_pos/j{i}") for i in range(channels))
    report = SimpleNamespace(median_log="log", answer=(), headline=SimpleNamespace(preset=None), where=where)
    layout = overlay(report, [log], {"log": log}, {}).layout  # type: ignore[arg-type]
    plotted = layout.height - layout.margin.t - layout.margin.b
    for above in (layout.legend.y, layout.updatemenus[0].y):
        assert 70 < (above - 1) * plotted < layout.margin.t


def test_the_lines_of_the_log_that_is_chosen_are_where_its_own_segments_begin() -> None:
    """Of three logs the second is shown first; the last states no segments."""
    jumps = []
    for name, begin_s in (("early", 0.1), ("late", 0.3), ("none", None)):
        log = replace(arm_log(2), name=name)
        segments = () if begin_s is None else (Segment("stand", 0.0, begin_s), Segment("jump", begin_s, math.inf))
        jumps.append(replace(log, info=replace(log.info, stated_segments=segments)))
    where = tuple(SimpleNamespace(channel=f"joint_pos/j{i}") for i in range(2))
    report = SimpleNamespace(median_log="late", answer=(), headline=SimpleNamespace(preset=None), where=where)
    figure = overlay(report, jumps, {log.name: log for log in jumps}, {})  # type: ignore[arg-type]
    (menu,) = figure.layout.updatemenus
    lines = {one.label: [(line["xref"], line["x0"]) for line in one.args[1]["shapes"]] for one in menu.buttons}
    assert lines == {"early": [("x", 0.1), ("x2", 0.1)], "late": [("x", 0.3), ("x2", 0.3)], "none": []}
    assert [(line.xref, line.x0) for line in figure.layout.shapes] == lines["late"]
    assert {curve.xaxis for curve in figure.data} == {"x", "x2"}


def test_small_motions_keep_their_digits() -> None:
    assert rounded(np.array([0.000123456, -0.0000002])).tolist() == [0.0001235, -0.0000002]
    assert rounded(np.array([12.345678, 0.0])).tolist() == [12.3457, 0.0]
    assert rounded(np.zeros(2)).tolist() == [0.0, 0.0]


def test_a_ratio_is_printed_and_drawn_without_a_unit() -> None:
    scale = ParameterEstimate(0.918, (0.907, 0.928), 1.0, "1", False)
    cause = Cause("torque_gain", "all", 0.72, {"scale": scale}, {}, Interval(0.5, 0.4, 0.6), 0.1, ())
    assert cause_in_words(cause) == "  torque_gain: scale 0.918 (0.907 to 0.928), closes 50 %, probability 0.72"
    shown = SimpleNamespace(profiles=[Profile("torque_gain", "scale (1)", (0.8, 0.9, 1.0), (2.0, 0.0, 2.0))])
    assert profiles(shown).layout.xaxis.title.text == "scale"  # type: ignore[arg-type]


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
    assert blue == ["joint_damping (RR_calf)"]
    nothing = SimpleNamespace(causes=tuple(found), answer=())
    assert CORRECTED not in closures(nothing).data[0].marker.color  # type: ignore[arg-type]


@pytest.mark.parametrize("module", ["report", "page"])
def test_pages_import_plotly_and_jinja_only_when_one_is_written(module: str) -> None:
    code = (
        f"import sys, leapgap.reports.{module}; print([m for m in ('plotly', 'jinja2', 'rerun') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_an_unknown_answer_prints_where_its_errors_lie() -> None:
    places = [Place(f"part_{k}", "joint_vel/elbow", 0.4 / k, 0.1, "rad/s") for k in range(1, 7)]
    (line,) = largest_errors(places)
    assert line.startswith("errors lie in: elbow velocity, part_1 40 %; elbow velocity, part_2 20 %; ")
    assert "part_4" in line and "part_5" not in line
    assert largest_errors([]) == []
