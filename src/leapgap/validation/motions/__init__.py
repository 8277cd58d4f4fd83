"""Motions that robots of the benchmark make beside the jumps: a file a kind, found by its class."""

import sys
from functools import cache

from leapgap.registry import classes_by_name
from leapgap.validation.motions.base import PlannedMotion

ENTRY_POINTS = "leapgap.withheld_motions"  # group under which other packages offer kinds of motions


@cache
def known() -> dict[str, type[PlannedMotion]]:
    """All kinds of motions by name."""
    return classes_by_name(sys.modules[__name__], PlannedMotion, ENTRY_POINTS)  # type: ignore[type-abstract]
