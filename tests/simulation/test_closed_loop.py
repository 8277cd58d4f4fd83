"""A controller in the loop: the same physics as a replay, and nothing but what sensors tell."""

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.logs.log import Log
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.closed_loop import Plant, Sensing, as_slice, run_closed_loop
from leapgap.simulation.controller import Command, Controller, StateEstimate
from leapgap.simulation.open_loop import Course, MotionPlan, PreparedRun, prepare, run_open_loop
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import NoiseRows, SensorNoise
from tests import plain_arm
from tests.conftest import standing

SILENT = SensorNoise(0, 0, 0, 0, 0, 0)


class Playback(Controller):
    """Sends a jump's commands row by row, whatever happens; remembers what it was told."""

    def __init__(self, jump: Log, robot: Robot) -> None:
        quantities = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
        self.rows = [jump.per_joint(quantity, robot.joints) for quantity in quantities]
        self.force = jump.stack([f"mpc_force/{axis}" for axis in PAIR_FORCE_AXES])
        self.told: list[StateEstimate] = []

    def command(self, estimate: StateEstimate) -> Command:
        row = len(self.told)
        self.told.append(estimate)
        return Command(*(values[row] for values in self.rows), self.force[row])


def ready_for(reference: Log, robot: Robot, found: tuple[effects.Effect, ...], block_m: float = 0.0) -> PreparedRun:
    return prepare([MotionPlan("made", reference, block_m)], Replayer(robot), found, Course())[0]


ALL_KINDS = (
    effects.effect("joint_damping", damping=0.4),
    effects.effect("command_delay", delay_s=0.0033),
    effects.effect("torque_speed_limit", voltage_v=21.5),
    effects.effect("motor_lag", location="rear", time_constant_s=0.004),
    effects.effect("torque_gain", location="FR_calf", scale=0.9),
    effects.effect("encoder_bias", bias_rad=0.02),
    effects.effect("state_latency", delay_s=0.01),
    effects.effect("sample_period", scale=1.05),
)
NAMED = (
    effects.effect("loop_delay", delay_s=0.002),
    effects.effect("dropped_commands", location="rear", share=0.4),
    effects.effect("torque_offset", location="FR_calf", torque_nm=-1.0),
    effects.effect("quadratic_damping", coefficient=0.02),
    effects.effect("static_friction", location="RL", torque_nm=0.5),
    effects.effect("link_payload", location="calf", mass_kg=0.1),
    effects.effect("gravity_direction", pitch_rad=0.02),
    effects.effect("frame_tilt", roll_rad=0.03),
    effects.effect("thermal_fade", location="rear", loss_per_s=1.0),
)
OWNERS = (
    effects.effect("position_gain", location="calf", scale=1.3),
    effects.effect("velocity_gain", scale=0.8),
    effects.effect("torque_limit", location="rear", scale=0.7),
    effects.effect("set_point_filter", location="front", time_constant_s=0.004),
    effects.effect("set_point_slew", location="RL_calf", rate_rad_s=4.0),
    effects.effect("contact_damping", scale=1.5),
)


@pytest.mark.parametrize(
    "found",
    [(), ALL_KINDS, NAMED, OWNERS],
    ids=["nominal", "with effects", "with named effects", "with drives of their own"],
)
def test_closed_loop_of_known_commands_is_their_replay(
    robot: Robot, reference: Log, found: tuple[effects.Effect, ...]
) -> None:
    ready = ready_for(reference, robot, found, block_m=0.03)
    run = run_closed_loop(
        ready, Playback(ready.commanded, robot), Replayer(robot), found, Sensing(SILENT), np.random.default_rng(0)
    )
    trial = Rollout(ready.commanded, found, first_state=ready.start)
    (truth,), (reported,) = Replayer(robot).true_motions([trial]), Replayer(robot).motions([trial])
    rounding = 1e-10 if found else 0.0  # a delay's share of two rows rounds differently by the row's number
    assert run.truth.qpos == pytest.approx(truth.qpos, abs=rounding, rel=0)
    assert run.truth.qvel == pytest.approx(truth.qvel, abs=100 * rounding, rel=0)
    assert run.log["base_pos_z"] == pytest.approx(reported.qpos[:, 2], abs=1e-12)
    assert run.log.per_joint("joint_pos") == pytest.approx(reported.qpos[:, robot.joint_qpos], abs=1e-12)
    (open_loop,) = run_open_loop(
        [MotionPlan("made", reference, 0.03)], robot, found, SILENT, Course(), np.random.default_rng(0)
    )
    assert set(open_loop.columns) <= set(run.log.columns)
    assert all(run.log[name] == pytest.approx(open_loop[name], abs=1e-9) for name in open_loop.columns)


def test_a_loop_rubs_under_its_own_load_as_a_replay_of_its_log_does(robot: Robot, reference: Log) -> None:
    """Load and direction are those of the simulated robot, not those of its plan, in which nothing rubs."""
    rubbing = (effects.effect("load_friction", share=0.15), effects.effect("torque_gain", location="calf", scale=0.9))
    ready = ready_for(reference.first_rows(700), robot, rubbing)
    run = run_closed_loop(
        ready, Playback(ready.commanded, robot), Replayer(robot), rubbing, Sensing(SILENT), np.random.default_rng(0)
    )
    by_log, by_plan = Replayer(robot).true_motions(
        [Rollout(log, rubbing, first_state=ready.start) for log in (run.log, ready.commanded)]
    )
    assert np.abs(by_log.qpos - run.truth.qpos).max() < 1e-9
    assert np.abs(by_plan.qpos - run.truth.qpos).max() > 1e-4


@pytest.mark.parametrize("name", ["joint_elasticity", "joint_play"])
def test_a_motor_behind_a_gear_starts_in_a_loop_as_in_a_replay(robot: Robot, reference: Log, name: str) -> None:
    """A loop knows the first command alone, so the rotor's first velocity is that of its joint."""
    (about,) = effects.known()[name].parameters(robot)
    found = (effects.effect(name, **{about.name: about.moderate}),)
    ready = ready_for(reference.first_rows(40), robot, found)
    run = run_closed_loop(
        ready, Playback(ready.commanded, robot), Replayer(robot), found, Sensing(SILENT), np.random.default_rng(0)
    )
    (truth,) = Replayer(robot).true_motions([Rollout(ready.commanded, found, first_state=ready.start)])
    (stiff,) = Replayer(robot).true_motions([Rollout(ready.commanded, first_state=ready.start)])
    assert run.truth.qpos.shape == truth.qpos.shape
    assert np.abs(run.truth.qpos[:40] - truth.qpos[:40]).max() < 0.2 * np.abs(stiff.qpos - truth.qpos)[:40].max()


@pytest.mark.parametrize(
    ("rate_hz", "found"),
    [
        (4000, effects.effect("command_delay", delay_s=0.02)),  # 80 ticks
        (4000, effects.effect("state_latency", delay_s=0.05)),  # 200 ticks
        (100, effects.effect("state_latency", delay_s=0.15)),  # the longest there is, 15 ticks
        (1000, effects.effect("command_delay", delay_s=0.12)),
    ],
    ids=lambda value: str(getattr(value, "name", value)),
)
def test_a_delay_is_as_long_at_any_rate(robot: Robot, rate_hz: int, found: effects.Effect) -> None:
    rows = round(0.3 * rate_hz)
    still = standing(robot, rows)
    columns = dict(still.columns) | {"time": np.arange(rows) / rate_hz}
    for i, joint in enumerate(robot.joints):
        columns[f"cmd_pos/{joint}"] = still[f"cmd_pos/{joint}"] + 0.1 * np.sin(30 * columns["time"] + i)
    columns |= {f"mpc_force/{axis}": np.zeros(rows) for axis in PAIR_FORCE_AXES}
    jump = replace(still, columns=columns, info=replace(still.info, sample_period_s=1 / rate_hz))
    start = Replayer(robot).first_state(Rollout(jump))
    ready = PreparedRun(MotionPlan("waving", jump), jump, start)
    run = run_closed_loop(
        ready, Playback(jump, robot), Replayer(robot), (found,), Sensing(SILENT), np.random.default_rng(0)
    )
    trial = Rollout(jump, (found,), first_state=start)
    (truth,), (reported,) = Replayer(robot).true_motions([trial]), Replayer(robot).motions([trial])
    assert run.truth.qpos == pytest.approx(truth.qpos, abs=1e-9, rel=0)
    known = slice(math.ceil(found.delay_s * rate_hz) + 1, None)  # before, the log's start is all a memory has
    assert run.log["base_pos_z"][known] == pytest.approx(reported.qpos[known, 2], abs=1e-12)
    assert np.ptp(truth.qpos[:, 2]) > 0.002


def test_the_controller_is_told_what_the_log_holds_and_the_base_late(robot: Robot, reference: Log) -> None:
    ready = ready_for(reference, robot, ())
    controller = Playback(ready.commanded, robot)
    sensing = Sensing(SensorNoise(), base_delay_s=0.004)
    run = run_closed_loop(ready, controller, Replayer(robot), (), sensing, np.random.default_rng(3))
    told_x = np.array([estimate.base_position[0] for estimate in controller.told])
    assert np.array_equal(told_x[4:], run.log["base_pos_x"][:-4])
    assert np.array_equal([e.joint_vel for e in controller.told], run.log.per_joint("joint_vel"))
    assert np.std(run.log["base_pos_x"] - run.truth.qpos[:, 0]) == pytest.approx(0.001, rel=0.1)
    again = run_closed_loop(
        ready, Playback(ready.commanded, robot), Replayer(robot, threads=1), (), sensing, np.random.default_rng(3)
    )
    assert all(np.array_equal(run.log[name], again.log[name]) for name in run.log.columns)


def test_feet_touch_until_the_schedule_lifts_them_and_again_at_the_landing(robot: Robot, reference: Log) -> None:
    ready = ready_for(reference, robot, ())
    run = run_closed_loop(
        ready, Playback(ready.commanded, robot), Replayer(robot), (), Sensing(SILENT), np.random.default_rng(0)
    )
    front = [robot.feet.index(foot) for foot in robot.feet_of_pair("front")]
    rear = [robot.feet.index(foot) for foot in robot.feet_of_pair("rear")]
    assert run.touching[10:480].all()
    assert not run.touching[600:780, front].any()
    assert run.touching[560:760, rear].all()
    assert not run.touching[900:1100].any()
    assert run.touching[1190:].any(axis=0).all()


def test_gains_that_change_act_at_once(robot: Robot, reference: Log) -> None:
    ready = ready_for(reference, robot, ())
    plant = Plant(Replayer(robot), ready, ())
    first = Playback(ready.commanded, robot).command(None)  # type: ignore[arg-type]
    plant.send(first)
    soft = replace(first, kp=first.kp * 0, kd=first.kd * 0, torque=first.torque * 0 + 1.5)
    plant.send(soft)
    assert plant.data.actuator_force == pytest.approx(1.5)


def test_ground_forces_are_the_impulse_that_moves_the_whole_robot(robot: Robot, reference: Log) -> None:
    """Newton for the robot as a whole: ∫ F dt = m Δv of the centre of mass + weight · time; in the air it is zero."""
    ready = ready_for(reference, robot, ())
    run = run_closed_loop(
        ready, Playback(ready.commanded, robot), Replayer(robot), (), Sensing(SILENT), np.random.default_rng(0)
    )
    model, data = robot.model, mujoco.MjData(robot.model)

    def momentum(row: int) -> np.ndarray:
        data.qpos[:], data.qvel[:] = run.truth.qpos[row], run.truth.qvel[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        return model.body_subtreemass[1] * data.subtree_linvel[1]

    rows = slice(100, 800)
    impulse = 0.001 * run.ground_force[rows.start + 1 : rows.stop + 1].sum(axis=(0, 1))
    gained = momentum(rows.stop) - momentum(rows.start)
    weight = model.body_subtreemass[1] * 9.81 * 0.7
    assert impulse - [0, 0, weight] == pytest.approx(gained, abs=0.02 * weight)
    assert gained[2] > 10  # N s: the jump itself, ten times what is allowed to differ
    assert not run.ground_force[900:1100].any()
    assert (run.ground_force[100:400, :, 2] > 0).all()


@pytest.mark.parametrize("is_free", [True, False])
def test_noise_of_one_tick_is_that_of_all_rows_at_once(robot: Robot, tmp_path: Path, is_free: bool) -> None:
    """Bit for bit: tick by tick as a loop adds it, and to a whole motion, of a robot with a free base and of an arm."""
    if not is_free:
        plain_arm.write_model(tmp_path)
        robot = Robot.load(tmp_path / "arm.xml")
    rng = np.random.default_rng(3)
    qpos = rng.uniform(-0.3, 0.3, (20, robot.model.nq))
    if is_free:
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    motion = Motion(qpos, rng.uniform(-3, 3, (20, robot.model.nv)))
    errors = NoiseRows.draw(SensorNoise(), 20, len(robot.joints), rng)
    whole, measure = errors.add_to(motion, robot), errors.by_tick(robot)
    for tick in range(20):
        one = measure(motion[tick : tick + 1], tick)
        assert np.array_equal(one.qpos, whole.qpos[tick : tick + 1])
        assert np.array_equal(one.qvel, whole.qvel[tick : tick + 1])
    assert not np.array_equal(whole.qpos, motion.qpos)


def test_indices_that_follow_each_other_become_a_slice_and_others_stay() -> None:
    assert as_slice(np.array([7, 8, 9])) == slice(7, 10)
    for kept in (np.array([7, 9, 8]), np.array([7, 8, 10])):
        assert as_slice(kept) is kept
