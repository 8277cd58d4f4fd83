"""What logs say of a robot's numbers without a simulation: evidence. A file a kind, found by its class."""

import sys
from collections.abc import Sequence
from functools import cache

from leapgap.diagnosis.evidence.base import Evidence, Source
from leapgap.logs.log import Log
from leapgap.registry import classes_by_name
from leapgap.robot.model import Robot

ENTRY_POINTS = "leapgap.evidence"  # Group under which other packages offer sources of evidence


@cache
def known() -> tuple[type[Source], ...]:
    """All sources of evidence, by place and name."""
    kinds = classes_by_name(sys.modules[__name__], Source, ENTRY_POINTS)  # type: ignore[type-abstract]
    return tuple(kinds[name] for name in sorted(kinds, key=lambda name: (kinds[name].place, name)))


def gather(logs: Sequence[Log], robot: Robot) -> list[Evidence]:
    """What all sources say of these logs; a source whose columns are missing says nothing."""
    told: list[Evidence] = []
    for kind in known():
        told += kind().gather(logs, robot, told)
    return told
