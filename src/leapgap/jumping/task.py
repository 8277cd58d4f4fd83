"""A jump as a task: contact schedule, target, joint gains; and where the metadata of a log hold schedule and target."""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.metadata import ROUNDING_S, Segment, jump_segments

STAND = "stand"  # Segment of a log before its first jump begins


@dataclass(frozen=True)
class ContactSchedule:
    """Lengths of the phases of a jump, s, in their order.

    The published jumps use 500/300/400 ms: all feet (until the front pair lifts off), rear feet, none.
    """

    double_contact_s: float = 0.5
    rear_contact_s: float = 0.3
    flight_s: float = 0.4

    @property
    def take_off_s(self) -> float:
        """When the rear pair leaves the ground too, and flight begins."""
        return self.double_contact_s + self.rear_contact_s

    @property
    def landing_s(self) -> float:
        """End of the scheduled flight: where the landing error is read."""
        return self.take_off_s + self.flight_s

    def in_contact(self, time_s: np.ndarray) -> np.ndarray:
        """Planned contact of the (front, rear) pair; shape ``time_s.shape + (2,)``, bool.

        A phase holds its first instant and not its last; times within a microsecond of a boundary count
        as on it, so that 0.8 written as 8 × 0.1 does not push one tick too long.
        """
        t = np.asarray(time_s, dtype=float) + 1e-6
        return np.stack([t < self.double_contact_s, t < self.take_off_s], axis=-1)

    def pairs_in_contact(self, time_s: float) -> tuple[bool, bool]:
        """``in_contact`` of the front and the rear pair at one moment."""
        t = time_s + 1e-6
        return t < self.double_contact_s, t < self.take_off_s


@dataclass(frozen=True)
class Target:
    """Where the jump was meant to land, relative to its start, m."""

    x_m: float
    z_m: float = 0.0


@dataclass(frozen=True)
class JointGains:
    """Gains of the joint PD controller."""

    kp_nm_per_rad: float = 300.0
    kd_nms_per_rad: float = 3.0

    def __post_init__(self) -> None:
        if not all(0 <= gain < np.inf for gain in (self.kp_nm_per_rad, self.kd_nms_per_rad)):
            raise ValueError("gains finite and not below 0")


SCHEDULE, TARGET = "schedule", "target"  # Keys of a jump in the metadata of its log


def metadata_of(schedule: ContactSchedule, target: Target) -> dict[str, Any]:
    """A jump's part of the metadata of its log."""
    return {SCHEDULE: asdict(schedule), TARGET: asdict(target)}


def of_latest_jump(time_s: np.ndarray, begins_s: Sequence[float]) -> np.ndarray:
    """Time since the latest of some jumps began, s; before all of them, until the first begins (negative)."""
    begins, times = np.array(begins_s, dtype=float), np.asarray(time_s, dtype=float)
    latest = np.searchsorted(begins, times + ROUNDING_S, side="right") - 1
    return np.asarray(times - begins[np.maximum(latest, 0)])


def planned_segments(schedule: ContactSchedule, begins_s: Sequence[float], end_s: float) -> tuple[Segment, ...]:
    """Planned phases of jumps that begin at some times, s, each up to the next, the last up to ``end_s``.

    Before the first the robot stands.
    """
    found = [Segment(STAND, 0.0, begins_s[0])] if begins_s[0] > 0 else []
    for begin_s, next_s in itertools.pairwise([*begins_s, end_s]):
        own = [Segment(one.name, one.begin_s + begin_s, one.end_s + begin_s) for one in jump_segments(asdict(schedule))]
        found += [replace(one, end_s=min(one.end_s, next_s)) for one in own if one.begin_s < next_s]
    return tuple(found)


def jump_info(
    robot: str, sample_period_s: float, schedule: ContactSchedule, target: Target, source: str, **others: Any
) -> LogInfo:
    """Metadata of the log of a jump; ``others`` are further fields of ``LogInfo``."""
    return LogInfo(robot, sample_period_s, source, extra=metadata_of(schedule, target), **others)


def schedule_of(jump: Log) -> ContactSchedule:
    """The planned phases of a jump; ``InputError`` for a log that states none."""
    return ContactSchedule(**stated(jump, SCHEDULE))


def begin_of(jump: Log) -> float:
    """Time from the first row to the begin of the first jump, s; 0 where the log states no stand before it."""
    segments = jump.info.stated_segments
    return segments[0].end_s if segments and segments[0].name == STAND else 0.0


def target_of(jump: Log) -> Target:
    """Where a jump was meant to land; ``InputError`` for a log that states no target."""
    return Target(**stated(jump, TARGET))


def stated(jump: Log, key: str) -> dict[str, float]:
    """One part of a jump's metadata."""
    if key not in jump.info.extra:
        expected = "the log of a jump (docs/reference/log_format.md)"
        raise InputError(jump.name, f"no {key} in its metadata", expected, "state it")
    return dict(jump.info.extra[key])
