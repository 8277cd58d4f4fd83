"""Terrain: boxes on the floor."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Box:
    """A block on the floor: centre (x, y), edge lengths and height of the upper face, m, world frame."""

    x_m: float
    y_m: float
    size_m: tuple[float, float, float]
    top_m: float
    estimated: bool = False
    """True where the height was inferred from the log, not measured."""
