"""Curves of every channel for the page: measured, nominal and corrected, of every log, small enough for one file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from leapgap.diagnosis.channels import is_logged, logged_values
from leapgap.logs.log import Log
from leapgap.robot.model import Robot

MOST_VALUES = 120_000
"""Largest number of values on a page; curves get fewer points where there are more."""
LEAST_INTERVAL_S = 0.004
DIGITS = 4
"""Significant digits of a channel's largest value; the eye sees three in a plot."""
BASE = (
    *("base_pos_x", "base_pos_y", "base_pos_z", "base_roll", "base_pitch", "base_yaw"),
    *("base_linvel_x", "base_linvel_y", "base_linvel_z", "base_angvel_x", "base_angvel_y", "base_angvel_z"),
)
JOINT = ("joint_pos", "joint_vel")


def channel_groups(logs: Sequence[Log], robot: Robot) -> dict[str, list[str]]:
    """Channels that every log has: those of the base, then those of each limb."""
    groups = {"base": list(BASE)}
    for joint in robot.joints:
        groups.setdefault(robot.limb_of(joint), []).extend(f"{quantity}/{joint}" for quantity in JOINT)
    there = {name: [one for one in of if all(is_logged(log, one) for log in logs)] for name, of in groups.items()}
    return {name: of for name, of in there.items() if of}


def channels_data(
    logs: Sequence[Log],
    robot: Robot,
    nominal: Mapping[str, Log],
    corrected: Mapping[str, Log] | None,
    shown: str,
    titles: Any,
) -> dict[str, Any]:
    """All that the page draws: titles and groups of channels, and their curves by log; ``shown`` is the first log."""
    groups = channel_groups(logs, robot)
    channels = [name for of in groups.values() for name in of]
    sources = 3 if corrected else 2
    seconds = sum(len(log) * log.info.sample_period_s for log in logs)
    interval = max(LEAST_INTERVAL_S, seconds * sources * max(1, len(channels)) / MOST_VALUES)
    return {
        "groups": groups,
        "titles": {name: titles(name) for name in channels},
        "shown": shown,
        "logs": {
            log.name: curves(
                log, [nominal[log.name], *([corrected[log.name]] if corrected else [])], channels, interval
            )
            for log in logs
        },
    }


def curves(log: Log, replays: Sequence[Log], channels: Sequence[str], interval_s: float) -> dict[str, Any]:
    """Times, s, and for each channel the values of the log and of its replays; segments by name and beginning."""
    every = log.info.rows(interval_s)
    end = min(len(log), *(len(one) for one in replays))
    return {
        "time": np.round(log.time[:end:every], 4).tolist(),
        "segments": [[one.begin_s, one.name.replace("_", " ")] for one in log.info.segments],
        "channels": {
            name: [rounded(logged_values(one, name)[:end:every]) for one in (log, *replays)] for name in channels
        },
    }


def rounded(values: np.ndarray) -> list[float | None]:
    """Values with ``DIGITS`` digits of the largest one; None where a replay diverged."""
    finite = np.abs(values[np.isfinite(values)])
    largest = finite.max(initial=0.0)
    digits = DIGITS - 1 - int(np.floor(np.log10(largest))) if largest > 0 else 0
    return [float(v) if np.isfinite(v) else None for v in np.round(values, max(digits, 0))]
