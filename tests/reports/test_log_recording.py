from dataclasses import replace

import mujoco
import numpy as np
import pytest
import rerun as rr

from leapgap.errors import InputError
from leapgap.jumping.task import planned_segments, schedule_of
from leapgap.logs.log import read_log, write_log
from leapgap.reports.log_recording import record_jump
from leapgap.reports.shown_robot import recording, rows_at_period
from leapgap.robot.model import Robot
from tests.reports.conftest import CROUCH, make_hop
from tests.reports.read_back import Recorded

AT_S = 0.35
ARM = """<mujoco model="arm"><worldbody><body name="upper"><joint name="a_shoulder" axis="0 1 0"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="1"/>
<body name="lower" pos="0.3 0 0"><joint name="a_elbow" axis="0 1 0"/>
<geom type="ellipsoid" size="0.1 0.02 0.03" mass="1"/></body></body></worldbody>
<actuator><motor joint="a_shoulder"/><motor joint="a_elbow"/></actuator></mujoco>"""


@pytest.fixture(scope="module")
def hop_recording(tmp_path_factory, robot, hop, ghost):
    path = tmp_path_factory.mktemp("view") / "hop.rrd"
    record_jump(path, hop, robot, {"nominal simulation": ghost}, title="hop")
    return Recorded(path)


def kinematics(robot, jump, time_s):
    """MuJoCo's own state of a row: qpos written by hand, from the columns."""
    row = round(time_s * 1000)
    data = mujoco.MjData(robot.model)
    data.qpos[:3] = [jump[f"base_pos_{axis}"][row] for axis in "xyz"]
    data.qpos[3:7] = [jump[f"base_quat_{part}"][row] for part in "wxyz"]
    data.qpos[7:] = [jump[f"joint_pos/{joint}"][row] for joint in robot.joints]
    mujoco.mj_kinematics(robot.model, data)
    return data


@pytest.mark.parametrize("body", ["trunk", "FR_hip", "RL_calf"])
@pytest.mark.parametrize("who", ["measured", "nominal_simulation"])
def test_bodies_stand_where_mujoco_puts_them(hop_recording, robot, hop, ghost, body, who):
    data = kinematics(robot, hop if who == "measured" else ghost, AT_S)
    entity = f"/world/{who}/{body}"
    translation = hop_recording.at(entity, "Transform3D:translation", AT_S)[0]
    x, y, z, w = hop_recording.at(entity, "Transform3D:quaternion", AT_S)[0]
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.array([w, x, y, z], dtype=float))
    np.testing.assert_allclose(translation, data.body(body).xpos, atol=1e-6)
    np.testing.assert_allclose(rotation, data.body(body).xmat, atol=1e-6)


def test_capsules_span_what_mujocos_do(hop_recording, robot, hop):
    data = kinematics(robot, hop, AT_S)
    entity = "/world/measured/FL_thigh"
    shape = hop_recording.static[entity]
    x, y, z, w = shape["Capsules3D:quaternions"][0]
    axis = np.empty(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), np.array([w, x, y, z], dtype=float))
    start = np.array(shape["Capsules3D:translations"][0])
    ends = np.array([start, start + shape["Capsules3D:lengths"][0] * axis])
    placed = data.body("FL_thigh").xpos + ends @ data.body("FL_thigh").xmat.reshape(3, 3).T
    geom = data.geom("FL_thigh")
    half = robot.model.geom("FL_thigh").size[1] * geom.xmat.reshape(3, 3)[:, 2]
    np.testing.assert_allclose(placed, [geom.xpos - half, geom.xpos + half], atol=1e-6)


def test_ghosts_are_translucent_and_the_main_robot_is_not(hop_recording):
    for who, opaque in (("measured", True), ("nominal_simulation", False)):
        alpha = hop_recording.static[f"/world/{who}/trunk"]["Boxes3D:colors"][0] & 0xFF
        assert (alpha == 255) is opaque


def test_a_ghost_that_ends_early_vanishes_after_its_last_row(hop_recording, ghost):
    scale = hop_recording.moving["/world/nominal_simulation/trunk"]["Transform3D:scale"]
    shrunk = [(t, s[0][0]) for t, s in zip(*scale, strict=True) if s]
    assert shrunk == [(pytest.approx(ghost.time[-1] + 0.001), pytest.approx(0, abs=1e-4))]
    assert "Transform3D:scale" not in hop_recording.moving["/world/measured/trunk"]


def test_plots_show_the_columns_of_both_robots(hop_recording, hop, ghost):
    seconds, curves = hop_recording.moving["/base/z"]["Scalars:scalars"]
    rows = np.round(seconds * 1000).astype(int)
    assert seconds[-1] == pytest.approx(hop.time[-1])
    assert hop_recording.static["/base/z"]["SeriesLines:names"] == ["measured", "nominal simulation"]
    both = np.array(curves, dtype=float)
    np.testing.assert_allclose(both[:, 0], hop["base_pos_z"][rows], rtol=1e-6)
    has = rows < len(ghost)
    np.testing.assert_allclose(both[has, 1], ghost["base_pos_z"][rows[has]], rtol=1e-6)
    assert np.isnan(both[~has, 1]).all()


def test_residual_is_simulation_minus_measured(hop_recording, hop, ghost):
    row = round(AT_S * 1000)
    expected = ghost["base_pos_x"][row] - hop["base_pos_x"][row]
    assert expected < 0
    assert hop_recording.at("/residual/x", "Scalars:scalars", AT_S)[0] == pytest.approx(expected, rel=1e-5)


def test_torque_is_feed_forward_and_joint_pd(hop_recording, hop):
    row, joint = 550, "RL_calf"  # after the gains changed from 100 to 50
    by_hand = (
        hop[f"cmd_tau/{joint}"][row]
        + 50.0 * (CROUCH[2] - hop[f"joint_pos/{joint}"][row])
        - 2.0 * hop[f"joint_vel/{joint}"][row]
    )
    shown = hop_recording.at(f"/joints/RL/{joint}/torque", "Scalars:scalars", 0.55)[0]
    assert shown == pytest.approx(by_hand, rel=1e-5)


def test_phases_and_gain_change_are_marked(hop_recording):
    seconds, states = hop_recording.moving["/phases/planned"]["StateChange:state"]
    np.testing.assert_allclose(seconds, [0.0, 0.1, 0.15, 0.25])
    assert [state[0] for state in states] == ["double contact", "rear contact", "lift off", "flight"]
    seconds, states = hop_recording.moving["/phases/switch_front"]["StateChange:state"]
    np.testing.assert_allclose(seconds, [0.0, 0.2])
    assert [state[0] for state in states] == ["contact", "air"]
    seconds, texts = hop_recording.moving["/events"]["TextLog:text"]
    assert dict(zip([t[0] for t in texts], seconds, strict=True))["joint gains change"] == pytest.approx(0.5)


def test_forces_are_arrows_at_the_feet_while_they_push(hop_recording, robot, hop):
    entity = "/world/measured/mpc_force"
    vectors = hop_recording.at(entity, "Arrows3D:vectors", 0.05)
    np.testing.assert_allclose(vectors, [[0.005, 0, 0.06], [0.007, 0, 0.08]], atol=1e-6)  # 1 N is 1 mm
    data = kinematics(robot, hop, 0.05)
    rear = (data.geom("RR").xpos + data.geom("RL").xpos) / 2
    np.testing.assert_allclose(hop_recording.at(entity, "Arrows3D:origins", 0.05)[1], rear, atol=1e-6)
    assert len(hop_recording.at(entity, "Arrows3D:vectors", 0.15)) == 1  # rear contact: front feet do not push
    assert len(hop_recording.at(entity, "Arrows3D:vectors", AT_S)) == 0


def names_of_views(recorded):
    (blueprint,) = recorded.reader.blueprints()
    words = set()
    for chunk in recorded.reader.stream(store=blueprint):
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.endswith(":display_name"):
                words |= {value[0] for value in batch.column(name).to_pylist() if value}
    return words


def test_opens_on_a_blueprint_with_its_views(hop_recording):
    views = {"Scene", "z [m]", "Δ z [m], ghost − measured", "FR_calf torque [N·m]"}
    assert views | {"Jump", "Phases planned, contacts measured"} <= names_of_views(hop_recording)


def test_an_arm_is_shown_by_its_joints_and_without_the_words_of_jumps(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    arm = Robot.load(tmp_path / "arm.xml")
    swing = make_hop(arm, without=("base_", "mpc_force"))
    swing = replace(swing, info=replace(swing.info, stated_segments=(), extra={}, terrain=()))
    record_jump(tmp_path / "arm.rrd", swing, arm)
    recorded = Recorded(tmp_path / "arm.rrd")
    names = names_of_views(recorded)
    assert {"Overview", "Joint positions", "a_shoulder position [rad]"} <= names
    assert not {"Jump", "Phases planned, contacts measured", "Segments", "No base state in this log"} & names
    notes = recorded.static["/notes"]["TextDocument:text"][0]
    assert "World frame x forward, y left, z up." in notes and "nose" not in notes and "Contact" not in notes


def test_a_log_without_base_is_shown_at_rest_and_says_so(tmp_path, robot, base_columns):
    path = tmp_path / "legs.rrd"
    record_jump(path, make_hop(robot, without=base_columns), robot)
    hop_recording = Recorded(path)
    rest = robot.model.key("crouch").qpos[:3]
    shown = hop_recording.at("/world/measured/trunk", "Transform3D:translation", AT_S)
    np.testing.assert_allclose(shown[0], rest, atol=1e-6)
    assert "rest pose: base position; base orientation" in hop_recording.static["/notes"]["TextDocument:text"][0]
    assert "/base/x" not in hop_recording.moving


def test_a_base_whose_position_was_not_logged_stands_on_its_feet_and_has_no_residual(tmp_path, robot, ghost):
    jump = make_hop(robot, without=("base_pos",))
    legs = {
        f"joint_pos/{joint}": np.full(len(jump), CROUCH[i % 3] + 0.2 * (i % 3)) for i, joint in enumerate(robot.joints)
    }
    jump = replace(jump, columns=dict(jump.columns) | legs, info=replace(jump.info, terrain=()))
    record_jump(tmp_path / "legs.rrd", jump, robot, {"nominal simulation": ghost})
    recorded = Recorded(tmp_path / "legs.rrd")
    height = recorded.at("/world/measured/trunk", "Transform3D:translation", 0.1)[0][2]
    columns = dict(jump.columns) | {f"base_pos_{axis}": np.full(len(jump), height * (axis == "z")) for axis in "xyz"}
    data = kinematics(robot, replace(jump, columns=columns), 0.1)
    soles = [data.geom(foot).xpos[2] - robot.model.geom(foot).size[0] for foot in robot.feet]
    assert min(soles) == pytest.approx(0.0, abs=0.012), "soft ground, torques that press hard"
    assert "where the feet that stand say" in recorded.static["/notes"]["TextDocument:text"][0]
    assert "z [m]" in names_of_views(recorded) and "Δ z [m], ghost − measured" not in names_of_views(recorded)


def test_a_fixed_base_robot_is_shown(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    arm = Robot.load(tmp_path / "arm.xml")
    jump = make_hop(arm, without=("base_", "mpc_force"))
    record_jump(tmp_path / "arm.rrd", jump, arm)
    hop_recording = Recorded(tmp_path / "arm.rrd")
    angle = jump["joint_pos/a_shoulder"][350]
    elbow = hop_recording.at("/world/measured/lower", "Transform3D:translation", AT_S)[0]
    floor = hop_recording.static["/world/floor"]
    (centre,), (half,) = floor["Boxes3D:centers"], floor["Boxes3D:half_sizes"]
    positions = hop_recording.moving["/world/measured/lower"]["Transform3D:translation"][1]
    assert centre[2] + half[2] < min(row[0][2] for row in positions) - 0.1, "the floor lies below an arm that hangs"
    np.testing.assert_allclose(elbow, [0.3 * np.cos(angle), 0, -0.3 * np.sin(angle)], atol=1e-6)
    assert "rest pose" not in hop_recording.static["/notes"]["TextDocument:text"][0]


def test_a_log_of_another_robot_is_refused(tmp_path, hop):
    (tmp_path / "arm.xml").write_text(ARM)
    with pytest.raises(InputError, match="expected joints of arm: a_shoulder, a_elbow"):
        record_jump(tmp_path / "x.rrd", hop, Robot.load(tmp_path / "arm.xml"))


def test_nothing_half_written_remains_when_a_write_fails(tmp_path, robot, hop, monkeypatch):
    def fail(*_):
        raise OSError("disk full")

    record_jump(tmp_path / "hop.rrd", hop, robot)
    before = (tmp_path / "hop.rrd").read_bytes()
    monkeypatch.setattr("leapgap.reports.log_recording.log_notes", fail)  # the last step: most is written by then
    with pytest.raises(OSError, match="disk full"):
        record_jump(tmp_path / "hop.rrd", hop, robot)
    assert [path.name for path in tmp_path.iterdir()] == ["hop.rrd"]
    assert (tmp_path / "hop.rrd").read_bytes() == before


def test_rows_are_thinned_by_time_and_keep_both_ends():
    np.testing.assert_array_equal(rows_at_period(np.arange(12) / 1000, 0.005), [0, 5, 10, 11])
    np.testing.assert_array_equal(rows_at_period(np.array([0.0, 0.02, 0.04]), 0.005), [0, 1, 2])


def test_recordings_do_not_share_a_blueprint(tmp_path):
    names = []
    for title in ("a", "b"):
        with recording(tmp_path / f"{title}.rrd", title, rr.blueprint.Blueprint()) as to:
            to.static("x", rr.TextDocument("x"))
        (store,) = Recorded(tmp_path / f"{title}.rrd").reader.recordings()
        names.append(store.application_id)
    assert names[0] != names[1]


def test_joint_residual_is_ghost_minus_measured(tmp_path, robot, hop):
    joint = "FL_thigh"
    bent = replace(hop, columns=dict(hop.columns) | {f"joint_pos/{joint}": hop[f"joint_pos/{joint}"] + 0.07})
    record_jump(tmp_path / "hop.rrd", hop, robot, {"nominal simulation": bent})
    shown = Recorded(tmp_path / "hop.rrd").at(f"/joints/FL/{joint}/residual", "Scalars:scalars", AT_S)
    assert shown[0] == pytest.approx(0.07, abs=1e-6)


def test_torque_stands_between_the_limits_of_the_motor(tmp_path, robot, hop):
    """|R τ + q̇| ≤ voltage, and the model's own limit; 10 V bind at this speed, and the limits lean with it."""
    joint, row = "RL_calf", 550
    fast = np.full(len(hop), 6.0)
    columns = dict(hop.columns) | {f"joint_vel/{joint}": fast, "supply_voltage": np.full(len(hop), 10.0)}
    record_jump(tmp_path / "hop.rrd", replace(hop, columns=columns), robot)
    found = Recorded(tmp_path / "hop.rrd")
    entity = f"/joints/RL/{joint}/torque"
    names = found.static[entity]["SeriesLines:names"]
    high, low = found.at(entity, "Scalars:scalars", row / 1000)[
        [names.index(f"{end} limit of the motor") for end in ("upper", "lower")]
    ]
    resistance = float(robot.model.numeric("motor_resistance").data[0])
    own = abs(robot.model.actuator(joint).forcerange).max() if robot.model.actuator(joint).forcelimited else np.inf
    assert high == pytest.approx(min((10.0 - 6.0) / resistance, own), rel=1e-5)
    assert low == pytest.approx(max((-10.0 - 6.0) / resistance, -own), rel=1e-5)
    assert high < -low


def test_planned_contacts_stand_beside_the_measured_ones(hop_recording):
    """The front feet are planned to lift at 0.1 s, and the rear ones at 0.2, in the middle of ``lift_off``."""
    for pair, planned in (
        ("front", ["contact", "air", "air", "air", "air"]),
        ("rear", ["contact", "contact", "contact", "air", "air"]),
    ):
        seconds, states = hop_recording.moving[f"/phases/plan_{pair}"]["StateChange:state"]
        np.testing.assert_allclose(seconds, [0.0, 0.1, 0.15, 0.2, 0.25])
        assert [state[0] for state in states] == planned
        assert f"/phases/switch_{pair}" in hop_recording.moving


def test_planned_phases_of_a_jump_that_begins_later_are_shown_from_its_begin(tmp_path, robot, hop):
    """The robot stands for 0.3 s before the jump with the schedule of the log: 0.1 s on all feet, 0.1 s on the rear."""
    segments = planned_segments(schedule_of(hop), [0.3], 0.6)
    write_log(replace(hop, info=replace(hop.info, stated_segments=segments)), tmp_path / "hop.parquet")
    record_jump(tmp_path / "hop.rrd", read_log(tmp_path / "hop.parquet"), robot)
    moving = Recorded(tmp_path / "hop.rrd").moving
    seconds, states = moving["/phases/planned"]["StateChange:state"]
    np.testing.assert_allclose(seconds, [0.0, 0.3, 0.4, 0.45, 0.55])
    assert [state[0] for state in states] == ["stand", "double contact", "rear contact", "lift off", "flight"]
    seconds, states = moving["/phases/plan_front"]["StateChange:state"]
    assert seconds[[state[0] for state in states].index("air")] == pytest.approx(0.4)
    seconds, texts = moving["/events"]["TextLog:text"]
    assert dict(zip([t[0] for t in texts], seconds, strict=True))["double contact begins"] == pytest.approx(0.3)
    seconds, arrows = moving["/world/measured/mpc_force"]["Arrows3D:vectors"]
    pushing = {round(at, 3): len(of or []) for at, of in zip(seconds, arrows, strict=True)}
    assert (pushing[0.35], pushing[0.42], pushing[0.58]) == (2, 1, 0)


def test_friction_cone_stands_under_a_pair_while_it_pushes(hop_recording, robot, hop):
    entity = "/world/measured/friction_cone"
    cones = hop_recording.at(entity, "LineStrips3D:strips", 0.05)
    assert len(cones) == 2
    data = kinematics(robot, hop, 0.05)
    tip = (data.geom("FR").xpos + data.geom("FL").xpos) / 2
    cone = np.array(cones[0], dtype=float) - tip
    height = cone[:, 2].max()
    rim = cone[np.isclose(cone[:, 2], height)]
    friction = max(robot.model.geom("FR").friction[0], robot.model.geom("floor").friction[0])
    np.testing.assert_allclose(np.hypot(rim[:, 0], rim[:, 1]), friction * height, rtol=1e-4)
    assert len(hop_recording.at(entity, "LineStrips3D:strips", 0.15)) == 1
    assert len(hop_recording.at(entity, "LineStrips3D:strips", AT_S)) == 0
    ratio = hop_recording.at("/forces/ratio_front", "Scalars:scalars", 0.05)
    assert ratio[0] == pytest.approx(5.0 / 60.0, rel=1e-5) and ratio[-1] == pytest.approx(friction, rel=1e-5)
