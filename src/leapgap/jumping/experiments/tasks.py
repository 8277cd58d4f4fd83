"""Tasks: the target of each jump, and the ground it starts from."""

from dataclasses import dataclass

import numpy as np

from leapgap.effects import effect
from leapgap.effects.base import Effect
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.task import Target
from leapgap.logs.pair_force import FORCE_X
from leapgap.robot.model import Robot
from leapgap.robot.terrain import Box
from leapgap.robot.topology import PAIRS
from leapgap.simulation.closed_loop import Disturbance

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
    rear_block_m: tuple[float, float] = (0.0, 0.0)
    """The same as ``block_m`` under the rear feet."""
    stance_is_seen: bool = True
    """Whether a robot can measure the ground it stands on before it jumps; else all methods take it for level."""
    crouch_error_rad: float = 0.0
    """Largest error of the joints in the crouch before the jump, drawn evenly for thighs and calves of each pair."""
    kick_m_s: float = 0.0
    """Sudden change of the forward velocity, forward or back, once in the jump."""
    kick_rad_s: float = 0.0
    """The same of the pitch rate."""
    push_n: tuple[float, float] = (0.0, 0.0)
    """Range of a horizontal force on the trunk, forward or back, once in the jump."""
    push_s: float = 0.1
    """How long that force lasts."""
    disturbed_at_s: tuple[float, ...] = (0.3, 0.4)
    """Times since the start of the jump, one of which is drawn for a kick or a push."""

    def __post_init__(self) -> None:
        """Refuse a task without a jump."""
        if self.jumps < 1:
            raise ValueError(f"jumps {self.jumps}: 1 or more")

    @property
    def target(self) -> Target:
        """Target of each jump, from its own take-off pose."""
        return Target(self.x_m, self.z_m)

    def start_block(self, rng: np.random.Generator) -> float:
        """Draw the height of the block under the front feet, m."""
        return round(float(rng.uniform(*self.block_m)), 4)

    def rear_start_block(self, rng: np.random.Generator) -> float:
        """Draw the height of the block under the rear feet, m; without one, nothing is drawn."""
        return round(float(rng.uniform(*self.rear_block_m)), 4) if self.rear_block_m[1] > 0 else 0.0

    def crouch_error(self, robot: Robot, rng: np.random.Generator) -> tuple[float, ...]:
        """Draw the error of each joint in the crouch, (joints,), rad, equal left and right; empty without an error."""
        if self.crouch_error_rad == 0:
            return ()
        error = np.zeros(len(robot.joints))
        for pair in PAIRS:
            for group in ("thigh", "calf"):
                joints = np.intersect1d(robot.joints_at(pair), robot.joints_at(group))
                error[joints] = round(float(rng.uniform(-1, 1)) * self.crouch_error_rad, 4)
        return tuple(float(value) for value in error)

    def disturbances(self, rng: np.random.Generator) -> tuple[Disturbance, ...]:
        """Draw one of the kinds of disturbance that the task has, its time and its direction."""
        kinds = [kind for kind in ("kick_m_s", "kick_rad_s") if getattr(self, kind) > 0]
        kinds += ["push_n"] if self.push_n[1] > 0 else []
        if not kinds:
            return ()
        kind, begin_s = str(rng.choice(kinds)), float(rng.choice(self.disturbed_at_s))
        sign = float(rng.choice([-1.0, 1.0]))
        if kind == "push_n":
            force = sign * round(float(rng.uniform(*self.push_n)), 2)
            return (Disturbance(begin_s, force_n=(force, 0.0), duration_s=self.push_s),)
        size = sign * float(getattr(self, kind))
        return (Disturbance(begin_s, velocity=(size, 0.0, 0.0) if kind == "kick_m_s" else (0.0, 0.0, size)),)

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
