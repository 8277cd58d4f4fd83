"""Off-table effects: the diagnosis has no hypothesis for them, so the right verdict is ``unknown``."""

import sys
from functools import cache

from leapgap.errors import InputError
from leapgap.registry import classes_by_name
from leapgap.simulation.presets import BentCalf
from leapgap.validation.off_table.base import OffTableEffect

ENTRY_POINTS = "leapgap.off_table_effects"  # group under which other packages offer further ones


@cache
def families() -> dict[str, type[OffTableEffect] | type[BentCalf]]:
    """All off-table effects by name, in alphabetical order."""
    by_name: dict[str, type[OffTableEffect] | type[BentCalf]] = {BentCalf.name: BentCalf}
    by_name |= classes_by_name(sys.modules[__name__], OffTableEffect, ENTRY_POINTS)
    return dict(sorted(by_name.items()))


def family(name: str) -> type[OffTableEffect] | type[BentCalf]:
    """The off-table effect of this name; an unknown name is an ``InputError``."""
    if name not in families():
        raise InputError("withhold", f"off-table effect {name}", f"one of {', '.join(families())}", "correct the name")
    return families()[name]
