"""Settings of the learned MPC: section ``land.learned``."""

from dataclasses import dataclass, field

from leapgap.jumping.control.condensed_qp import ForceLimits
from leapgap.jumping.control.excitation import Excitation
from leapgap.jumping.control.gains import JointGains, PhaseGains
from leapgap.jumping.control.mpc_config import MpcConfig, StateWeights


@dataclass(frozen=True)
class PracticeRounds:
    """How many jumps are made, to which targets, and with which random forces; all on flat ground."""

    distances_m: tuple[float, ...] = (0.35, 0.45, 0.55, 0.65, 0.75)
    first_jumps: int = 2
    """Jumps to each target by the nominal MPC."""
    rounds: int = 7
    """Of one jump to each target by the learned MPC."""
    first: Excitation = field(default_factory=lambda: Excitation(40.0))
    later: Excitation = field(default_factory=lambda: Excitation(15.0))
    on_policy_weight: float = 5.0
    """How much a jump of the learned MPC counts beside one of the nominal MPC."""
    block_m: tuple[float, float] = (0.0, 0.0)
    """Height of a block under the front feet in every second jump, drawn evenly."""
    slope_rad: tuple[float, float] = (-0.005, 0.005)
    trusted_cm: float = 5.0
    """Largest mean |landing − prediction| of the last round with which the model of all jumps is kept; beyond, that of
    the round whose landings were predicted best."""

    def __post_init__(self) -> None:
        """Refuse a practice from which nothing can be learned."""
        if self.first_jumps < 1 or self.rounds < 0 or not self.distances_m:
            raise ValueError(
                "one distance, and one jump to each of them by the nominal MPC, or more; rounds not below 0"
            )


@dataclass(frozen=True)
class LearnedMpcConfig:
    """Control, model and practice of the learned MPC."""

    model: str = "deviation_kernel"
    """Name of a recipe in ``learning/models``."""
    gains: PhaseGains = field(
        default_factory=lambda: PhaseGains(JointGains(100.0, 2.0), JointGains(300.0, 3.0), JointGains(100.0, 2.0))
    )
    mpc: MpcConfig = field(
        default_factory=lambda: MpcConfig(
            weights=StateWeights(50.0, 100.0, 5.0, 10.0, 10.0, 1.0),
            landing_weights=StateWeights(5000.0, 500.0, 50.0, 0.0, 0.0, 5.0),
            force_weight=1e-5,
            limits=ForceLimits(from_plan_n=120.0),
        )
    )
    practice: PracticeRounds = field(default_factory=PracticeRounds)
