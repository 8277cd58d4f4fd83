"""The noise floor: the gap that sensor noise alone would make between a log and a replay of it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leapgap.diagnosis.channels import channel_errors
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.restarts import RestartedReplayer
from leapgap.effects.base import Effect
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout


def noise_floor(
    judged: JudgedLogs,
    replayer: Replayer | RestartedReplayer,
    draws: int,
    rng: np.random.Generator,
    motions: Sequence[Motion] | None = None,
    effects: Sequence[tuple[Effect, ...]] | None = None,
) -> np.ndarray:
    """Mean sum of squares that sensor noise alone gives for each log, (logs,), summed over rows and channels.

    The motion of the nominal robot, or of one with ``effects`` on each log, plus noise of each channel is taken as
    measured, and replayed from its noisy first row, or rows where the replayer restarts. ``motions`` are those of that
    robot, where they are known already.
    """
    total, restarted = np.zeros(len(judged.logs)), isinstance(replayer, RestartedReplayer)
    of_rows = judged.noise_in(judged.channels)
    trials = judged.trials(effects)
    motions = motions or replayer.motions(trials)
    true = [motion[:rows] for motion, rows in zip(motions, judged.rows, strict=True)]
    for _ in range(draws):
        for j, motion in enumerate(noisy_replays(judged, replayer, trials, rng)):
            error = channel_errors(motion, true[j], judged.channels, judged.robot)
            of_draw = rng.standard_normal(error.shape if restarted else error.T.shape)
            error -= (of_draw if restarted else of_draw.T) * of_rows[j]
            total[j] += sum(float((column**2).sum()) for column in (error / judged.scales).T)
    return total / draws


def noisy_replays(
    judged: JudgedLogs, replayer: Replayer | RestartedReplayer, trials: Sequence[Rollout], rng: np.random.Generator
) -> list[Motion]:
    """Replays of the judged rows from starts with noise."""
    if isinstance(replayer, Replayer):
        starts = [replayer.first_state(trial) for trial in trials]
        noisy = [start + rng.standard_normal(len(start)) * judged.start_noise(log) for log, start in enumerate(starts)]
        return replayer.motions([replace(trial, first_state=state) for trial, state in zip(trials, noisy, strict=True)])
    of_state = [channel for channel in judged.mapped if channel.is_state]
    steps, entries = [], [channel.entry for channel in of_state]
    for states, sigma, trial in zip(judged.states, judged.noise_in(of_state), trials, strict=True):
        pieces, share = replayer.starts(trial)
        by = states.deviation[list(pieces.rows)]
        by[:, entries] = sigma * share[:, None]
        steps.append(by * rng.standard_normal(by.shape))
    return replayer.motions(trials, steps)
