"""Late commands and filtered joint PDs against a disc that plain MuJoCo steps with a controller written out here."""

import itertools
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts

DISC = """<mujoco model="disc"><option timestep="0.001" integrator="{integrator}"/><worldbody><body>
  <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/><joint name="j" axis="0 0 1" damping="0.02"/></body>
  </worldbody><actuator><motor joint="j" ctrlrange="-8 8"/></actuator></mujoco>"""
TICKS = np.array([1, 3, 1, 2, 12, 1, 1, 4, 2, 1] * 4)
"""Milliseconds that each row lasts."""
TORQUE, ANGLE, KP, KD = np.sin(np.arange(40.0)) * 3, np.cos(np.arange(40) / 7.0), 60.0, 1.5


def disc(folder: Path, integrator: str = "Euler") -> Robot:
    """The robot of one joint."""
    (folder / "disc.xml").write_text(DISC.format(integrator=integrator))
    return Robot.load(folder / "disc.xml")


def uneven_log(kp: float = KP, kd: float = KD, slower: int = 1) -> Log:
    """Forty rows of unequal length whose commands change in each."""
    time = slower * np.concatenate([[0], np.cumsum(TICKS[:-1])]) / 1000
    columns = {"joint_pos/j": np.full(40, 0.3), "joint_vel/j": np.zeros(40), "cmd_tau/j": TORQUE, "cmd_pos/j": ANGLE}
    columns |= {"cmd_vel/j": 0 * TORQUE, "cmd_kp/j": np.full(40, kp), "cmd_kd/j": np.full(40, kd)}
    return Log("uneven", {"time": time} | columns, LogInfo("disc", float(time[-1] / 39), source="made for a test"))


def plain(
    robot: Robot,
    row_of_tick: np.ndarray,
    keep: float = 0.0,
    kp: float = KP,
    kd: float = KD,
    sent: tuple[np.ndarray, np.ndarray] = (TORQUE, ANGLE),
) -> np.ndarray:
    """Angle at the beginning of each row: a controller of 1 kHz that holds commands of ``row_of_tick`` (ticks,).

    It damps the velocity v_f = ``keep`` v_f + (1 − ``keep``) q̇. ``sent`` are torque and angle of each row, (rows,).
    """
    model = mujoco.MjModel.from_xml_path(str(robot.path))
    data = mujoco.MjData(model)
    data.qpos[0], filtered, angles = 0.3, 0.0, []
    for row in row_of_tick:
        angles.append(data.qpos[0])
        filtered = keep * filtered + (1 - keep) * data.qvel[0]
        data.ctrl[0] = np.clip(sent[0][row] + kp * (sent[1][row] - data.qpos[0]) - kd * filtered, -8, 8)
        mujoco.mj_step(model, data)
    return np.array(angles)[len(row_of_tick) // TICKS.sum() * np.concatenate([[0], np.cumsum(TICKS[:-1])])]


def replay(robot: Robot, *found: effects.Effect, **of_log: float) -> np.ndarray:
    """Angle in each row by the replay."""
    (motion,) = Replayer(robot).motions([Rollout(uneven_log(**of_log), found)])
    return motion.qpos[:, 0]


SENT = np.repeat(np.arange(40), TICKS)
"""Row whose command is sent in each millisecond."""


def test_rows_hold_their_commands_for_as_long_as_they_last(tmp_path: Path) -> None:
    robot = disc(tmp_path)
    assert replay(robot) == pytest.approx(plain(robot, SENT), abs=1e-12)


def test_a_delay_of_commands_is_a_time_whatever_the_rows_last(tmp_path: Path) -> None:
    robot = disc(tmp_path)
    late = np.concatenate([[0] * 5, SENT[:-5]])
    found = replay(robot, effects.effect("command_delay", delay_s=0.005))
    assert found == pytest.approx(plain(robot, late), abs=1e-9)
    assert np.abs(found - plain(robot, SENT)).max() > 0.02


def test_a_process_that_computes_before_it_sends_is_late_by_a_share_of_each_row(tmp_path: Path) -> None:
    robot = disc(tmp_path)
    whole = np.maximum(SENT - 1, 0)  # commands of the row before
    assert replay(robot, effects.effect("computation_delay", share=1.0)) == pytest.approx(plain(robot, whole), abs=1e-9)
    # Rows of twice the length, each of which holds the former command for its first half.
    halves = np.concatenate([[max(row - 1, 0)] * n + [row] * n for row, n in enumerate(TICKS)])
    found = replay(robot, effects.effect("computation_delay", share=0.5), slower=2)
    assert found == pytest.approx(plain(robot, halves), abs=1e-9)
    assert np.abs(found - plain(robot, np.repeat(whole, 2))).max() > 0.02


def mean_over_losses(sent: np.ndarray, share: float) -> np.ndarray:
    """Mean of what holds in each row, (rows,), where each command but the first is lost by chance."""
    holds = [float(sent[0])]
    for command in sent[1:]:
        holds.append(share * holds[-1] + (1 - share) * float(command))
    return np.array(holds)


SHARE = 0.6


def test_a_command_is_lost_once_however_long_its_row_lasts(tmp_path: Path) -> None:
    robot = disc(tmp_path)
    lossy = effects.effect("dropped_commands", share=SHARE)
    held = (mean_over_losses(TORQUE, SHARE), mean_over_losses(ANGLE, SHARE))
    found = replay(robot, lossy)
    assert found == pytest.approx(plain(robot, SENT, sent=held), abs=1e-9)
    assert np.abs(found - plain(robot, SENT)).max() > 0.02


@pytest.mark.parametrize("order", [1, -1])
def test_what_is_left_of_lost_commands_comes_late_in_either_order(order: int, tmp_path: Path) -> None:
    robot = disc(tmp_path)
    both = (effects.effect("dropped_commands", share=SHARE), effects.effect("command_delay", delay_s=0.005))
    held = (mean_over_losses(TORQUE, SHARE), mean_over_losses(ANGLE, SHARE))
    late = np.concatenate([[0] * 5, SENT[:-5]])
    assert replay(robot, *both[::order]) == pytest.approx(plain(robot, late, sent=held), abs=1e-9)


@pytest.mark.parametrize("share", [0.5, 1.5])
@pytest.mark.parametrize("order", itertools.permutations(range(3)))
def test_lost_commands_that_are_computed_late_and_arrive_late_do_so_in_any_order(
    order: tuple[int, ...], share: float, tmp_path: Path
) -> None:
    """Rows of twice the length: a command is sent half a row late, of its own or the next row, and travels for 5 ms."""
    robot, rows_late = disc(tmp_path), round(share + 0.5)
    halves = [[row - rows_late] * n + [row - rows_late + 1] * n for row, n in enumerate(TICKS)]
    arrived = np.concatenate([[0] * 5, np.maximum(np.concatenate(halves), 0)[:-5]])
    kinds = (
        effects.effect("dropped_commands", share=SHARE),
        effects.effect("computation_delay", share=share),
        effects.effect("command_delay", delay_s=0.005),
    )
    held = (mean_over_losses(TORQUE, SHARE), mean_over_losses(ANGLE, SHARE))
    found = replay(robot, *(kinds[i] for i in order), slower=2)
    assert found == pytest.approx(plain(robot, arrived, sent=held), abs=1e-9)
    assert np.abs(found - replay(robot, *kinds[:2], slower=2)).max() > 5e-3


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
@pytest.mark.parametrize("keep", [0.35, 0.8])
def test_a_joint_pd_with_a_filtered_velocity_is_that_of_a_drive(tmp_path: Path, integrator: str, keep: float) -> None:
    """Also where the torque meets its limit, and in a model whose own joint PD would be implicit."""
    robot = disc(tmp_path, integrator)
    found = replay(robot, effects.effect("velocity_filter", time_constant_s=-0.001 / np.log(keep)))
    assert found == pytest.approx(plain(robot, SENT, keep), abs=1e-9)
    assert np.abs(found - replay(robot)).max() > 1e-4


def test_the_limit_holds_for_the_sum_of_a_filtered_damper_and_the_rest(tmp_path: Path) -> None:
    robot = disc(tmp_path)
    strong = {"kp": 400.0, "kd": 6.0}
    found = replay(robot, effects.effect("velocity_filter", time_constant_s=-0.001 / np.log(0.35)), **strong)
    assert found == pytest.approx(plain(robot, SENT, 0.35, **strong), abs=1e-9)


def test_a_log_without_pieces_is_passed_over(tmp_path: Path) -> None:
    robot = disc(tmp_path)
    late = effects.effect("computation_delay", share=0.5)
    none, two = Starts([], np.zeros((0, 2))), Starts([0, 3], np.tile([0.3, 0.0], (2, 1)))
    found = Replayer(robot).replay_pieces([Rollout(uneven_log(), (late,))] * 2, [none, two], 5)
    assert [len(pieces) for pieces in found] == [0, 2]
