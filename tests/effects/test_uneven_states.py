"""A base state that is reported late in logs of uneven rows, against a tumbling body that plain MuJoCo steps here."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.short_rollouts import smooth_starts
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts

BODY = """<mujoco model="body"><option timestep="0.001" integrator="Euler"/><worldbody><body pos="0 0 3"><freejoint/>
  <inertial pos="0 0 0" mass="4" diaginertia="0.05 0.06 0.07"/><body><joint name="j" axis="0.6 0.8 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.02 0.02 0.02"/></body></body></worldbody>
  <actuator><motor joint="j" ctrlrange="-8 8"/></actuator></mujoco>"""
TICKS = np.array([1, 3, 1, 2, 12, 1, 1, 4, 2, 1] * 4)
"""Milliseconds that each row lasts."""
AT = np.concatenate([[0], np.cumsum(TICKS[:-1])])
"""Millisecond at which each row begins."""
TORQUE = 1.5 + np.sin(np.arange(40.0))
VELOCITY = np.array([1.0, 0.3, 2.0])
LATE = 5
"""Milliseconds by which the base is reported late."""
CHORD = 4e-4
"""Largest error of straight lines between rows 12 ms apart: g h² / 8 is 0.18 mm."""


def body(folder: Path) -> Robot:
    """A body with a flywheel, in free fall."""
    (folder / "body.xml").write_text(BODY)
    return Robot.load(folder / "body.xml")


def uneven_log() -> Log:
    """Forty rows of unequal length, each with another torque; of the measured motion only the first row matters."""
    still = dict.fromkeys(("base_pos_x", "base_pos_y", "base_quat_x", "base_quat_y", "base_quat_z"), np.zeros(40))
    still |= {f"base_angvel_{axis}": np.zeros(40) for axis in "xyz"} | {"base_pos_z": np.full(40, 3.0)}
    moves = {f"base_linvel_{axis}": np.full(40, value) for axis, value in zip("xyz", VELOCITY, strict=True)}
    quantities = ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    columns = still | moves | {f"{name}/j": np.zeros(40) for name in quantities}
    columns |= {"time": AT / 1000, "base_quat_w": np.ones(40), "cmd_tau/j": TORQUE}
    return Log("uneven", columns, LogInfo("body", AT[-1] / 39 / 1000, source="made for a test"))


def plain(robot: Robot, state: np.ndarray, first: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses (rows, 7) and velocities (rows, 6) of the base ``LATE`` ms before some rows; the state does not turn yet.

    Before the first of them the base has moved with its first velocity.
    """
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = np.split(state, [model.nq])
    poses = [np.concatenate([state[:3] + state[model.nq :][:3] * ms / 1000, state[3:7]]) for ms in range(-LATE, 0)]
    velocities = [state[model.nq :][:6]] * LATE
    for row in np.repeat(np.arange(40), TICKS)[AT[first] :]:
        poses.append(data.qpos[:7].copy())
        velocities.append(data.qvel[:6].copy())
        data.ctrl[0] = TORQUE[row]
        mujoco.mj_step(model, data)
    at = AT[first : first + rows] - AT[first]
    return np.array(poses)[at], np.array(velocities)[at]


def test_a_late_base_state_is_late_by_a_time_whatever_the_rows_last(tmp_path: Path) -> None:
    robot, late = body(tmp_path), effects.effect("state_latency", delay_s=LATE / 1000)
    state = np.concatenate([[0, 0, 3, 1, 0, 0, 0, 0], VELOCITY, np.zeros(4)])
    (motion,) = Replayer(robot).motions([Rollout(uneven_log(), (late,), first_state=state)])
    poses, velocities = plain(robot, state, 0, 40)
    assert motion.qpos[:, :7] == pytest.approx(poses, abs=CHORD)
    assert motion.qvel[:, :3] == pytest.approx(velocities[:, :3], abs=1e-9)  # gravity changes it evenly
    assert np.abs(np.diff(poses[:, 3:7], axis=0)).max() > 10 * CHORD


def test_pieces_from_within_an_uneven_log_are_as_late(tmp_path: Path) -> None:
    robot, late = body(tmp_path), effects.effect("state_latency", delay_s=LATE / 1000)
    state = np.concatenate([[0, 0, 3, 1, 0, 0, 0, 0], VELOCITY, np.zeros(4)])
    ((piece,),) = Replayer(robot).replay_pieces([Rollout(uneven_log(), (late,))], [Starts([7], state[None])], 20)
    true = state.copy()
    true[:3] += VELOCITY * LATE / 1000
    poses, velocities = plain(robot, true, 7, 20)
    assert piece.qpos[:, :7] == pytest.approx(poses, abs=CHORD)
    assert piece.qvel[:, :3] == pytest.approx(velocities[:, :3], abs=1e-9)


def fallen(late_s: float) -> Log:
    """An even log of the body in free fall from rest, whose base is reported late; made without a simulation."""
    time = np.arange(120) / 1000
    true_s = np.maximum(time - late_s, 0.0)  # at rest before the first row
    zero = np.zeros(120)
    columns = dict.fromkeys(("base_pos_x", "base_pos_y", "base_quat_x", "base_quat_y", "base_quat_z"), zero)
    columns |= {f"base_angvel_{axis}": zero for axis in "xyz"} | {f"base_linvel_{axis}": zero for axis in "xy"}
    columns |= {"time": time, "base_quat_w": np.ones(120), "base_pos_z": 3.0 - 9.81 * true_s**2 / 2}
    columns |= {"base_linvel_z": -9.81 * true_s, "cmd_tau/j": zero}
    columns |= {f"{name}/j": zero for name in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
    return Log("fallen", columns, LogInfo("body", 0.001, source="made for a test"))


def test_a_piece_starts_where_the_late_log_says_later_that_it_was(tmp_path: Path) -> None:
    """A body that accelerates: with its reported velocity alone it would start too slow by g times the delay."""
    robot, late_s, begin, rows = body(tmp_path), 0.0125, 50, 30
    log = fallen(late_s)
    starts, _ = smooth_starts(motion_of(log, robot), [begin], log, robot)
    trial = Rollout(log, (effects.effect("state_latency", delay_s=late_s),))
    for some, error in ((starts, 1e-3), (Starts(starts.rows, starts.states), 9.81 * late_s)):
        ((piece,),) = Replayer(robot).replay_pieces([trial], [some], rows)
        off = piece.qvel[15:, 2] - log["base_linvel_z"][begin + 15 : begin + rows]  # the start is known by then
        assert np.abs(off).max() == pytest.approx(error, abs=2e-3)


def test_a_log_without_a_piece_has_no_later_states(tmp_path: Path) -> None:
    robot, log = body(tmp_path), fallen(0.01)
    starts, _ = smooth_starts(motion_of(log, robot), [], log, robot)
    later = starts.later(10.0)
    assert later is not None and later.shape == starts.states.shape


def test_a_piece_of_every_second_row_starts_at_the_same_state(tmp_path: Path) -> None:
    robot, log = body(tmp_path), fallen(0.01)
    starts, _ = smooth_starts(motion_of(log, robot), [40, 50, 60], log, robot)
    some = starts.every(2).chosen([1, 2])
    later, expected = some.later(5.0), starts.later(10.0)
    assert list(some.rows) == [25, 30]
    assert later is not None and expected is not None
    assert later == pytest.approx(expected[1:])
