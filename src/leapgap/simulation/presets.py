"""Named hardware: which effects a simulated robot has that its controller does not know, some of them drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.simulation.off_table import BentCalf

NAMELESS: dict[str, type[Effect]] = {BentCalf.name: BentCalf}


@dataclass(frozen=True)
class Variant:
    """A simulated robot: entries as of ``effects.from_config``; a value ``[low, high]`` is drawn evenly between."""

    effects: Sequence[Mapping[str, Any]] = ()
    nameless: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    """The same for effects that no diagnosis knows."""

    def drawn(self, seed: int) -> tuple[Effect, ...]:
        """The effects of the robot of this number; the same number is the same robot."""
        rng = np.random.default_rng(seed)
        known = effects.from_config([with_drawn_values(entry, rng) for entry in self.effects])
        return (*known, *(nameless(with_drawn_values(entry, rng)) for entry in self.nameless))


def with_drawn_values(entry: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The entry with each range replaced by a value from it."""
    return {
        key: float(rng.uniform(*value)) if isinstance(value, Sequence) and not isinstance(value, str) else value
        for key, value in entry.items()
    }


def nameless(entry: Mapping[str, Any]) -> Effect:
    """One effect without a name, by the name it has in configuration."""
    values = dict(entry)
    name = values.pop("name", "")
    if name not in NAMELESS:
        raise InputError("nameless effect", name, f"one of {', '.join(NAMELESS)}", "choose one that there is")
    return NAMELESS[name](**values)
