"""Effects that the diagnosis has no name and no code for: what an honest answer calls unknown."""

from functools import cache

from leapgap.errors import InputError
from leapgap.simulation.off_table import BentCalf
from leapgap.validation.off_table import loads, measurement, motors, pulls, structure
from leapgap.validation.off_table.base import OffTableEffect

FAMILIES = (pulls, loads, motors, structure, measurement)


@cache
def families() -> dict[str, type[OffTableEffect] | type[BentCalf]]:
    """All of them by name, in alphabetical order."""
    found: dict[str, type[OffTableEffect] | type[BentCalf]] = {BentCalf.name: BentCalf}
    for module in FAMILIES:
        found |= {kind.name: kind for kind in module.KINDS}
    return dict(sorted(found.items()))


def family(name: str) -> type[OffTableEffect] | type[BentCalf]:
    """One of them; an unknown name is an ``InputError``."""
    if name not in families():
        raise InputError("withhold", f"nameless effect {name}", f"one of {', '.join(families())}", "correct the name")
    return families()[name]
