"""Off-table effects: the diagnosis has no hypothesis for them, so the right verdict is ``unknown``."""

from functools import cache

from leapgap.errors import InputError
from leapgap.simulation.off_table import BentCalf
from leapgap.validation.off_table import crosstalk, loads, measurement, motors, pulls, structure
from leapgap.validation.off_table.base import OffTableEffect

FAMILIES = (pulls, loads, motors, crosstalk, structure, measurement)


@cache
def families() -> dict[str, type[OffTableEffect] | type[BentCalf]]:
    """All off-table effects by name, in alphabetical order."""
    by_name: dict[str, type[OffTableEffect] | type[BentCalf]] = {BentCalf.name: BentCalf}
    for module in FAMILIES:
        by_name |= {kind.name: kind for kind in module.KINDS}
    return dict(sorted(by_name.items()))


def family(name: str) -> type[OffTableEffect] | type[BentCalf]:
    """The off-table effect of this name; an unknown name is an ``InputError``."""
    if name not in families():
        raise InputError("withhold", f"off-table effect {name}", f"one of {', '.join(families())}", "correct the name")
    return families()[name]
