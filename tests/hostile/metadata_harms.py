"""What may be wrong with the metadata of a log."""

import json
from collections.abc import Mapping
from typing import Any

DEEP = '{"robot": ' + "[" * 100_000 + "]" * 100_000 + "}"
JUMP = {"format_version": 1, "terrain": [], "target": {"x_m": 0.6, "z_m": 0.0}}
METADATA: Mapping[str, Any] = {
    "deep": DEEP,
    "no_json": "{",
    "a_list": "[1, 2]",
    "a_number": "7",
    "huge_text": json.dumps({"source": "x" * 2_000_000}),
    "period_true": {"sample_period_s": True},
    "period_text": {"sample_period_s": "0.01"},
    "period_negative": {"sample_period_s": -0.01},
    "period_zero": {"sample_period_s": 0},
    "period_huge": {"sample_period_s": 1e300},
    "period_nan": {"sample_period_s": float("nan")},
    "period_list": {"sample_period_s": [0.01]},
    "period_digits": '{"format_version": 2, "robot": "hopper", "sample_period_s": ' + "9" * 5000 + "}",
    "robot_other": {"robot": "go1"},
    "robot_number": {"robot": 5},
    "robot_null": {"robot": None},
    "robot_long": {"robot": "a" * 100_000},
    "source_object": {"source": {"a": 1}},
    "version_new": {"format_version": 99},
    "version_text": {"format_version": "two"},
    "terrain_nan": {"terrain": [{"x_m": float("nan"), "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}]},
    "terrain_text": {"terrain": "stairs"},
    "terrain_far": {"terrain": [{"x_m": 1e300, "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}]},
    "terrain_negative": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [-1, 1, 1], "top_m": 0}]},
    "terrain_no_size": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [0, 1, 1], "top_m": 0}]},
    "source_escape": {"source": "lab \x1b]0;owned\x07"},
    "robot_two_lines": {"robot": "hopper\nset aside: nothing"},
    "key_escape": {"derived": {"\x1b[2J": "how"}},
    "terrain_flat_size": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": 3, "top_m": 0}]},
    "terrain_many": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [1, 1, 1], "top_m": 0}] * 100_000},
    "terrain_estimated": {"terrain": [{"x_m": 0, "y_m": 0, "size_m": [1, 1, 1], "top_m": 0, "estimated": "maybe"}]},
    "target_text": JUMP
    | {"schedule": {"double_contact_s": 0.4, "rear_contact_s": 0.3, "flight_s": 0.4}, "target": "far"},
    "target_nan": {"target": {"x_m": float("nan"), "z_m": 0}},
    "schedule_text": {"schedule": "soon", "target": {"x_m": 0.6, "z_m": 0}},
    "schedule_texts": {"schedule": {"double_contact_s": "0.4", "rear_contact_s": 0.3, "flight_s": 0.4}},
    "schedule_nan": {"schedule": {"double_contact_s": float("nan"), "rear_contact_s": 0.3, "flight_s": 0.4}},
    "schedule_negative": {"schedule": {"double_contact_s": -3, "rear_contact_s": 0.3, "flight_s": 0.4}},
    "schedule_part": {"schedule": {"double_contact_s": 0.4}},
    "segments_text": {"segments": "all"},
    "segments_backwards": {"segments": [{"name": "a", "begin_s": 1.0, "end_s": 0.5}]},
    "segments_nan": {"segments": [{"name": "a", "begin_s": float("nan"), "end_s": 0.5}]},
    "segments_nameless": {"segments": [{"begin_s": 0, "end_s": 0.5}]},
    "segments_true": {"segments": [{"name": True, "begin_s": 0, "end_s": 0.5}]},
    "derived_list": {"derived": ["all"]},
    "derived_number": {"derived": {"time": 3}},
}
"""Changes to the metadata of a log of ours, or their whole text."""
