"""The noise floor: the gap that sensor noise alone would make between a log and a replay of it."""

from collections.abc import Sequence

import numpy as np

from leapgap.diagnosis.channels import BASE_TURNS, channel_errors
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.logs.state import fitted_noise
from leapgap.robot.motion import POSITION_SLICE, QUATERNION_SLICE, VELOCITY_SLICE, Motion
from leapgap.simulation.replay import Replayer, Rollout


def noise_floor(
    judged: JudgedLogs,
    replayer: Replayer,
    draws: int,
    rng: np.random.Generator,
    nominal: Sequence[Motion] | None = None,
) -> np.ndarray:
    """Mean sum of squares that sensor noise alone gives for each log, (logs,), summed over rows and channels.

    The motion of the nominal robot plus noise of each channel is taken as measured, and replayed from its noisy first
    row. ``nominal`` are its motions, where they are known already.
    """
    robot, total = judged.robot, np.zeros(len(judged.logs))
    of_starts = [state_noise(judged, log) for log in range(len(judged.logs))]
    of_rows = judged.noise(judged.channels)
    motions = nominal or replayer.motions([Rollout(log) for log in judged.logs])
    true = [motion[: len(log)] for motion, log in zip(motions, judged.logs, strict=True)]
    for _ in range(draws):
        trials = []
        for log, noise in zip(judged.logs, of_starts, strict=True):
            state = replayer.first_state(Rollout(log))
            trials.append(Rollout(log, first_state=state + rng.standard_normal(len(state)) * noise))
        for j, motion in enumerate(replayer.motions(trials)):
            error = channel_errors(motion, true[j], judged.channels, robot)
            for c, channel in enumerate(judged.channels):
                own = error[:, c] - rng.standard_normal(judged.rows[j]) * of_rows[j][c]
                total[j] += float(((own / channel.scale) ** 2).sum())
    return total / draws


def state_noise(judged: JudgedLogs, log: int, row: int = 0) -> np.ndarray:
    """Noise of the state in a row of a log, (nq + nv,), in the channels of the map and in what was not measured.

    An orientation is disturbed as the imaginary part of its quaternion, for small angles.
    """
    robot = judged.robot
    nq, nv = robot.model.nq, robot.model.nv
    fitted = fitted_noise(judged.logs[log], judged.motions[log], robot, [row])[0]
    found = np.concatenate([np.zeros(nq), fitted[nv:]])
    if robot.has_free_base:
        found[POSITION_SLICE] = fitted[VELOCITY_SLICE]
    for channel, sigma in zip(judged.mapped, judged.noise(judged.mapped)[log], strict=True):
        if channel.entry >= nv:
            found[nq + channel.entry - nv] = sigma
        elif channel.quantity == "base_turn":
            found[QUATERNION_SLICE][1 + BASE_TURNS.index(channel.name)] = sigma / 2
        elif channel.quantity == "base_pos":
            found[channel.entry] = sigma
        else:
            (joint,) = np.flatnonzero(robot.joint_dofs == channel.entry)
            found[robot.joint_qpos[joint]] = sigma
    return found
