"""Effects that are looked for when they are named: each moves an arm as plain MuJoCo with one number changed does."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.effects.base import Commands, Effect, parameter
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from tests.effects import moving_arm as arm
from tests.effects.moving_arm import SENT, replay


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


@pytest.mark.parametrize("mass", [0.4, 0.1, -0.2])
def test_a_payload_lies_where_its_moment_says(mass: float, robot_arm: Robot, log: Log, tmp_path: Path) -> None:
    """A point of the lower link 0.3 m from its joint, added to the model file of plain MuJoCo.

    Where the payload is negative, it is the robot's own file that has the point.
    """
    geom = f"""<geom size="1e-4" pos="0.3 0 0" mass="{abs(mass)}" contype="0" conaffinity="0"/></body></body></body>"""
    heavier = arm.MJCF.replace("</body></body></body>", geom)
    with_point, without = arm.simulate(SENT, mjcf=heavier)[0], arm.simulate(SENT)[0]
    robot, plain = (robot_arm, with_point) if mass > 0 else (arm.load(tmp_path, heavier), without)
    centre = 0.125 if mass > 0 else (0.6 * 0.125 - mass * 0.3) / (0.6 - mass)
    payload = effects.effect("link_payload", "elbow", mass_kg=mass, moment_kg_m=mass * (0.3 - centre))
    assert np.abs(with_point - without).max() > 1e-3
    assert np.abs(replay(robot, log, payload) - plain).max() < 1e-7


@dataclass(frozen=True)
class Knob(Effect):
    """A weight of 0.4 kg at the end of the lower link, there where its parameter is not nominal."""

    name = "knob"
    there: float = parameter(0.0, "1", 0.0, 1.0)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        spec.body("lower").add_geom(size=[1e-4, 0, 0], pos=[0.3, 0, 0], mass=0.4, contype=0, conaffinity=0)


def test_parts_that_an_effect_adds_need_no_word_that_it_adds_them(robot_arm: Robot, log: Log) -> None:
    geom = """<geom size="1e-4" pos="0.3 0 0" mass="0.4" contype="0" conaffinity="0"/></body></body></body>"""
    heavier = arm.simulate(SENT, mjcf=arm.MJCF.replace("</body></body></body>", geom))[0]
    assert np.abs(heavier - arm.simulate(SENT)[0]).max() > 1e-3
    assert np.abs(replay(robot_arm, log, Knob(there=1.0)) - heavier).max() < 1e-7
    assert Knob().structure is None and np.array_equal(replay(robot_arm, log, Knob()), replay(robot_arm, log))


@pytest.mark.parametrize("mass", [-0.54, -0.2, -0.01, 0.01, 0.3, 1.8])
@pytest.mark.parametrize("moment", [-0.5, -0.05, 0.05, 0.5])
def test_a_link_with_any_payload_is_one_that_a_model_file_can_have(
    mass: float, moment: float, robot_arm: Robot
) -> None:
    """MuJoCo compiles no body whose inertias break A + B >= C."""
    model = mujoco.MjModel.from_xml_string(arm.MJCF)
    effects.effect("link_payload", "elbow", mass_kg=mass, moment_kg_m=moment).change_model(model, robot_arm)
    inertia = " ".join(f"{one:.5g}" for one in model.body("lower").inertia)
    body = f"""<inertial pos="0 0 0" mass="{model.body("lower").mass[0]}" diaginertia="{inertia}"/><joint/>"""
    mujoco.MjModel.from_xml_string(f"<mujoco><worldbody><body>{body}</body></worldbody></mujoco>")


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
