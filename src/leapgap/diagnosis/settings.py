"""Settings of a diagnosis: effects to look for, evidence, search and thresholds."""

from dataclasses import dataclass, field

import numpy as np

from leapgap.diagnosis.joint_fit import JointFitSettings
from leapgap.diagnosis.outside_forces.outside_force import OutsideForceSettings
from leapgap.effects.model_field import ModelField
from leapgap.errors import InputError

LONGEST_HORIZON_S = 1000.0
ENOUGH_ROWS = 20_000  # Number of samples up to which every draw of noise is made
TOLERANCES = {
    "armature.inertia": 0.05,
    "joint_friction.torque_nm": 0.05,
    "joint_damping.damping": 0.10,
    "foot_friction.mu": 0.02,
    "foot_compliance.time_constant_s": 0.03,
    "leg_mass.scale": 0.005,
    "com_offset.x_m": 0.0005,
    "com_offset.z_m": 0.0005,
    "payload.mass_kg": 0.005,
    "trunk_inertia.scale": 0.005,
}
"""Tolerances of a robot's model: standard deviations as shares of its own numbers, offsets in m."""


@dataclass(frozen=True)
class Settings:
    """Settings of a diagnosis: effects to look for, evidence, search and thresholds."""

    effects: list[str] = field(default_factory=list)
    """Names of the hypotheses; empty: the known effects that are searched by default (``Effect.by_default``)."""
    without: list[str] = field(default_factory=list)
    """Names of effects that are left out of the search, as if they were unknown."""
    model_fields: list[ModelField] = field(default_factory=list)
    """Further hypotheses: numbers of the robot's model that no effect is for, each with the range that is searched."""
    folds: int = 4
    """Parts of the logs; each log is judged with values fitted on the other parts."""
    horizon_s: float = 0.1
    """Length of a piece: replays restart from the log after this time."""
    every_s: float = 0.01
    """Replays are compared with the log at this interval."""
    pieces_per_log: int = 8
    """Number of segments that are replayed of each log, if that is fewer than ``most_pieces`` in all."""
    most_pieces: int = 48
    """Largest number of segments that are replayed of all logs together."""
    tolerances: dict[str, float] = field(default_factory=lambda: dict(TOLERANCES))
    """``effect.parameter`` → standard deviation of that number of the model, in units of the model's own value
    (``Parameter.scale``): a share of its armature, friction or mass; m where the model has no such number."""
    sizes: dict[str, float] = field(default_factory=dict)
    """Channel or quantity (``joint_pos``) → size by which its errors are divided in the headline gap, rad, m and per s.
    A channel without one is divided by a tenth of its spread in the logs; jumps have sizes of their own."""
    model_error: float = 0.08
    """Relative error of a departure from nominal because the simulation differs from the robot, in reported intervals.
    Of 152 numbers of sealed cases it holds 93 %; 0.05 held 86 %."""
    where_horizon_s: float = 0.1
    clock_threshold: float = 0.02
    even_threshold: float = 0.012
    joint: JointFitSettings = field(default_factory=JointFitSettings)
    """Settings of the fit of all effects together, used in logs with uneven time stamps."""
    outside: OutsideForceSettings = field(default_factory=OutsideForceSettings)
    """Settings of the search for external forces; samples in which they act are left out."""
    best: bool = True
    """Whether all effects are also fitted together, for the best simulator."""
    rows_threshold: float = 0.15
    fall_threshold: float = 0.08
    planted_threshold_m: float = 0.01
    noise_draws: int = 3
    bootstrap_draws: int = 500
    seed: int = 1

    def noise_draws_of(self, rows: int) -> int:
        """Draws of sensor noise for so many samples: those of long logs are many in one draw."""
        return max(1, min(self.noise_draws, self.noise_draws * ENOUGH_ROWS // rows))

    def __post_init__(self) -> None:
        """Refuse numbers that mean nothing, before any work."""
        counts = {"folds": 2, "pieces_per_log": 1, "most_pieces": 1, "noise_draws": 1, "bootstrap_draws": 1, "seed": 0}
        most = {"noise_draws": 10_000, "bootstrap_draws": 1_000_000}
        shares = ("model_error", "clock_threshold", "even_threshold", "fall_threshold", "planted_threshold_m")
        sizes = {f"sizes.{name}": size for name, size in self.sizes.items()}
        sizes |= {f"tolerances.{name}": size for name, size in self.tolerances.items()}
        own = {name: getattr(self, name) for name in (*counts, "horizon_s", "every_s", "where_horizon_s", *shares)}
        for name, holds, expected in (
            *((name, own[name] >= least, f"{least} or more") for name, least in counts.items()),
            *((name, own[name] <= largest, f"{counts[name]} to {largest}") for name, largest in most.items()),
            *(
                (name, 0 < own[name] < np.inf, "a time above 0, s")
                for name in ("horizon_s", "every_s", "where_horizon_s")
            ),
            ("every_s", self.every_s <= self.horizon_s, f"at most horizon_s, {self.horizon_s:g} s"),
            ("horizon_s", self.horizon_s <= LONGEST_HORIZON_S, f"{LONGEST_HORIZON_S:g} s at most"),
            ("every_s", self.every_s >= 1e-6 * self.horizon_s, "at least a millionth of horizon_s"),
            *((name, 0 < size < np.inf, "a number above 0") for name, size in sizes.items()),
            *((name, 0 <= own[name] < np.inf, "a number of 0 or more") for name in shares),
        ):
            if not holds:
                raise InputError(f"settings.{name}", f"{(own | sizes)[name]}", expected, "correct it")

    def pieces(self, logs: int) -> int:
        """Largest number of pieces that are replayed of so many logs together."""
        return min(self.most_pieces, self.pieces_per_log * logs)

    @property
    def check_thresholds(self) -> dict[str, float]:
        """Thresholds of the consistency checks by name."""
        return {
            "row_clock": self.rows_threshold,
            "joint_clock": self.clock_threshold,
            "base_clock": self.clock_threshold,
            "even_clock": self.even_threshold,
            "free_fall": self.fall_threshold,
            "planted_feet": self.planted_threshold_m,
        }
