"""The noise floor: the gap that sensor noise alone would make between a log and a replay of it."""

from collections.abc import Mapping, Sequence

import numpy as np

from leapgap.diagnosis.channels import scaled_channels, sensor_noise, state_channels
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
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
    robot = replayer.robot
    every = scaled_channels(judged.logs, robot)
    total = np.zeros(len(judged.logs))
    sigma = [dict(zip((c.name for c in every), sensor_noise(log, every), strict=True)) for log in judged.logs]
    motions = nominal or replayer.motions([Rollout(log) for log in judged.logs])
    true = [motion[: len(log)] for motion, log in zip(motions, judged.logs, strict=True)]
    for _ in range(draws):
        trials = []
        for log, own in zip(judged.logs, sigma, strict=True):
            state = replayer.first_state(Rollout(log))
            trials.append(Rollout(log, first_state=state + rng.standard_normal(len(state)) * state_noise(own, robot)))
        for j, motion in enumerate(replayer.motions(trials)):
            for c in judged.channels:
                seen = c.values(true[j], robot) + rng.standard_normal(judged.rows[j]) * sigma[j][c.name]
                total[j] += float((((c.values(motion, robot) - seen) / c.scale) ** 2).sum())
    return total / draws


def state_noise(sigma: Mapping[str, float], robot: Robot) -> np.ndarray:
    """Noise of the first state, (nq + nv,), where it was measured; orientation only in pitch, about y.

    ``sigma`` is the noise of the headline's and the joints' channels by name.
    """
    noise_of = Motion(np.zeros((1, robot.model.nq)), np.zeros((1, robot.model.nv)))
    for channel in state_channels(robot):
        known = float(sigma.get(channel.name, 0.0))
        if channel.name == "base_pitch":
            noise_of.base_quaternion[0, 2] = known / 2
        elif channel.quantity != "base_turn":
            channel.values(noise_of, robot)[:] = known
    return noise_of.first_state
