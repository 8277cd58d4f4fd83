"""Named hardware variants: effects of a simulated robot that its controller does not know, some drawn at random."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect, parameter
from leapgap.effects.contacts import foot_geoms
from leapgap.errors import InputError
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class BentCalf(Effect):
    """A calf bent in a fall: the foot sits off the line that the encoders are read with, along the calf's x axis."""

    name = "bent_calf"
    places = "feet"

    offset_m: float = parameter(0.0, "m", -0.03, 0.03)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Move the feet at the location."""
        model.geom_pos[foot_geoms(model, robot, self.location), 0] += self.offset_m


NAMELESS: dict[str, type[Effect]] = {BentCalf.name: BentCalf}


@dataclass(frozen=True)
class Variant:
    """A simulated robot: entries as of ``effects.from_config``; a value ``[low, high]`` is drawn evenly between."""

    effects: Sequence[Mapping[str, Any]] = ()
    nameless: Sequence[Mapping[str, Any]] = field(default_factory=tuple)  # the same for effects that no diagnosis knows

    def draw(self, seed: int) -> tuple[Effect, ...]:
        """Effects of the robot with this seed; the same seed gives the same robot."""
        rng = np.random.default_rng(seed)
        known = effects.from_config([draw_values(entry, rng) for entry in self.effects])
        return (*known, *(nameless(draw_values(entry, rng)) for entry in self.nameless))


def draw_values(entry: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The entry with each range replaced by a value from it."""
    return {
        key: float(rng.uniform(*value)) if isinstance(value, Sequence) and not isinstance(value, str) else value
        for key, value in entry.items()
    }


def nameless(entry: Mapping[str, Any]) -> Effect:
    """One effect outside the table, by its name in the configuration."""
    values = dict(entry)
    name = values.pop("name", "")
    if name not in NAMELESS:
        raise InputError("nameless effect", name, f"one of {', '.join(NAMELESS)}", "choose one that there is")
    return NAMELESS[name](**values)
