"""Tasks: the target of each jump, and the ground it starts from."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects import effect
from leapgap.effects.base import Effect
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.task import Target
from leapgap.logs.pair_force import FORCE_X
from leapgap.robot.terrain import Box

BLOCK_EDGES_M = (0.24, 0.6)
"""Edges of a block on uneven ground along x and y; both feet of a pair fit on one."""


@dataclass(frozen=True)
class JumpTask:
    """One or several jumps in a row, each from where the last one ended."""

    name: str
    x_m: float
    z_m: float = 0.0
    jumps: int = 1
    block_m: tuple[float, float] = (0.0, 0.0)
    """Range of the height of the block under the front feet at the start, drawn evenly. It should exceed 4 mm:
    soft feet sink in that far, and a foot would stand on block and floor at once."""
    slope_rad: tuple[float, float] = (0.0, 0.0)
    """Range of the slope of the whole ground, drawn evenly; positive falls away forward."""
    uneven_m: tuple[float, float] = (0.0, 0.0)
    """Range of the height of the blocks that feet land on between the jumps, drawn evenly; 0: flat ground."""

    @property
    def target(self) -> Target:
        """Target of each jump, from its own take-off pose."""
        return Target(self.x_m, self.z_m)

    def start_block(self, rng: np.random.Generator) -> float:
        """Draw the height of the block under the front feet, m."""
        return round(float(rng.uniform(*self.block_m)), 4)

    def tilt(self, rng: np.random.Generator) -> tuple[Effect, ...]:
        """Draw the slope of the ground, as an effect; none where it is zero."""
        slope_rad = round(float(rng.uniform(*self.slope_rad)), 5)
        return (effect("ground_slope", pitch_rad=slope_rad),) if slope_rad else ()

    def ground(self, reference: Reference, rng: np.random.Generator) -> tuple[Box, ...]:
        """Draw one block for each landing between the jumps, near the planned place of the front or the rear feet."""
        if self.uneven_m[1] == 0:
            return ()
        front, rear = reference.foot[0, FORCE_X]
        boxes = []
        for jump in range(1, self.jumps):
            height = round(float(rng.uniform(*self.uneven_m)), 4)
            under = float(rng.choice([front, rear]))
            x = round(jump * self.x_m + under + float(rng.uniform(-0.03, 0.03)), 4)
            boxes.append(Box(x, 0.0, (*BLOCK_EDGES_M, height), height))
        return tuple(boxes)
