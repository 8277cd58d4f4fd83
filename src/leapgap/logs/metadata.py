"""Named segments of a log, and its metadata as JSON text: bounded in size, every entry of its type and in its range."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leapgap.errors import CONTROL, InputError

ROUNDING_S = 1e-6  # times this near to a boundary are on it, so that 0.8 written as 8 × 0.1 does not fall before 0.8
LIFT_OFF_WINDOW_S = 0.050  # half width of a jump's segment ``lift_off`` about its planned take-off, s
PHASE_LENGTHS = ("double_contact_s", "rear_contact_s", "flight_s")  # what the schedule of a jump states
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


def equal_segments(duration_s: float) -> tuple[Segment, ...]:
    """Four equal parts of a time, for a log that states no segments; the last is open at its end."""
    bounds = np.linspace(0, duration_s, 5)[:-1].tolist()
    ends = [*bounds[1:], math.inf]
    return tuple(Segment(f"part_{k + 1}", begin, end) for k, (begin, end) in enumerate(zip(bounds, ends, strict=True)))


def contact_segments(time_s: np.ndarray, contact: np.ndarray, feet: Sequence[str]) -> tuple[Segment, ...]:
    """Runs of rows with the same feet in contact (bool, (rows, feet)), named by these feet: ``FL+RR``."""
    begins = np.flatnonzero(np.concatenate([[True], (contact[1:] != contact[:-1]).any(axis=1)]))
    ends = [*time_s[begins[1:]].tolist(), math.inf]
    found = []
    for row, end in zip(begins, ends, strict=True):
        touching = [foot for foot, touches in zip(feet, contact[row], strict=True) if touches]
        name = "all_feet" if len(touching) == len(feet) else "+".join(touching) or "no_foot"
        found.append(Segment(name, float(time_s[row]), end))
    return tuple(found)


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


MOST_CHARACTERS, LONGEST_TEXT = 1_000_000, 10_000
DEEPEST, MOST_BOXES, MOST_SEGMENTS = 10, 100, 10_000
SHORTEST_PERIOD_S, LONGEST_PERIOD_S, LONGEST_S = 1e-7, 0.5, 1e7
"""Rows that are longer on average are those of no loop of a robot: the unit of the time is another."""
SMALLEST_M, FARTHEST_M, HEAVIEST_KG = 1e-4, 1e5, 1e4
DO = "correct the metadata, or import the log again"


def read_metadata(text: str | bytes, where: object) -> dict[str, Any]:
    """The metadata of a log from their JSON text, checked; ``InputError`` names the entry."""
    if len(text) > MOST_CHARACTERS:
        raise InputError(where, f"metadata of {len(text)} characters", f"at most {MOST_CHARACTERS}", DO)
    try:
        stated = json.loads(text)
    except RecursionError:
        raise InputError(where, "metadata nested too deep to be read", f"at most {DEEPEST} levels", DO) from None
    if not isinstance(stated, dict):
        raise InputError(where, f"metadata that are no object but {kind_of(stated)}", "a JSON object", DO)
    check_contents(stated, where)
    check_entries(stated, f"{where}, metadata")
    return stated


def check_contents(stated: Mapping[str, Any], where: object) -> None:
    """Few levels of mappings and lists, counted without recursion, and no control characters in any key or text.

    Texts are printed, and written into pages.
    """
    level, levels = [stated], -1
    while level:
        for value in level:
            if isinstance(value, str) and CONTROL.search(value):
                expected = "printable characters, on one line"
                raise InputError(f"{where}, metadata", f"the text {value[:60]}", expected, DO)
        inner = [
            (*one, *one.values()) if isinstance(one, dict) else one for one in level if isinstance(one, dict | list)
        ]
        level, levels = [item for one in inner for item in one], levels + 1
    if levels > DEEPEST:
        raise InputError(where, f"metadata of {levels} levels", f"at most {DEEPEST} levels", DO)


def check_entries(stated: Mapping[str, Any], where: str) -> None:
    """Check type and range of the known entries, as far as they are there."""
    for key in ("robot", "source"):
        if key in stated:
            check_text(stated[key], f"{where}, {key}")
    if "sample_period_s" in stated:
        check_number(stated["sample_period_s"], SHORTEST_PERIOD_S, LONGEST_PERIOD_S, "s", f"{where}, sample_period_s")
    for number, box in enumerate(entries(stated, "terrain", MOST_BOXES, where)):
        check_box(box, f"{where}, terrain[{number}]")
    for number, segment in enumerate(entries(stated, "segments", MOST_SEGMENTS, where)):
        check_segment(segment, f"{where}, segments[{number}]")
    for key, names, low, high, unit in (
        ("schedule", PHASE_LENGTHS, 0.0, LONGEST_S, "s"),
        ("target", ("x_m", "z_m"), -FARTHEST_M, FARTHEST_M, "m"),
    ):
        found = mapping(stated, key, where)
        for name in (name for name in names if name in found):
            check_number(found[name], low, high, unit, f"{where}, {key}.{name}")
    for joint, mass in mapping(stated, "load", where).items():
        check_number(mass, 0.0, HEAVIEST_KG, "kg", f"{where}, load.{joint}")
    for quantity, how in mapping(stated, "derived", where).items():
        check_text(how, f"{where}, derived.{quantity}")


def check_box(box: Any, where: str) -> None:
    """Check one box of the terrain."""
    if not isinstance(box, Mapping) or not isinstance(box.get("size_m"), list) or len(box["size_m"]) != 3:
        raise InputError(where, kind_of(box), "a box with three lengths size_m", DO)
    for key in ("x_m", "y_m", "top_m"):
        check_number(box.get(key), -FARTHEST_M, FARTHEST_M, "m", f"{where}.{key}")
    for length in box["size_m"]:
        check_number(length, SMALLEST_M, FARTHEST_M, "m", f"{where}.size_m")
    if not isinstance(box.get("estimated", False), bool):
        raise InputError(f"{where}.estimated", kind_of(box["estimated"]), "true or false", DO)


def check_segment(segment: Any, where: str) -> None:
    """Check one named interval; only its end may be infinite."""
    if not isinstance(segment, Mapping):
        raise InputError(where, kind_of(segment), "a name with begin_s and end_s", DO)
    check_text(segment.get("name"), f"{where}.name")
    check_number(segment.get("begin_s"), 0.0, LONGEST_S, "s", f"{where}.begin_s")
    if segment.get("end_s") != math.inf:
        check_number(segment.get("end_s"), segment["begin_s"], LONGEST_S, "s", f"{where}.end_s")


def mapping(stated: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """An entry that is a mapping; empty where there is none."""
    found = stated.get(key)
    if found is None:
        return {}
    if not isinstance(found, Mapping):
        raise InputError(f"{where}, {key}", kind_of(found), "a JSON object", DO)
    return found


def entries(stated: Mapping[str, Any], key: str, most: int, where: str) -> list[Any]:
    """An entry that is a list; empty where there is none."""
    found = stated.get(key) or []
    if not isinstance(found, list) or len(found) > most:
        number = f"{len(found)} items" if isinstance(found, list) else kind_of(found)
        raise InputError(f"{where}, {key}", number, f"a list of at most {most}", DO)
    return found


def check_text(value: Any, where: str) -> None:
    """Check that a value is a text of at most ``LONGEST_TEXT`` characters."""
    if not isinstance(value, str) or len(value) > LONGEST_TEXT:
        found = f"a text of {len(value)} characters" if isinstance(value, str) else kind_of(value)
        raise InputError(where, found, f"a text of at most {LONGEST_TEXT} characters", DO)


def check_number(value: Any, low: float, high: float, unit: str, where: str) -> None:
    """Check that a value is a number, and no truth value, in a range."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(where, kind_of(value), f"a number from {low:g} to {high:g} {unit}", DO)


def kind_of(value: Any) -> str:
    """A value in words, shortened."""
    words = {"dict": "an object", "list": "a list"}
    return words.get(type(value).__name__) or json.dumps(value)[:60]
