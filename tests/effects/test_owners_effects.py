"""Causes that owners of servos and arms have, each beside plain MuJoCo with a drive written here by hand."""

from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.effects import moving_arm as arm
from tests.effects.moving_arm import KD, KP, SENT, replay
from tests.plain_simulation import BASE, BASE_RATES

FINE = 10
"""Steps a row of a simulation in which set points move within a row."""
SHORT_STEPS = effects.effect("numerics", step_ratio=1 / FINE)
HARD = arm.Sent(30 * SENT.push, SENT.wanted, SENT.speed)
"""Commands beyond the 40 N·m of the motors at times."""
LIMIT = 40.0


def by_hand(model: mujoco.MjModel) -> None:
    """No motor is simulated by MuJoCo."""
    model.actuator_biasprm[:], model.actuator_gainprm[:] = 0, 0


def asked(sent: arm.Sent, data: mujoco.MjData, row: int, kp: float | np.ndarray = KP, kd: float = KD) -> np.ndarray:
    """Torque that a joint PD asks for, N·m, (joints,)."""
    error, rate = sent.wanted[row] - data.qpos[:3], sent.speed[row] - data.qvel[:3]
    return np.asarray(sent.push[row] + kp * error + kd * rate)


def drive(sent: arm.Sent, torque: Callable[[mujoco.MjData, int], np.ndarray], steps: int = 1) -> arm.Sent:
    """Positions and velocities of the arm under torques (joints,) that are computed at every step."""

    def before(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        data.qfrc_applied[:] = torque(data, row)

    return arm.simulate(sent, by_hand, before, steps)


def beside(robot: Robot, sent: arm.Sent, plain: tuple[np.ndarray, np.ndarray], *own: effects.Effect) -> float:
    """Largest error of a replay with the effects, as a share of the largest without them."""
    log, short = arm.as_log("owner's", sent, *plain), [one for one in own if one.name == "numerics"]
    without, found = (np.abs(replay(robot, log, *of) - plain[0]).max() for of in (short, own))
    assert without > 5e-3
    return float(found / without)


@pytest.mark.parametrize("scale", [0.3, 3.0, 20.0])
@pytest.mark.parametrize("location", ["shoulder", "all"])
def test_a_stiffer_drive_is_one_of_a_larger_gain(scale: float, location: str, robot_arm: Robot) -> None:
    kp = KP * np.where([location == "all", True, location == "all"], scale, 1.0)
    plain = drive(SENT, lambda data, row: asked(SENT, data, row, kp=kp).clip(-LIMIT, LIMIT))
    assert beside(robot_arm, SENT, plain, effects.effect("position_gain", location, scale=scale)) < 1e-6


@pytest.mark.parametrize("scale", [0.1, 4.0])
def test_a_drive_that_damps_more_is_one_of_a_larger_gain(scale: float, robot_arm: Robot) -> None:
    plain = drive(SENT, lambda data, row: asked(SENT, data, row, kd=scale * KD).clip(-LIMIT, LIMIT))
    assert beside(robot_arm, SENT, plain, effects.effect("velocity_gain", scale=scale)) < 1e-6


@pytest.mark.parametrize("beside_it", ["motor_lag", "duty_limit", "velocity_filter"])
def test_a_gain_holds_in_motors_of_every_kind(beside_it: str, robot_arm: Robot, log: Log) -> None:
    """Of a log whose gains were sent three times as large, with a DC motor that hardly differs from none."""
    values = {"motor_lag": 1e-5, "duty_limit": 1e-6, "velocity_filter": 1e-5}
    (name,) = effects.known()[beside_it].declarations()
    other = effects.effect(beside_it, **{name: values[beside_it]})
    columns = dict(log.columns)
    for joint in arm.JOINTS:
        columns[f"cmd_kp/{joint}"], columns[f"cmd_kd/{joint}"] = (
            scale * log[f"cmd_{gain}/{joint}"] for gain, scale in (("kp", 3.0), ("kd", 2.0))
        )
    larger = replay(robot_arm, Log("larger", columns, log.info), other)
    gains = effects.effect("position_gain", scale=3.0), effects.effect("velocity_gain", scale=2.0)
    assert np.abs(larger - replay(robot_arm, log, other)).max() > 1e-2
    assert np.abs(replay(robot_arm, log, other, *gains) - larger).max() < 1e-12


@pytest.mark.parametrize("scale", [0.5, 2.5])
def test_another_limit_clips_elsewhere(scale: float, robot_arm: Robot) -> None:
    most = np.array([LIMIT, scale * LIMIT, LIMIT])
    plain = drive(HARD, lambda data, row: asked(HARD, data, row).clip(-most, most))
    assert beside(robot_arm, HARD, plain, effects.effect("torque_limit", "shoulder", scale=scale)) < 1e-6


def test_a_weak_motor_of_a_lower_limit_has_both(robot_arm: Robot) -> None:
    plain = drive(HARD, lambda data, row: 0.8 * asked(HARD, data, row).clip(-0.6 * LIMIT, 0.6 * LIMIT))
    own = effects.effect("torque_limit", scale=0.6), effects.effect("torque_gain", scale=0.8)
    assert beside(robot_arm, HARD, plain, *own) < 1e-6


@pytest.mark.parametrize(("location", "links"), [("all", ("turret", "upper", "lower")), ("elbow", ("lower",))])
def test_a_compensated_link_is_one_of_mujocos_gravcomp(location: str, links: tuple[str, ...], robot_arm: Robot) -> None:
    mjcf = arm.MJCF
    for link in links:
        mjcf = mjcf.replace(f'name="{link}"', f'name="{link}" gravcomp="0.7"')
    plain = arm.simulate(SENT, mjcf=mjcf)
    assert beside(robot_arm, SENT, plain, effects.effect("gravity_compensation", location, share=0.7)) < 1e-6


def test_compensations_of_several_places_add_up(robot_arm: Robot) -> None:
    mjcf = arm.MJCF.replace("<body ", '<body gravcomp="0.3" ').replace('0.3" name="lower"', '0.8" name="lower"')
    own = [effects.effect("gravity_compensation", at, share=s) for at, s in (("elbow", 0.5), ("all", 0.3))]
    for order in (own, own[::-1]):
        assert beside(robot_arm, SENT, arm.simulate(SENT, mjcf=mjcf), *order) < 1e-6


def test_the_drives_limit_is_that_of_pd_and_compensation_together(robot_arm: Robot) -> None:
    """The weight by ``qfrc_bias`` at rest, added to what the PD asks for before the limit."""
    model = mujoco.MjModel.from_xml_string(arm.MJCF)
    still = mujoco.MjData(model)

    def torque(data: mujoco.MjData, row: int) -> np.ndarray:
        still.qpos[:] = data.qpos
        mujoco.mj_forward(model, still)
        return (asked(HARD, data, row) + 0.9 * still.qfrc_bias).clip(-LIMIT, LIMIT)

    plain = drive(HARD, torque)
    assert beside(robot_arm, HARD, plain, effects.effect("gravity_compensation", share=0.9)) < 1e-6


def test_what_the_model_compensates_may_be_taken_away(tmp_path: Path) -> None:
    mjcf = arm.MJCF.replace("<body ", '<body gravcomp="1" ')
    robot, plain = arm.load(tmp_path, mjcf), arm.simulate(SENT)
    (about,) = effects.known()["gravity_compensation"].parameters(robot)
    assert (about.lower, about.nominal, about.lower_is_physical) == (-1.0, 0.0, True)
    assert beside(robot, SENT, plain, effects.effect("gravity_compensation", share=-1.0)) < 1e-6


def test_nothing_beyond_a_passive_joint_is_compensated(tmp_path: Path) -> None:
    """An arm without a motor at its elbow."""
    mjcf = arm.MJCF.replace('<general joint="elbow" biastype="affine" forcerange="-40 40"/>', "")
    robot = arm.load(tmp_path, mjcf)
    model = Replayer(robot).model(
        Rollout(arm.as_log("x", SENT, *arm.simulate(SENT)), (effects.effect("gravity_compensation", share=0.5),))
    )
    of_links = [float(model.body_gravcomp[model.body(name).id]) for name in ("turret", "upper", "lower")]
    assert of_links == pytest.approx([0.5, 0.5, 0.0], abs=1e-9)


@pytest.mark.parametrize("time_constant", [0.003, 0.03, 0.2])
def test_a_filter_of_set_points_is_a_first_order_lag(time_constant: float, robot_arm: Robot) -> None:
    """In each step the PD gets what the filter, solved exactly, has in the middle of the step."""
    sent = np.stack([SENT.wanted, SENT.speed])
    left, half = sent[:, 0].copy(), np.exp(-arm.PERIOD_S / FINE / time_constant / 2)

    def torque(data: mujoco.MjData, row: int) -> np.ndarray:
        middle = sent[:, row] + half * (left - sent[:, row])
        left[:] = sent[:, row] + half * (middle - sent[:, row])
        found = SENT.push[row] + KP * (middle[0] - data.qpos[:3]) + KD * (middle[1] - data.qvel[:3])
        return np.asarray(found.clip(-LIMIT, LIMIT))

    own = effects.effect("set_point_filter", time_constant_s=time_constant)
    assert beside(robot_arm, SENT, drive(SENT, torque, FINE), own, SHORT_STEPS) < 0.02


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_a_set_point_moves_no_faster_than_its_rate(rate: float, robot_arm: Robot) -> None:
    """In steps: a new set point every 50 rows, as slow policies send them."""
    rows = np.arange(len(SENT.push)) // 50 * 50
    stepped = arm.Sent(SENT.push, SENT.wanted[rows], 0 * SENT.speed)
    now, most = stepped.wanted[0].copy(), rate * arm.PERIOD_S / FINE

    def torque(data: mujoco.MjData, row: int) -> np.ndarray:
        now[:] += (stepped.wanted[row] - now).clip(-most, most)
        return np.asarray((stepped.push[row] + KP * (now - data.qpos[:3]) - KD * data.qvel[:3]).clip(-LIMIT, LIMIT))

    own = effects.effect("set_point_slew", rate_rad_s=rate)
    assert beside(robot_arm, stepped, drive(stepped, torque, FINE), own, SHORT_STEPS) < 0.02


def test_a_supply_sags_by_what_all_motors_give(robot_arm: Robot) -> None:
    def torque(data: mujoco.MjData, row: int) -> np.ndarray:
        wanted = asked(HARD, data, row).clip(-LIMIT, LIMIT)
        return np.asarray(wanted * (1 - 0.4 * np.abs(wanted).sum() / (3 * LIMIT)))

    assert beside(robot_arm, HARD, drive(HARD, torque), effects.effect("supply_sag", sag=0.4)) < 1e-6


@pytest.mark.parametrize("delay", [0.06, 0.12])
def test_a_long_delay_shifts_the_commands(delay: float, robot_arm: Robot) -> None:
    late = round(delay / arm.PERIOD_S)

    def torque(data: mujoco.MjData, row: int) -> np.ndarray:
        sent = max(0, row - late)
        wanted = SENT.push[sent] + KP * (SENT.wanted[sent] - data.qpos[:3]) + KD * (SENT.speed[sent] - data.qvel[:3])
        return np.asarray(wanted.clip(-LIMIT, LIMIT))

    assert beside(robot_arm, SENT, drive(SENT, torque), effects.effect("command_delay", delay_s=delay)) < 1e-6


def test_a_zero_that_is_far_off_is_one_of_the_encoder(robot_arm: Robot) -> None:
    """The PD sees the elbow 0.5 rad ahead of where it is, and so does the log."""
    bias = np.array([0.0, 0.0, 0.5])

    def torque(data: mujoco.MjData, row: int) -> np.ndarray:
        error = SENT.wanted[row] - data.qpos[:3] - bias
        return np.asarray((SENT.push[row] + KP * error + KD * (SENT.speed[row] - data.qvel[:3])).clip(-LIMIT, LIMIT))

    qpos, qvel = drive(SENT, torque)
    own = effects.effect("encoder_bias", "elbow", bias_rad=0.5)
    assert beside(robot_arm, SENT, (qpos + bias, qvel), own) < 1e-6


BALL = """<mujoco model="ball"><option timestep="0.001"/><worldbody>
  <geom type="plane" size="3 3 0.1" priority="1" solref="{}"/><body pos="0 0 0.3"><freejoint/>
  <geom name="foot" size="0.05" mass="1"/><body pos="0 0 0.2"><joint name="a" axis="0 1 0" damping="0.1"/>
  <geom size="0.05" mass="0.1" pos="0 0 0.1"/></body></body></worldbody>
  <actuator><motor joint="a"/></actuator></mujoco>"""


def bounce(mjcf: str) -> np.ndarray:
    """Positions (rows, nq) of a ball that falls on the floor, by ``mj_step``."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    data, rows = mujoco.MjData(model), []
    for _ in range(700):
        rows.append(data.qpos.copy())
        mujoco.mj_step(model, data)
    return np.array(rows)


def fallen(folder: Path, mjcf: str, *own: effects.Effect) -> np.ndarray:
    """The same by the replay of a log, with effects."""
    (folder / "ball.xml").write_text(mjcf)
    robot, zero = Robot.load(folder / "ball.xml"), np.zeros(700)
    names = (f"{name}/a" for name in ("joint_pos", "joint_vel", "cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"))
    columns = {"time": 0.001 * np.arange(700)} | dict.fromkeys((*names, *BASE, *BASE_RATES), zero)
    columns |= {"base_pos_z": zero + 0.3, "base_quat_w": zero + 1}
    log = Log("fall", columns, arm.LogInfo("ball", 0.001, "plain MuJoCo"))
    return Replayer(robot).motions([Rollout(log, own)])[0].qpos


@pytest.mark.parametrize("scale", [0.3, 3.0])
@pytest.mark.parametrize("form", ["0.03 0.4", "-6944.444444444444 -66.66666666666667"])
def test_contacts_damp_more_at_the_same_stiffness(scale: float, form: str, tmp_path: Path) -> None:
    """0.03 s and a ratio of 0.4 are a stiffness of 1/(T ζ)² and a damping of 2/T in MuJoCo's other form."""
    own = effects.effect("contact_damping", scale=scale)
    plain = bounce(BALL.format(f"{-1 / (0.03 * 0.4) ** 2!r} {-scale * 2 / 0.03!r}"))
    assert np.abs(plain - bounce(BALL.format(form))).max() > 5e-3
    assert np.abs(fallen(tmp_path, BALL.format(form), own) - plain).max() < 1e-7


@pytest.mark.parametrize("form", ["0.03 0.4", "-6944.4 -66.7"])
def test_softness_and_damping_of_contacts_act_in_any_order(form: str, tmp_path: Path) -> None:
    own = effects.effect("contact_damping", scale=1.5), effects.effect("foot_compliance", time_constant_s=0.05)
    one, other = (fallen(tmp_path, BALL.format(form), *order) for order in (own, own[::-1]))
    assert np.abs(one - other).max() < 1e-9
    assert np.abs(one - fallen(tmp_path, BALL.format(form), own[1])).max() > 1e-3
