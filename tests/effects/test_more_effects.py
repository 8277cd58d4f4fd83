"""Effects that are looked for when they are named: each moves an arm as plain MuJoCo with one number changed does."""

import itertools
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.effects.base import Commands, Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from tests.effects import moving_arm as arm

SENT = arm.commands(3)


@pytest.fixture(scope="module")
def robot_arm(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return arm.load(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def log() -> Log:
    return arm.as_log("nominal", SENT, *arm.simulate(SENT))


def replay(robot: Robot, log: Log, *found: Effect) -> np.ndarray:
    return Replayer(robot).motions([Rollout(log, found)])[0].qpos


def damp(model: mujoco.MjModel) -> None:
    model.dof_dampingpoly[1, 0] = 0.03 + 0.2


def undamp(model: mujoco.MjModel) -> None:
    model.dof_dampingpoly[1, 0] = 0.0


def load(model: mujoco.MjModel) -> None:
    model.body("lower").mass += 0.4
    mujoco.mj_setConst(model, mujoco.MjData(model))


def lighten(model: mujoco.MjModel) -> None:
    model.body("lower").mass -= 0.3
    mujoco.mj_setConst(model, mujoco.MjData(model))


def stretch(model: mujoco.MjModel) -> None:
    """The lower link's centre is 0.125 m out along x, whatever the axes of its inertia are."""
    model.body("lower").ipos[0] += 0.04
    model.body_sameframe[:] = 0
    model.geom_sameframe[:] = 0
    mujoco.mj_setConst(model, mujoco.MjData(model))


def turn_harder(model: mujoco.MjModel) -> None:
    model.body("upper").inertia *= 2.0
    mujoco.mj_setConst(model, mujoco.MjData(model))


def tilt_mount(model: mujoco.MjModel) -> None:
    """Pitched by 0.1 rad: what fell along −z falls along −x too."""
    model.opt.gravity = 9.81 * np.array([-np.sin(0.1), 0, -np.cos(0.1)])


def roll_mount(model: mujoco.MjModel) -> None:
    model.opt.gravity = 9.81 * np.array([0, np.sin(0.1), -np.cos(0.1)])


CHANGES: list[tuple[str, str, dict[str, float], Callable[[mujoco.MjModel], None]]] = [
    ("quadratic_damping", "shoulder", {"coefficient": 0.2}, damp),
    ("quadratic_damping", "shoulder", {"coefficient": -0.03}, undamp),
    ("link_payload", "elbow", {"mass_kg": 0.4}, load),
    ("link_payload", "elbow", {"mass_kg": -0.3}, lighten),
    ("link_com", "elbow", {"outward_m": 0.04}, stretch),
    ("link_inertia", "shoulder", {"scale": 2.0}, turn_harder),
    ("gravity_direction", "all", {"pitch_rad": 0.1}, tilt_mount),
    ("gravity_direction", "all", {"roll_rad": 0.1}, roll_mount),
]


@pytest.mark.parametrize(("name", "location", "values", "change"), CHANGES)
def test_an_effect_moves_the_arm_as_the_changed_model_does(
    name: str, location: str, values: dict, change: Callable, robot_arm: Robot, log: Log
) -> None:
    plain, nominal = arm.simulate(SENT, change)[0], arm.simulate(SENT)[0]
    found = replay(robot_arm, log, effects.effect(name, location, **values))
    assert np.abs(plain - nominal).max() > 1e-3
    assert np.abs(found - plain).max() < 1e-9


def test_an_offset_of_torque_is_delivered_beside_the_command(robot_arm: Robot, log: Log) -> None:
    def push(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        data.qfrc_applied[1] = -1.5

    found = replay(robot_arm, log, effects.effect("torque_offset", "shoulder", torque_nm=-1.5))
    assert np.abs(found - arm.simulate(SENT, before=push)[0]).max() < 1e-9


def test_what_makes_up_for_friction_acts_by_the_velocities_of_the_log(robot_arm: Robot) -> None:
    """A controller in plain MuJoCo adds 1.5 N·m along the measured motion, and its log does not hold them."""
    helped: list[float] = []

    def help_along(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        helped.append(1.5 * np.tanh(data.qvel[1] / 0.02))
        data.qfrc_applied[1] = helped[-1]

    moved = arm.simulate(SENT, before=help_along)
    assert min(helped) < -1.4 and max(helped) > 1.4
    own = effects.effect("friction_compensation", "shoulder", torque_nm=1.5)
    found = replay(robot_arm, arm.as_log("helped", SENT, *moved), own)
    assert np.abs(moved[0] - arm.simulate(SENT)[0]).max() > 1e-2
    assert np.abs(found - moved[0]).max() < 1e-9


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


def test_the_largest_torque_falls_on_a_line_with_the_speed(robot_arm: Robot) -> None:
    """Pushed to and fro with more than its 40 N·m, the elbow gets what the line to 8 rad/s leaves of it."""
    hard = arm.Sent(60 * np.sign(SENT.push), SENT.wanted, SENT.speed)

    def weaken(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        v = data.qvel[2]
        asked = hard.asked[row, 2] - arm.KP * data.qpos[2] - arm.KD * v
        data.qfrc_applied[2] = np.clip(np.clip(asked, -40 * (1 + v / 8), 40 * (1 - v / 8)), -40, 40)

    def off(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[2], model.actuator_gainprm[2] = 0, 0

    plain = arm.simulate(hard, off, weaken)
    log = arm.as_log("hard", hard, *plain)
    found = replay(robot_arm, log, effects.effect("duty_limit", "elbow", droop_s_rad=1 / 8))
    assert np.abs(replay(robot_arm, log) - plain[0]).max() > 0.1
    assert np.abs(found - plain[0]).max() < 1e-6
    assert effects.known()["duty_limit"].lacks(robot_arm) is None
    assert effects.known()["duty_limit"].lacks(Robot.load()) == (
        "motors without stated constants (see torque_speed_limit)"
    )


@pytest.mark.parametrize(("ratio", "steps"), [(0.5, 2), (0.1, 10)])
def test_a_replay_of_other_steps_is_that_of_a_finer_simulation(
    ratio: float, steps: int, robot_arm: Robot, log: Log
) -> None:
    """Errors of Euler's method are proportional to the step, to second order."""
    plain, nominal = arm.simulate(SENT, steps=steps)[0], arm.simulate(SENT)[0]
    found = replay(robot_arm, log, effects.effect("numerics", step_ratio=ratio))
    assert np.abs(plain - nominal).max() > 1e-3
    assert np.abs(found - plain).max() < 0.05 * np.abs(plain - nominal).max()


def test_a_log_of_a_coarser_simulation_is_extrapolated(robot_arm: Robot, log: Log) -> None:
    def coarse(model: mujoco.MjModel) -> None:
        model.opt.timestep = 2 * arm.PERIOD_S

    every_other = arm.Sent(SENT.push[::2], SENT.wanted[::2], SENT.speed[::2])
    plain, nominal = arm.simulate(every_other, coarse)[0], arm.simulate(SENT)[0][::2]
    held = arm.as_log(
        "held", arm.Sent(*(np.repeat(x, 2, axis=0) for x in vars(every_other).values())), *arm.simulate(SENT)
    )
    found = replay(robot_arm, held, effects.effect("numerics", step_ratio=2.0))[::2]
    assert np.abs(found - plain).max() < 0.15 * np.abs(plain - replay(robot_arm, held)[::2]).max()
    assert np.abs(plain - nominal).max() > 1e-3


def test_long_steps_for_derivatives_change_nothing_of_what_a_ratio_means(robot_arm: Robot, log: Log) -> None:
    """The ratio is one to the usual steps, whatever steps the replayer takes for a derivative."""
    usual = Replayer(robot_arm)
    rough, half = usual.with_steps(0.0005), effects.effect("numerics", step_ratio=0.25)
    change = [
        one.motions([Rollout(log, (half,))])[0].qpos - one.motions([Rollout(log)])[0].qpos for one in (usual, rough)
    ]
    assert np.abs(change[0] - change[1]).max() < 0.1 * np.abs(change[0]).max()


def test_lost_commands_are_late_by_their_mean(robot_arm: Robot, log: Log) -> None:
    """Against the mean over 4000 draws of which commands get lost."""
    rng, share, rows = np.random.default_rng(0), 0.6, 40
    kind = effects.effect("dropped_commands", "elbow", share=share)
    sent = np.cumsum(rng.standard_normal((rows, 3)), axis=0)
    found = kind.change_commands(Commands(sent, 2 * sent, sent), 0.001, robot_arm)
    lost = rng.random((4000, rows)) < share
    lost[:, 0] = False
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(rows)), axis=1)
    mean = sent[:, 2][last].mean(axis=0)
    assert found.torque[:, 2] == pytest.approx(mean, abs=0.15)
    assert np.array_equal(found.torque[:, :2], sent[:, :2])
    assert found.position[:, 2] == pytest.approx(2 * found.torque[:, 2])


def test_a_pd_off_board_answers_what_it_measured_before(robot_arm: Robot, log: Log) -> None:
    """A PD written here, with a memory of 4 ms for states and commands, in fine steps."""
    delay_rows, fine = 4, 10
    states: list[tuple[np.ndarray, np.ndarray]] = []

    def off(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[:] = 0

    def late(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        states.append((data.qpos.copy(), data.qvel.copy()))
        q, v = states[max(0, len(states) - 1 - delay_rows * fine)]
        sent = max(0, row - delay_rows)
        data.ctrl[:] = SENT.asked[sent] - arm.KP * q - arm.KD * v

    plain = arm.simulate(SENT, off, late, steps=fine)[0]
    found = replay(
        robot_arm, log, effects.effect("loop_delay", delay_s=0.004), effects.effect("numerics", step_ratio=0.1)
    )
    fast = arm.simulate(SENT, steps=fine)[0]
    late_commands = replay(
        robot_arm, log, effects.effect("command_delay", delay_s=0.004), effects.effect("numerics", step_ratio=0.1)
    )
    assert np.abs(plain - fast).max() > 5e-3
    assert np.abs(found - plain).max() < 0.1 * np.abs(plain - fast).max()
    assert np.abs(late_commands - plain).max() > 4 * np.abs(found - plain).max()


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


def test_a_leaning_frame_reports_a_fall_aslant(robot: Robot, reference: Log) -> None:
    """In the air a body falls along the reported vertical of a frame that leans by 0.2 rad, and starts where it was."""
    columns = dict(reference.columns) | {"base_pos_z": reference["base_pos_z"] + 2.0}
    air = Log("air", columns, reference.info).first_rows(100)
    tilted, level = Replayer(robot).motions(
        [Rollout(air, (effects.effect("frame_tilt", pitch_rad=0.2),)), Rollout(air)]
    )
    assert tilted.base_position[0] == pytest.approx(level.base_position[0], abs=1e-9)
    assert tilted.base_quaternion[0] == pytest.approx(level.base_quaternion[0], abs=1e-9)
    seconds = 99 * air.info.sample_period_s
    fall = (tilted.base_velocity - tilted.base_velocity[0])[-1] / seconds
    assert fall - (level.base_velocity - level.base_velocity[0])[-1] / seconds == pytest.approx(
        9.81 * np.array([-np.sin(0.2), 0, 1 - np.cos(0.2)]), abs=0.8
    )


def test_a_leaning_frame_is_taken_off_and_put_on(robot: Robot, reference: Log) -> None:
    tilt = effects.effect("frame_tilt", roll_rad=0.1, pitch_rad=-0.2)
    (motion,) = Replayer(robot).motions([Rollout(reference.first_rows(50))])
    seen = tilt.change_measured(motion, 0.001, robot)
    back = Motion(seen.qpos, seen.qvel)
    again = tilt.true_start(back, robot)
    assert np.abs(again.qpos - motion.qpos).max() < 1e-12
    assert np.abs(again.qvel - motion.qvel).max() < 1e-12
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, seen.base_quaternion[0])
    true = np.empty(9)
    mujoco.mju_quat2Mat(true, motion.base_quaternion[0])
    x, y = (
        np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]]),
        np.array([[np.cos(0.2), 0, -np.sin(0.2)], [0, 1, 0], [np.sin(0.2), 0, np.cos(0.2)]]),
    )
    assert rotation.reshape(3, 3) == pytest.approx(y @ x @ true.reshape(3, 3), abs=1e-12)
    assert seen.base_position == pytest.approx(motion.base_position @ (y @ x).T, abs=1e-12)


def behind_a_gear(stiffness: float, play: float, damping: float, steps: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """The arm with the elbow's rotor integrated here: J θ̈ = τ − spring, its PD at the rotor, the link reported."""
    rotor: dict[str, float] = {}
    inertia, step = 0.02, arm.PERIOD_S / steps

    def loosen(model: mujoco.MjModel) -> None:
        model.actuator_biasprm[2], model.dof_armature[2] = 0, 0
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def turn(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        q, v = data.qpos[2], data.qvel[2]
        if not rotor:
            rotor["q"], rotor["v"] = q, v
        twist = rotor["q"] - q
        beyond = twist - np.clip(twist, -play / 2, play / 2)
        spring = stiffness * beyond + (damping * (rotor["v"] - v) if beyond or not play else 0.0)
        motor = SENT.asked[row, 2] - arm.KP * rotor["q"] - arm.KD * rotor["v"]
        rotor["v"] += step * (motor - spring) / inertia
        rotor["q"] += step * rotor["v"]
        data.ctrl[2], data.qfrc_applied[2] = 0, spring

    return arm.simulate(SENT, loosen, turn, steps)


def since(row: int, motion: tuple[np.ndarray, np.ndarray]) -> Log:
    """The log of a motion of the arm without its first rows."""
    sent = arm.Sent(*(of[row:] for of in (SENT.push, SENT.wanted, SENT.speed)))
    return arm.as_log("since", sent, motion[0][row:], motion[1][row:])


@pytest.mark.parametrize(
    ("name", "values", "stiffness", "play", "damping"),
    [
        ("joint_elasticity", {"compliance_rad_nm": 0.006}, 1 / 0.006, 0.0, 0.05),
        ("joint_play", {"play_rad": 0.05}, 20000.0, 0.05, 10.0),
    ],
)
def test_a_motor_behind_a_gear_moves_as_spongs_model(
    name: str, values: dict, stiffness: float, play: float, damping: float, robot_arm: Robot
) -> None:
    """From the middle of a motion, where only the joints' state is known: so the rotor's is found as well."""
    plain, stiff = (since(150, of) for of in (behind_a_gear(stiffness, play, damping), arm.simulate(SENT, steps=20)))
    found = replay(robot_arm, plain, effects.effect(name, "elbow", **values))
    without = replay(robot_arm, plain)
    error = [np.abs(of - plain.per_joint("joint_pos", arm.JOINTS)).max() for of in (found, without)]
    steps = np.abs(replay(robot_arm, stiff) - stiff.per_joint("joint_pos", arm.JOINTS)).max()
    assert error[1] > 4e-3
    assert error[0] < steps + 0.1 * error[1]


def test_a_spring_and_play_act_at_one_joint_in_any_order(robot_arm: Robot, log: Log) -> None:
    both = [effects.effect("joint_elasticity", "elbow", compliance_rad_nm=0.003)]
    both.append(effects.effect("joint_play", "all", play_rad=0.02))
    one, other = replay(robot_arm, log, *both), replay(robot_arm, log, *both[::-1])
    assert np.abs(one - other).max() < 1e-9
    assert all(np.abs(one - replay(robot_arm, log, alone)).max() > 1e-3 for alone in both)


def test_without_an_inertia_of_the_rotor_there_is_none_behind_a_gear(tmp_path) -> None:
    bare = arm.load(tmp_path, arm.MJCF.replace('damping="0.1" armature="0.02"', 'damping="0.1"'))
    for name in ("joint_elasticity", "joint_play"):
        assert effects.known()[name].lacks(bare) == "the inertia of its rotors (armature)"


def test_play_at_all_joints_is_stable_at_every_size(robot_arm: Robot, log: Log) -> None:
    """Limits that couple several trees of bodies, which MuJoCo's solver does not stand with sparse matrices."""
    for play in (1e-4, 0.01, 0.1):
        for replayer in (Replayer(robot_arm), Replayer(robot_arm, largest_step_s=0.00025)):
            (motion,) = replayer.motions([Rollout(log, (effects.effect("joint_play", play_rad=play),))])
            assert np.abs(np.diff(motion.qpos, axis=0)).max() < 0.05


def test_a_rotor_has_no_friction_of_the_files_defaults(tmp_path, robot_arm: Robot, log: Log) -> None:
    """A file whose default joint has armature, damping and friction, and whose joints say what they have instead."""
    defaults = '<default><joint armature="0.5" damping="3" frictionloss="2" stiffness="9" range="-9 9"/></default>'
    stated = arm.MJCF.replace("<worldbody>", f"{defaults}<worldbody>").replace("<joint ", '<joint stiffness="0" ')
    stated = stated.replace('<joint stiffness="0" armature="0.5"', '<joint armature="0.5"', 1)
    stated = stated.replace('armature="0.02"/>', 'armature="0.02" frictionloss="0" limited="false"/>')
    other = arm.load(tmp_path, stated)
    assert np.array_equal(other.model.dof_armature, robot_arm.model.dof_armature)
    for name in ("joint_elasticity", "joint_play"):
        (about,) = effects.known()[name].parameters(robot_arm)
        found = effects.effect(name, **{about.name: about.moderate})
        assert np.abs(replay(other, log, found) - replay(robot_arm, log, found)).max() < 1e-9


def test_two_effects_that_add_parts_act_together_in_either_order(robot_arm: Robot, log: Log) -> None:
    """Each effect adds what it needs, however many parts another one added before it."""
    hypotheses = list_hypotheses(list(effects.known().values()), robot_arm, None)
    moderate = [h.on(log.name, h.clip(h.moderate)) for h in hypotheses if h.location == "all"]
    adds = [effect for effect in moderate if effect.structure is not None]
    assert {"motor_lag", "velocity_filter", "static_friction", "joint_elasticity"} <= {one.name for one in adds}
    replayer, rows = Replayer(robot_arm), 200
    for one, other in itertools.combinations(adds, 2):
        orders = [Rollout(log, (one, other)), Rollout(log, (other, one))]
        first, second = (motion.qpos for motion in replayer.motions(orders, rows))
        assert np.abs(first - second).max() < 1e-6, (one.name, other.name)
