from dataclasses import replace

import mujoco
import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.short_rollouts import ShortRollouts, StateChannels, smooth_start, thin_evenly
from leapgap.logs.log import Log
from leapgap.logs.state import States, motion_of
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.robot.rotations import turn_between
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from leapgap.simulation.sensors import SensorNoise
from tests.diagnosis.test_gap import hardware


@pytest.fixture(scope="module")
def evidence(robot: Robot, reference: Log) -> ShortRollouts:
    judged = JudgedLogs.of(hardware(robot, reference, noise=SensorNoise(), jumps=2), robot)
    return ShortRollouts.of(judged.states, Replayer(robot, terrain_slots=1), 0.1, 0.01, 8)


def test_noise_explains_the_errors_of_the_robot_that_made_the_logs(evidence: ShortRollouts) -> None:
    """Whitened errors are standard normal when only noise acts: χ² is the number of values."""
    about = evidence.whiten_for(evidence.on_every_log(()))
    (errors,) = about.residuals([about.on_every_log(())])
    chi2 = np.mean([np.mean(of**2) for of in errors])
    assert 0.85 < chi2 < 1.25
    (damped,) = about.residuals([about.on_every_log((effects.effect("joint_damping", damping=0.4),))])
    assert np.mean([np.mean(of**2) for of in damped]) > 10


def test_long_steps_see_the_same_departures(evidence: ShortRollouts) -> None:
    """Replays of 2 ms compare the same instants of the same pieces, and what an effect changes is much the same."""
    effect = effects.effect("joint_damping", damping=0.4)
    changes = []
    for of in (evidence, evidence.with_steps(0.0022)):
        trials = [(log, acting, p.starts) for acting in ((), (effect,)) for log, p in enumerate(of.pieces)]
        errors = np.array(list(of.errors(trials)))
        nominal, damped = np.split(errors, 2)
        changes.append((damped - nominal).reshape(-1, errors.shape[2]))
    exact, rough = changes
    assert evidence.with_steps(0.0022).pieces[0].ages.tolist() == (evidence.pieces[0].ages // 2).tolist()
    alike = (exact * rough).sum(axis=1) / np.linalg.norm(exact, axis=1) / np.linalg.norm(rough, axis=1)
    assert np.median(alike) > 0.98
    assert np.median(np.linalg.norm(rough, axis=1) / np.linalg.norm(exact, axis=1)) == pytest.approx(1, abs=0.05)


def test_pieces_that_begin_at_odd_rows_keep_every_row(evidence: ShortRollouts) -> None:
    starts = replace(evidence.pieces[0].starts, rows=[r + 1 for r in evidence.pieces[0].starts.rows])
    odd = replace(evidence, pieces=(replace(evidence.pieces[0], starts=starts), *evidence.pieces[1:]))
    assert odd.with_steps(0.0022).pieces[0].ages.tolist() == odd.pieces[0].ages.tolist()


def test_a_piece_may_end_with_the_log(robot: Robot, reference: Log) -> None:
    """Of 201 rows the last is compared and has no command to follow, by steps of two rows too."""
    jumps = [States.of(jump.first_rows(201), robot) for jump in hardware(robot, reference, jumps=2)]
    for step_s in (0.0011, 0.0022):
        ends = ShortRollouts.of(jumps, Replayer(robot), 0.1, 0.01, 8).with_steps(step_s)
        assert [of.starts.rows[-1] + int(of.ages[-1]) for of in ends.pieces] == [
            len(ends.pieces[0].logged.qpos) - 1
        ] * 2
        assert all(np.isfinite(of).all() for of in ends.errors([(i, (), p.starts) for i, p in enumerate(ends.pieces)]))


def test_threads_change_nothing(evidence: ShortRollouts) -> None:
    robot = evidence.state.robot
    alone, many = (
        replace(evidence, replayer=Replayer(robot, 1, threads)).whiten_for(evidence.on_every_log(()))
        for threads in (1, 3)
    )
    assert [w.tobytes() for w in alone.whitening] == [w.tobytes() for w in many.whitening]


def test_turns_are_mujocos(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    first, second = rng.standard_normal((2, 4))
    first /= np.linalg.norm(first)
    by = np.array([0.002, -0.001, 0.003])
    second = first.copy()
    mujoco.mju_quatIntegrate(second, by, 1.0)
    assert turn_between(first[None], second[None])[0] == pytest.approx(by, abs=1e-7)
    assert turn_between(first[None], -second[None])[0] == pytest.approx(by, abs=1e-7)


def test_a_displaced_state_differs_in_its_channel_alone(evidence: ShortRollouts, robot: Robot) -> None:
    state, at = evidence.state, evidence.pieces[0].starts.states[0]
    nq = robot.model.nq
    for channel in (0, 4, 8, 15, 30):
        moved = state.displace(at, int(state.entries[channel]), 1e-3)
        as_motion = [Motion(s[None, :nq], s[None, nq:]) for s in (moved, at)]
        difference = state.differences(*as_motion)[0]
        assert difference[channel] == pytest.approx(1e-3, abs=1e-8)
        assert np.abs(np.delete(difference, channel)).max() < 1e-8


def test_smoothing_keeps_parabolas_and_less_than_half_the_noise() -> None:
    rows = np.arange(60.0)
    logged = Motion((rows**2)[:, None], (3 * rows)[:, None])
    value, kept = smooth_start(logged, 30, np.arange(60) - 30, 9)
    assert value == pytest.approx([900.0, 90.0])
    assert 0.2 < kept < 0.5
    draws = np.random.default_rng(0).standard_normal((4000, 60))
    assert np.std(
        [smooth_start(Motion(d[:, None], d[:, None]), 30, np.arange(60) - 30, 9)[0][0] for d in draws]
    ) == pytest.approx(kept, rel=0.05)


def test_pieces_spread_over_logs_and_phases() -> None:
    rows = [np.arange(0, 1100, 100)] * 4
    kept = thin_evenly(rows, 22)
    assert sum(map(len, kept)) == 22
    assert set(np.concatenate(kept)) == set(rows[0])
    assert [len(k) for k in thin_evenly(rows, 1000)] == [11] * 4


def test_pieces_of_a_whole_jump_go_on_where_it_goes(robot: Robot, reference: Log) -> None:
    """A piece that starts from the true state of a whole replay repeats it, delayed commands and all."""
    late = (effects.effect("command_delay", delay_s=0.004),)
    replayer, trial = Replayer(robot), Rollout(reference, late)
    (whole,) = replayer.true_motions([trial], rows=400)
    states = np.concatenate([whole.qpos, whole.qvel], axis=1)
    ((piece,),) = replayer.replay_pieces([trial], [Starts([200], states[200:201])], 101)
    assert np.abs(piece.qpos - whole.qpos[200:301]).max() < 1e-9


def test_noise_of_every_channel_is_read_off_the_log(robot: Robot, reference: Log) -> None:
    noise = SensorNoise(base_pos_m=0.002, base_angle_rad=0.003, joint_vel_rad_s=0.07)
    (jump,) = hardware(robot, reference, noise=noise)
    state = StateChannels.of([jump], robot)
    noise_of_channel = state.noise(motion_of(jump, robot), jump)
    found = dict(zip((channel.name for channel in state.channels), noise_of_channel, strict=True))
    assert found["base_pos_y"] == pytest.approx(0.002, rel=0.15)
    assert found["base_pitch"] == pytest.approx(0.003, rel=0.15)
    assert found["joint_vel/RR_calf"] == pytest.approx(0.07, rel=0.15)
