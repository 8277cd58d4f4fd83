"""Columns of a log against MuJoCo's own layout of positions and velocities."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.logs.state import States, columns_of, commanded_torque, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from tests.conftest import standing


def wild_log(robot: Robot, rows: int = 20) -> Log:
    """A log with a different number in every measured column."""
    rng = np.random.default_rng(5)
    log = standing(robot, rows)
    changed = {
        name: rng.normal(size=rows)
        for name in log.columns
        if name.startswith(("base_pos", "base_linvel", "base_angvel", "joint_", "cmd_"))
    }
    turn = rng.normal(size=(rows, 4))
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return replace(log, columns=dict(log.columns) | changed | dict(zip(BASE_QUATERNION, turn.T, strict=True)))


def test_every_column_stands_where_mujoco_reads_it(robot: Robot) -> None:
    """MuJoCo's own sensors of the frame and the joints read back what the columns say."""
    spec = mujoco.MjSpec.from_file(str(robot.path))
    trunk = spec.bodies[1].name
    for kind in ("FRAMEPOS", "FRAMEQUAT", "FRAMELINVEL", "FRAMEANGVEL"):
        spec.add_sensor(
            name=kind,
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=trunk,
        )
    for joint in robot.joints:
        for kind in ("JOINTPOS", "JOINTVEL"):
            spec.add_sensor(
                name=f"{kind}/{joint}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint,
            )
    model = spec.compile()
    data, log = mujoco.MjData(model), wild_log(robot)
    for row, (qpos, qvel) in enumerate(motion_of(log, robot)):
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        read = {name: np.array(data.sensor(name).data) for name in ("FRAMEPOS", "FRAMEQUAT", "FRAMELINVEL")}
        assert read["FRAMEPOS"] == pytest.approx(log.stack(BASE_POSITION)[row])
        assert abs(read["FRAMEQUAT"] @ log.stack(BASE_QUATERNION)[row]) == pytest.approx(1)
        assert read["FRAMELINVEL"] == pytest.approx(log.stack(BASE_VELOCITY)[row])
        in_world = np.empty(3)
        mujoco.mju_rotVecQuat(in_world, log.stack(BASE_ANGULAR_VELOCITY)[row], log.stack(BASE_QUATERNION)[row])
        assert data.sensor("FRAMEANGVEL").data == pytest.approx(in_world)
        for joint in robot.joints:
            assert data.sensor(f"JOINTPOS/{joint}").data[0] == log[f"joint_pos/{joint}"][row]
            assert data.sensor(f"JOINTVEL/{joint}").data[0] == log[f"joint_vel/{joint}"][row]


def test_a_motion_becomes_the_columns_it_came_from(robot: Robot) -> None:
    log = wild_log(robot)
    columns = columns_of(motion_of(log, robot), robot)
    assert set(columns) == {n for n in log.columns if n.startswith(("base_", "joint_"))}
    for name, values in columns.items():
        assert np.array_equal(values, log[name])


def test_a_part_of_a_log_is_the_part_of_its_motion(robot: Robot) -> None:
    log = wild_log(robot)
    whole, part = motion_of(log, robot), motion_of(log, robot, slice(3, 17, 5))
    assert np.array_equal(part.qpos, whole.qpos[3:17:5])
    assert np.array_equal(part.qvel, whole.qvel[3:17:5])


@pytest.mark.parametrize("missing", [("base_quat",), ("base_quat", "base_pos")])
def test_a_free_base_without_a_logged_attitude_is_refused(robot: Robot, missing: tuple[str, ...]) -> None:
    log = standing(robot, 10)
    without = replace(log, columns={n: v for n, v in log.columns.items() if not n.startswith(missing)})
    with pytest.raises(InputError, match=r"no base_quat_w, .*the attitude of the free base of a1"):
        motion_of(without, robot)


def test_a_base_without_a_logged_position_stands_on_its_feet(robot: Robot) -> None:
    """The model's ground gives way by some millimetres; a logged velocity stays as it is."""
    log = standing(robot, 50)
    bare = replace(log, columns={n: v for n, v in log.columns.items() if not n.startswith(("base_pos", "base_linvel"))})
    found = motion_of(bare, robot)
    assert np.abs(found.base_position[:, 2] - 0.1726).max() < 0.01
    assert np.abs(found.base_velocity).max() < 1e-9
    moved = replace(bare, columns=dict(bare.columns) | {"base_linvel_x": np.full(50, 0.3)})
    assert np.all(motion_of(moved, robot).base_velocity == [0.3, 0.0, 0.0])


def test_velocities_that_were_not_logged_are_the_slope_of_the_positions(robot: Robot) -> None:
    """A single component that is missing beside others is taken as zero."""
    log = wild_log(robot)
    bent = log.time**2
    log = replace(log, columns=dict(log.columns) | {f"joint_pos/{joint}": bent for joint in robot.joints})
    kept = {n: v for n, v in log.columns.items() if not n.startswith(("base_angvel_x", "joint_vel"))}
    motion = motion_of(replace(log, columns=kept), robot)
    assert not motion.base_angular_velocity[:, 0].any()
    assert motion.base_angular_velocity[:, 1].all()
    assert motion.qvel[:, 6:] == pytest.approx(np.tile(2 * log.time[:, None], (1, 12)), abs=1e-9)


def test_fitted_velocities_are_as_unsure_as_the_motion_is_bent(robot: Robot) -> None:
    """Without noise all that a parabola gets wrong of a fast swing is its third derivative."""
    log = wild_log(robot)
    log = replace(log, info=replace(log.info, stated_segments=()))
    swing, rate = 0.5 * np.sin(60 * log.time), 30 * np.cos(60 * log.time)
    columns = dict(log.columns) | {f"joint_pos/{joint}": swing for joint in robot.joints}
    kept = {name: values for name, values in columns.items() if not name.startswith("joint_vel")}
    states = States.of(replace(log, columns=kept), robot)
    off = states.motion.qvel[:, 6] - rate
    assert states.deviation[:, robot.model.nv + 6].mean() == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.5)


def test_commanded_torque_is_the_law_of_the_contract(robot: Robot) -> None:
    log = wild_log(robot)
    for i, joint in enumerate(robot.joints):
        expected = (
            log[f"cmd_tau/{joint}"]
            + log[f"cmd_kp/{joint}"] * (log[f"cmd_pos/{joint}"] - log[f"joint_pos/{joint}"])
            + log[f"cmd_kd/{joint}"] * (log[f"cmd_vel/{joint}"] - log[f"joint_vel/{joint}"])
        )
        assert commanded_torque(log)[:, i] == pytest.approx(expected)
        assert commanded_torque(log, (joint,))[:, 0] == pytest.approx(expected)


def test_rows_of_a_motion_are_a_motion() -> None:
    motion = Motion(np.arange(12.0).reshape(4, 3), np.arange(8.0).reshape(4, 2))
    assert np.array_equal(motion[1:3].qpos, motion.qpos[1:3])
    assert np.array_equal(motion.first_state, [0, 1, 2, 0, 1])
    assert np.array_equal(motion.last_state, [9, 10, 11, 6, 7])
    copied = motion.copy()
    copied.qpos[:] = 0
    assert motion.qpos[0, 1] == 1


TAIL = """<mujoco model="tailed"><worldbody><body>
  <joint name="hip" axis="0 1 0"/><geom size="0.1" mass="1"/>
  <body pos="0 0 -0.3"><joint name="tail" axis="0 1 0" stiffness="3"/><geom size="0.05" mass="0.2"/></body>
</body></worldbody><actuator><motor joint="hip"/></actuator></mujoco>"""


def test_a_passive_joint_that_was_not_logged_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "tailed.xml"
    path.write_text(TAIL)
    robot, rows = Robot.load(path), np.zeros(20)
    columns = {"time": 0.01 * np.arange(20), "joint_pos/hip": rows}
    columns |= {f"cmd_{name}/hip": rows for name in ("tau", "pos", "vel", "kp", "kd")}
    with pytest.raises(InputError) as refused:
        motion_of(Log("swing", columns, LogInfo("tailed", 0.01, "test")), robot)
    assert str(refused.value) == (
        "swing: found no joint_pos of tail, of joints without a motor; expected positions of all 2 joints of tailed: "
        "replays begin where the robot was; log them, or take joints that never move out of the model"
    )


def test_a_base_is_estimated_above_the_floor_of_the_model(robot: Robot, tmp_path: Path) -> None:
    """The floor of the model is 0.4 m high, and so is the base that stands on it, 0.1726 m above."""
    path = tmp_path / "raised.xml"
    path.write_text(robot.path.read_text().replace('<geom name="floor"', '<geom name="floor" pos="0 0 0.4"'))
    log = standing(robot)
    kept = {name: v for name, v in log.columns.items() if not name.startswith(("base_pos", "base_linvel"))}
    raised = Robot.load(path)
    assert raised.ground_height == 0.4
    motion = motion_of(Log(log.name, kept, log.info), raised)
    assert motion.base_position[:, 2] == pytest.approx(0.4 + 0.1726, abs=0.006)
