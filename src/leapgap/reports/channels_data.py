"""Every channel for the page: its name, and measured, nominal and corrected values of every log, in one small file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from leapgap.diagnosis.channels import JUMP, is_logged, logged_values
from leapgap.diagnosis.report import ReportContent
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.logs.schema import QUANTITIES, quantity_of
from leapgap.robot.model import Robot

LABELS = {
    "base_pos_x": "forward x",
    "base_pos_y": "sideways y",
    "base_pos_z": "height z",
    "base_roll": "roll",
    "base_pitch": "pitch (nose down)",
    "base_yaw": "yaw",
    "base_linvel_x": "forward velocity",
    "base_linvel_y": "sideways velocity",
    "base_linvel_z": "vertical velocity",
    "base_angvel_x": "roll rate",
    "base_angvel_y": "pitch rate",
    "base_angvel_z": "yaw rate",
    "imu_acc_x": "acceleration x of the IMU",
    "imu_acc_y": "acceleration y of the IMU",
    "imu_acc_z": "acceleration z of the IMU",
}
JOINT_WORDS = {"joint_pos": "position", "joint_vel": "velocity", "foot_force": "force"}


def row_of(channel: str, robot: Robot) -> str:
    """Label of a channel's row in the map, such as ``forward x`` or ``rear calf velocity``.

    A joint channel is named by the pair of its leg, its joint group and its quantity. Where the legs are not two pairs,
    the name of the limb stands in place of the pair.
    """
    quantity, _, joint = channel.partition("/")
    if quantity == "foot_force":
        return f"{joint} foot {JOINT_WORDS[quantity]}"
    group = next((name for name, alike in robot.topology.groups.items() if joint in alike), None)
    if group is None:
        return channel_words(channel)
    limb = robot.limb_of(joint)
    pair = next((name for name, limbs in robot.limbs_of_pair.items() if limb in limbs), limb)
    return f"{pair} {group} {JOINT_WORDS[quantity]}"


def channel_title(channel: str) -> str:
    """Label and unit of a channel, such as ``height z, m`` or ``elbow velocity, rad/s``."""
    return f"{channel_words(channel)}, {unit_of(channel)}"


def unit_of(channel: str) -> str:
    """Unit of a channel; roll, pitch and yaw are no quantities of a log."""
    known = QUANTITIES.get(channel.partition("/")[0]) or quantity_of(channel)
    return known.unit if known else "rad"


def channel_words(channel: str) -> str:
    """Label of a channel, such as ``height z`` or ``elbow velocity``."""
    if channel in LABELS:
        return LABELS[channel]
    quantity, _, joint = channel.partition("/")
    return f"{joint} {JOINT_WORDS[quantity]}"


MOST_VALUES = 120_000  # largest number of values on a page; curves get fewer points where there are more
LEAST_INTERVAL_S = 0.004
DIGITS = 4  # significant digits of the largest difference of a replay from its log; the eye sees three in a plot
LARGEST, MOST_FIRST = "largest errors", 6  # name of the group that is shown first, and its number of channels
BASE = (
    *("base_pos_x", "base_pos_y", "base_pos_z", "base_roll", "base_pitch", "base_yaw"),
    *("base_linvel_x", "base_linvel_y", "base_linvel_z", "base_angvel_x", "base_angvel_y", "base_angvel_z"),
)
JOINT = ("joint_pos", "joint_vel")


def channels_data(
    report: ReportContent,
    logs: Sequence[Log],
    robot: Robot,
    nominal: Mapping[str, Log],
    corrected: Mapping[str, Log] | None,
) -> dict[str, Any]:
    """All that the page draws: titles and groups of channels, and their curves and noise by log."""
    # Channels that every log has: those of the base, then those of each limb
    groups = {"base": list(BASE)}
    for joint in robot.joints:
        groups.setdefault(robot.limb_of(joint), []).extend(f"{quantity}/{joint}" for quantity in JOINT)
    there = {name: [one for one in of if all(is_logged(log, one) for log in logs)] for name, of in groups.items()}
    groups = {name: of for name, of in there.items() if of}
    channels = [name for of in groups.values() for name in of]
    # The channels to show first: those of the headline of jumps, else those with the largest shares of the gap
    known = {channel for of in groups.values() for channel in of}
    wanted = JUMP if report.headline.preset == "jump" else dict.fromkeys(place.channel for place in report.where)
    first = [channel for channel in wanted if channel in known][:MOST_FIRST]
    sources = 3 if corrected else 2
    seconds = sum(len(log) * log.info.sample_period_s for log in logs)
    interval = max(LEAST_INTERVAL_S, seconds * sources * max(1, len(channels)) / MOST_VALUES)
    return {
        "groups": ({LARGEST: first} if first else {}) | groups,
        "titles": {name: channel_title(name) for name in channels},
        "shown": report.median_log,
        "logs": {
            log.name: curves(
                log, [nominal[log.name], *([corrected[log.name]] if corrected else [])], channels, interval
            )
            for log in logs
        },
    }


def curves(log: Log, replays: Sequence[Log], channels: Sequence[str], interval_s: float) -> dict[str, Any]:
    """Times, s, and for each channel the values of the log and of its replays, and the noise of its sensor.

    Segments are given by name and beginning.
    """
    every = log.info.rows(interval_s)
    end = min(len(log), *(len(one) for one in replays))
    steps = np.diff(np.stack([logged_values(log, name) for name in channels], axis=1), axis=0)
    noise = noise_of(steps, log.info.sample_period_s, log.uneven_steps)
    return {
        "time": np.round(log.time[:end:every], 4).tolist(),
        "segments": [[one.begin_s, one.name.replace("_", " ")] for one in log.info.segments],
        "noise": {name: float(f"{own:.3g}") for name, own in zip(channels, noise, strict=True)},
        "channels": {
            name: together([logged_values(one, name)[:end:every] for one in (log, *replays)]) for name in channels
        },
    }


def together(sources: Sequence[np.ndarray]) -> list[list[float | None]]:
    """Values of a log and of its replays, with ``DIGITS`` digits of their differences; None where a replay diverged."""
    measured, *replays = sources
    differences = np.abs(np.concatenate([replay - measured for replay in replays]))
    largest, found = float(differences[np.isfinite(differences)].max(initial=0.0)), []
    for values in sources:
        size = largest or float(np.abs(values[np.isfinite(values)]).max(initial=0.0))
        digits = DIGITS - 1 - int(np.floor(np.log10(size))) if size > 0 else 0
        found.append([float(v) if np.isfinite(v) else None for v in np.round(values, max(digits, 0))])
    return found
