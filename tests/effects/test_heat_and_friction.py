"""Motors that heat, gears that rub under load and joints that stick, against their laws in plain MuJoCo."""

import mujoco
import numpy as np

from leapgap import effects
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from tests.effects import moving_arm as arm
from tests.effects.moving_arm import SENT, replay


def heated(loss: float, sent: arm.Sent = SENT) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """The arm with a shoulder whose windings heat, and the rise of its resistance at every row, (rows,)."""
    rises: list[float] = []
    return arm.simulate(sent, arm.unpowered, arm.heat_up(sent, loss, rises)), np.array(rises)


def test_a_motor_that_heats_loses_torque_as_its_resistance_rises(robot_arm: Robot) -> None:
    moved, rises = heated(40.0)
    assert rises[-1] > 0.1
    found = replay(
        robot_arm, arm.as_log("warm", SENT, *moved), effects.effect("thermal_fade", "shoulder", loss_per_s=40.0)
    )
    assert np.abs(moved[0] - arm.simulate(SENT)[0]).max() > 1e-2
    assert np.abs(found - moved[0]).max() < 1e-9


def test_a_replay_from_within_a_log_has_motors_as_warm_as_they_were(robot_arm: Robot) -> None:
    """Pieces of 100 rows, beside those of motors that lose nothing."""
    moved, _ = heated(40.0)
    log, own = arm.as_log("warm", SENT, *moved), effects.effect("thermal_fade", "shoulder", loss_per_s=40.0)
    rows, replayer = [0, 350, 499], Replayer(robot_arm)
    states = np.concatenate(moved, axis=1)[rows]
    (pieces,) = replayer.replay_pieces([Rollout(log, (own,))], [Starts(rows, states)], 100)
    (cold,) = replayer.replay_pieces([Rollout(log)], [Starts(rows, states)], 100)
    for row, piece, without in zip(rows, pieces, cold, strict=True):
        misses = [np.abs(of.qpos - moved[0][row : row + 100]).max() for of in (piece, without)]
        assert misses[1] > 3e-4 and misses[0] < 0.01 * misses[1]


def test_motors_that_lag_and_heat_have_both_states_in_their_places(robot_arm: Robot) -> None:
    """A lag that is over within a step changes nothing, and one of 5 ms keeps the loss of torque."""
    moved, _ = heated(40.0)
    log, warm = arm.as_log("warm", SENT, *moved), effects.effect("thermal_fade", "shoulder", loss_per_s=40.0)
    quick, slow = (effects.effect("motor_lag", "shoulder", time_constant_s=lag) for lag in (1e-5, 5e-3))
    assert np.abs(replay(robot_arm, log, warm, quick) - replay(robot_arm, log, quick)).max() > 1e-2
    lost = [replay(robot_arm, log, warm, *lag) - replay(robot_arm, log, *lag) for lag in ([], [quick], [slow])]
    assert np.abs(lost[1] - lost[0]).max() < 0.05 * np.abs(lost[0]).max()
    assert np.abs(lost[2] - lost[0]).max() < 0.3 * np.abs(lost[0]).max()


def test_friction_under_load_is_a_share_of_the_torque_that_the_joint_carries(robot_arm: Robot, log: Log) -> None:
    moved, own = arm.simulate(SENT, before=arm.rub(SENT, 0.2)), effects.effect("load_friction", "elbow", share=0.2)
    assert np.abs(moved[0] - arm.simulate(SENT)[0]).max() > 1e-2
    found = replay(robot_arm, arm.as_log("rubbing", SENT, *moved), own)
    assert np.abs(found - moved[0]).max() < 1e-9
    predicted = replay(robot_arm, log, own)  # by the load and the directions of a log without friction
    assert np.abs(predicted - moved[0]).max() < 0.25 * np.abs(moved[0] - arm.simulate(SENT)[0]).max()


def test_a_gear_carries_what_the_motor_gives_and_not_what_a_biased_encoder_tells(robot_arm: Robot) -> None:
    """The encoder of the elbow says 0.15 rad too much, of which its PD makes 6 N·m that the joint carries."""
    bias = np.array([0.0, 0.0, 0.15])

    def mislead(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        given = SENT.asked[row, 2] - arm.KP * (data.qpos[2] + 0.15) - arm.KD * data.qvel[2]
        data.qfrc_applied[2] = -0.2 * abs(given) * np.tanh(data.qvel[2] / 0.05)

    qpos, qvel = arm.simulate(SENT, before=mislead, control=SENT.asked - arm.KP * bias)
    own = effects.effect("load_friction", "elbow", share=0.2), effects.effect("encoder_bias", "elbow", bias_rad=0.15)
    found = replay(robot_arm, arm.as_log("misled", SENT, qpos + bias, qvel), *own)
    assert np.abs(found - (qpos + bias)).max() < 1e-9


def test_a_loaded_gear_holds_what_it_carries_up_to_its_share(tmp_path) -> None:
    """A beam that a motor holds at rest: 8 % less torque than its weight hardly lowers it, 12 % less drops it."""
    beam = """<mujoco model="beam"><option timestep="0.001"/><worldbody><body><joint name="j" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="2"/></body></worldbody>
      <actuator><motor joint="j" forcerange="-40 40"/></actuator></mujoco>"""
    (tmp_path / "beam.xml").write_text(beam)
    robot, rows, zero = Robot.load(tmp_path / "beam.xml"), 300, np.zeros(300)
    model = robot.model
    weight = float(model.body_mass[-1] * 9.81 * model.body_ipos[-1, 0])
    sunk = {}
    for lack in (0.08, 0.12):
        columns = {f"{name}/j": zero for name in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
        columns |= {"time": np.arange(rows) * 0.001, "cmd_tau/j": np.full(rows, -(1 - lack) * weight)}
        held = Log("held", columns, arm.LogInfo("beam", 0.001, "plain MuJoCo"))
        own = effects.effect("load_friction", share=0.1)
        sunk[lack] = [float(replay(robot, held, *found)[-1, 0]) for found in ((), (own,))]
    assert sunk[0.08][0] > 0.05 and 0 < sunk[0.08][1] < 0.016  # creeps at less than 0.05 rad/s
    assert sunk[0.12][1] > 0.01


STICTION = (
    '<dcmotor name="grip" joint="elbow" motorconst="0 0" resistance="1" input="none" lugre="{lugre}"/></actuator>'
)


def test_holding_torque_is_mujocos_own_lugre_friction(robot_arm: Robot, log: Log) -> None:
    """The same friction in the model file: 400 N·m/rad of teeth that give 5 mrad before 2 N·m break loose."""
    mjcf = arm.MJCF.replace("</actuator>", STICTION.format(lugre="400 0.8 0.002 2 0.1"))

    def dragged(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        if data.time == 0:  # g(v) sign(v) / stiffness of a joint that moves
            data.act[0] = (0.002 + 1.998 * np.exp(-((SENT.speed[0, 2] / 0.1) ** 2))) * np.sign(SENT.speed[0, 2]) / 400

    plain = arm.simulate(SENT, before=dragged, mjcf=mjcf)[0]
    found = replay(robot_arm, log, effects.effect("static_friction", "elbow", torque_nm=2.0))
    assert np.abs(plain - arm.simulate(SENT)[0]).max() > 1e-3
    assert np.abs(found - plain).max() < 1e-9


def test_a_joint_holds_up_to_the_torque_and_lets_go_beyond(tmp_path) -> None:
    """A slow push at a resting disc: 0.6 of the torque moves it by the teeth's few mrad, 1.1 turns it freely."""
    disc = """<mujoco model="disc"><option timestep="0.001"/><worldbody><body><joint name="j" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody>
      <actuator><motor joint="j"/></actuator></mujoco>"""
    (tmp_path / "disc.xml").write_text(disc)
    robot, rows, zero = Robot.load(tmp_path / "disc.xml"), 2000, np.zeros(2000)
    angle = {}
    for push in (0.6, 1.1):
        columns = {f"{name}/j": zero for name in ("joint_pos", "joint_vel", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")}
        columns |= {"time": np.arange(rows) * 0.001, "cmd_tau/j": push * np.minimum(np.arange(rows) / 1000, 1.0)}
        slow = Log("slow", columns, arm.LogInfo("disc", 0.001, "plain MuJoCo"))
        angle[push] = float(replay(robot, slow, effects.effect("static_friction", torque_nm=1.0))[-1, 0])
    assert 0.002 < angle[0.6] < 0.02  # the teeth, and their creep
    assert angle[1.1] > 1.0
