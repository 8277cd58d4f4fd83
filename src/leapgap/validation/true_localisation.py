"""True localisation of effects: shares of the squared on/off difference by phase and channel, by the generator."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from leapgap.diagnosis.channels import channel_errors, sensor_noise
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.localisation import least_noise, phase_names, pieces_of
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.simulation.rollout import Rollout
from leapgap.validation.generator import Generator


def true_localisation(
    logs: Sequence[Log], off: Sequence[Rollout], judged: JudgedLogs, generator: Generator, horizon_s: float
) -> list[dict[str, Any]]:
    """Phases and channels with their share of the squared difference, largest first, without shares below 0.001.

    ``off`` are rollouts of the noise-free jumps without the effect. They restart every ``horizon_s`` from the
    noise-free state, as the diagnosis restarts from the log. Only the second half of each piece counts, in units of
    each channel's noise.
    """
    robot, channels, names = generator.robot, judged.mapped, phase_names(logs)
    square = np.zeros((len(names), len(channels)))
    for log, trial, rows in zip(logs, off, judged.rows, strict=True):
        measured = motion_of(log.first_rows(rows), robot)
        noise = sensor_noise(measured, log.info.sample_period_s, channels, robot)
        scale = np.maximum(noise, [least_noise(c) for c in channels])
        pieces = pieces_of(trial.log.first_rows(rows), names, horizon_s)
        motions = generator.motions([replace(trial, log=piece) for piece, *_ in pieces])
        for (piece, phases, _), motion in zip(pieces, motions, strict=True):
            half = len(piece) // 2
            error = channel_errors(motion, motion_of(piece, robot), channels, robot)
            for phase in np.unique(phases[half:]):
                square[phase] += ((error[half:][phases[half:] == phase] / scale) ** 2).sum(axis=0)
    share = square / max(square.sum(), 1e-300)
    fields: list[dict[str, Any]] = [
        {"phase": names[p], "channel": c.name, "share": round(float(share[p, k]), 5)}
        for p in range(len(names))
        for k, c in enumerate(channels)
    ]
    return sorted((f for f in fields if f["share"] >= 0.001), key=lambda f: -f["share"])
