"""Settings of the MPC, and the weights of its cost."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.guarded_solve import SolutionRequirements
from leapgap.jumping.control.qp import QpConfig
from leapgap.jumping.learning.windows import TimeGrid


@dataclass(frozen=True)
class StateWeights:
    """Diagonal of Q: how much a deviation from the reference costs, by state; as used on the robot."""

    x: float = 50.0
    z: float = 2.5
    pitch: float = 50.0
    vx: float = 10.0
    vz: float = 0.2
    pitch_rate: float = 10.0

    @property
    def diagonal(self) -> np.ndarray:
        """The weights in the order of the state, (6,)."""
        return np.array([self.x, self.z, self.pitch, self.vx, self.vz, self.pitch_rate])


@dataclass(frozen=True)
class MpcConfig:
    """Settings of the MPC, as published."""

    grid: TimeGrid = field(default_factory=TimeGrid)
    period_s: float = 0.025
    """Time between updates; the first force is held in between."""
    weights: StateWeights = field(default_factory=StateWeights)
    landing_weights: StateWeights | None = None
    """In place of ``weights`` at the planned landing, where the horizon reaches it; None: the same there."""
    force_weight: float = 1e-6
    """Cost of a force's difference from the reference, per N²."""
    to_expected: bool = False
    """Whether the MPC aims at what a model of the deviation expects of the plan alone, not at the plan: the goal was
    chosen for that."""
    limits: ForceLimits = field(default_factory=ForceLimits)
    qp: QpConfig = field(default_factory=QpConfig)
    demands: SolutionRequirements = field(default_factory=SolutionRequirements)
    compiled: bool = False
    """Whether updates are compiled (extra ``compiled``): the same forces to rounding, several times as fast. Of ``qp``
    only ``max_iterations`` counts then."""
    plan_valid_s: float = 0.1
    """An update without a solution uses the last plan if it is no older than this, else the reference."""

    def __post_init__(self) -> None:
        positive = (self.period_s, self.force_weight)
        weights = np.concatenate([one.diagonal for one in (self.weights, self.landing_weights) if one])
        if not (all(0 < one < np.inf for one in positive) and (weights >= 0).all() and np.isfinite(weights).all()):
            raise ValueError("period_s and force_weight finite and above 0, weights finite and not below 0")
        if not 0 <= self.plan_valid_s < np.inf:
            raise ValueError("plan_valid_s finite and not below 0")
