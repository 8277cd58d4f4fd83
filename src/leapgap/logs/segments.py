"""Segments: named intervals of a log, such as the phases of a jump, in which errors are counted apart."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

ROUNDING_S = 1e-6
"""Times this near to a boundary count as on it, so that 0.8 written as 8 × 0.1 does not fall before 0.8."""
LIFT_OFF_WINDOW_S = 0.050
"""Half width of a jump's segment ``lift_off`` about its planned take-off, s."""
PHASE_LENGTHS = ("double_contact_s", "rear_contact_s", "flight_s")
"""What the schedule of a jump states."""
FLIGHT, TOUCH_DOWN = "flight", "touch_down"
"""Names of segments that mean something to the diagnosis: a log that has both is judged up to its touch-down."""


@dataclass(frozen=True)
class Segment:
    """One interval of a log: from its begin up to, and without, its end; s, by the log's time."""

    name: str
    begin_s: float
    end_s: float


def jump_segments(schedule: Mapping[str, float]) -> tuple[Segment, ...]:
    """Segments of a jump with a planned schedule: lengths of the phases on all feet, on the rear feet and in flight, s.

    Version 1 of the format knew no other motion, so that its logs state the schedule and not the segments.
    """
    on_all_feet, on_rear_feet, in_air = (float(schedule[length]) for length in PHASE_LENGTHS)
    lift_off = on_all_feet
    take_off = lift_off + on_rear_feet
    landing = take_off + in_air
    names = ("double_contact", "rear_contact", "lift_off", FLIGHT, TOUCH_DOWN)
    ends = (lift_off, take_off - LIFT_OFF_WINDOW_S, take_off + LIFT_OFF_WINDOW_S, landing, math.inf)
    return tuple(Segment(*each) for each in zip(names, (0.0, *ends[:-1]), ends, strict=True))


def equal_segments(duration_s: float, number: int = 4) -> tuple[Segment, ...]:
    """Equal parts of a time, for a log that states no segments; the last is open at its end."""
    bounds = np.linspace(0, duration_s, number + 1)[:-1].tolist()
    ends = [*bounds[1:], math.inf]
    return tuple(Segment(f"part_{k + 1}", begin, end) for k, (begin, end) in enumerate(zip(bounds, ends, strict=True)))


def contact_segments(time_s: np.ndarray, contact: np.ndarray, feet: Sequence[str]) -> tuple[Segment, ...]:
    """Runs of rows with the same feet in contact (bool, (rows, feet)), named by these feet."""
    begins = np.flatnonzero(np.concatenate([[True], (contact[1:] != contact[:-1]).any(axis=1)]))
    ends = [*time_s[begins[1:]].tolist(), math.inf]
    return tuple(
        Segment(name_of_stance(contact[row], feet), float(time_s[row]), end)
        for row, end in zip(begins, ends, strict=True)
    )


def name_of_stance(contact: np.ndarray, feet: Sequence[str]) -> str:
    """Name of a set of feet in contact: ``all_feet``, ``no_foot``, or ``FL+RR``."""
    if contact.all():
        return "all_feet"
    return "+".join(foot for foot, touches in zip(feet, contact, strict=True) if touches) or "no_foot"


def segment_of_rows(segments: Sequence[Segment], time_s: np.ndarray) -> np.ndarray:
    """Index of the segment of each row, (rows,); −1 outside of all; where segments overlap the later begin counts."""
    found = np.full(len(time_s), -1)
    time_s = time_s + ROUNDING_S
    for k, segment in sorted(enumerate(segments), key=lambda one: one[1].begin_s):
        found[(time_s >= segment.begin_s) & (time_s < segment.end_s)] = k
    return found


def runs_of(rows: np.ndarray) -> list[slice]:
    """All unbroken runs of rows (bool) that are true, in their order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(int)))
    return [slice(int(begin), int(end)) for begin, end in zip(edges[::2], edges[1::2], strict=True)]
