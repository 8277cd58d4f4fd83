"""Base class of the files that other simulators read, and what they are written from."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.special import ndtri

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.report import Cause
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot
from leapgap.simulation.corrected_model import changed_model, joint_numbers

SIGMAS = 1.96  # half the width of a 95 % interval, in standard deviations
Gains = Mapping[str, tuple[float, float]]  # joint → kp and kd of its joint PD, N·m/rad and N·m·s/rad
DRAWN, SEED = 256, 0  # number of robots that are drawn from the posterior, and seed of the draw
LEAST_SHARE = 1e-9  # a number that varies by less than this share of its size is known


@dataclass(frozen=True)
class Posterior:
    """How surely the numbers of some effects are known together: a normal distribution, cut at their limits."""

    effects: tuple[Effect, ...]  # with the most likely numbers
    numbers: tuple[tuple[int, str], ...]  # of each number, the index of its effect and the name of its parameter
    covariance: np.ndarray  # (numbers, numbers)
    lower: np.ndarray  # limits of the numbers, (numbers,)
    upper: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """The most likely numbers, (numbers,)."""
        return np.array([self.effects[which].values[name] for which, name in self.numbers])

    @property
    def labels(self) -> tuple[str, ...]:
        """``joint_damping at elbow: damping`` of each number."""
        of = [(self.effects[which], name) for which, name in self.numbers]
        return tuple(f"{effect.name} at {effect.location}: {name}" for effect, name in of)

    def samples(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Numbers drawn together, (count, numbers); those beyond a limit are put at it.

        Along each principal axis there is one draw in each of ``count`` equally likely parts (a Latin hypercube), so
        that few draws have the right intervals.
        """
        if not self.numbers:
            return np.zeros((count, 0))
        values, vectors = np.linalg.eigh(self.covariance)
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
        parts = np.stack([rng.permutation(count) for _ in self.numbers], axis=1)
        drawn = self.mean + ndtri((parts + 0.5) / count) @ spread.T
        return np.clip(drawn, self.lower, self.upper)

    def with_numbers(self, numbers: np.ndarray) -> tuple[Effect, ...]:
        """The effects with other numbers (numbers,)."""
        changed = list(self.effects)
        for (which, name), number in zip(self.numbers, numbers.tolist(), strict=True):
            changed[which] = replace(changed[which], **{name: number})
        return tuple(changed)


def posterior_of(
    robot: Robot, correction: Sequence[Effect], causes: Sequence[Cause], fit: Candidate | None = None
) -> Posterior:
    """The posterior of a correction: spreads by the 95 % intervals of its causes, correlations by the fit's covariance.

    An effect without a cause is taken as known. Without a fit, the numbers are independent.
    """
    known = {(cause.effect, cause.location): cause.parameters for cause in causes}
    numbers, spread, lower, upper = [], [], [], []
    for which, effect in enumerate(correction):
        estimates = known.get((effect.called(robot), effect.location), {})
        for parameter in effect.parameters(robot, effect.location):
            if parameter.name not in estimates or parameter.name not in effect.values:
                continue
            low, high = estimates[parameter.name].ci95
            numbers.append((which, parameter.name))
            spread.append((high - low) / (2 * SIGMAS))
            lower.append(min(parameter.lower, effect.values[parameter.name]))
            upper.append(max(parameter.upper, effect.values[parameter.name]))
    correlation = correlations([(correction[which], name) for which, name in numbers], robot, fit)
    covariance = correlation * np.outer(spread, spread)
    return Posterior(tuple(correction), tuple(numbers), covariance, np.array(lower), np.array(upper))


def correlations(numbers: Sequence[tuple[Effect, str]], robot: Robot, fit: Candidate | None) -> np.ndarray:
    """Correlations of numbers by the covariance of a fit, (numbers, numbers); none where the fit has not the number."""
    found = np.eye(len(numbers))
    if fit is None or not fit.hypotheses:
        return found
    covariance = np.nan_to_num(fit.covariance)
    spread = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    own = [(h, p.name) for h in fit.hypotheses for p in h.parameters]
    row = {(h.name, h.location, name): i for i, (h, name) in enumerate(own) if h.per_log is None}
    at = [row.get((effect.called(robot), effect.location, name)) for effect, name in numbers]
    for (i, one), (k, other) in permutations(enumerate(at), 2):
        if one is not None and other is not None:
            found[i, k] = np.clip(covariance[one, other] / (spread[one] * spread[other]), -1.0, 1.0)
    return found


@dataclass(frozen=True)
class Range:
    """A number of the corrected robot and its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str

    def rounded(self) -> dict[str, Any]:
        """As a mapping with six significant digits."""
        return {key: shorter(getattr(self, key)) for key in ("value", "low", "high")} | {"unit": self.unit}


JOINT_UNITS = {
    "damping": "N·m·s/rad",
    "friction": "N·m",
    "armature": "kg·m²",
    "torque_gain": "1",
    "position_gain": "1",
    "velocity_gain": "1",
    "command_delay_s": "s",
    "encoder_bias_rad": "rad",
}
"""Numbers of joints that simulators randomise, and their units (of joints that turn)."""


BODY_FIELDS = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
RANDOMISED = (*JOINT_UNITS, *BODY_FIELDS, "foot_friction")
"""Numbers of joints, bodies and feet that simulators randomise."""


@dataclass(frozen=True)
class CorrectedRobot:
    """What the files are written from."""

    posterior: Posterior
    robot: Robot
    gains: Gains  # empty where no log says them

    @cached_property
    def bare(self) -> mujoco.MjModel:
        """The nominal model, without what only shows."""
        return self.robot.on_terrain(())

    def numbers(self, drawn: np.ndarray) -> dict[str, np.ndarray]:
        """Numbers of the robot with numbers (numbers,) of the posterior, by name.

        Of joints as ``joint_numbers``, (joints,) each; of the bodies of the model mass, kg, (bodies,), centre, m,
        principal moments, kg·m², and axes in body axes, (bodies, 3 or 4); of the feet sliding friction, (feet,).
        """
        effects, robot = self.posterior.with_numbers(drawn), self.robot
        model = changed_model(self.bare, robot, effects)
        feet = [model.geom(name).id for name in robot.foot_geom_names]
        # copies: a view would keep the model, and its meshes, for each robot drawn
        bodies = {field: getattr(model, field).copy() for field in BODY_FIELDS}
        return {**joint_numbers(robot, effects, model), **bodies, "foot_friction": model.geom_friction[feet, 0]}

    @cached_property
    def corrected(self) -> dict[str, np.ndarray]:
        """Numbers of the corrected robot."""
        return self.numbers(self.posterior.mean)

    @cached_property
    def drawn(self) -> np.ndarray:
        """Numbers drawn together from the posterior, (robots, numbers)."""
        return self.posterior.samples(DRAWN, np.random.default_rng(SEED))

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Numbers of every drawn robot, by name: (robots, joints), (robots, bodies, …) or (robots, feet)."""
        every = [self.numbers(one) for one in self.drawn]
        return {key: np.stack([one[key] for one in every]) for key in RANDOMISED}

    @cached_property
    def spreads(self) -> dict[str, np.ndarray]:
        """Standard deviations of the same, by their slopes at the most likely numbers."""
        posterior, slopes = self.posterior, []
        for i, step in enumerate(np.sqrt(np.diag(posterior.covariance))):
            ends = np.tile(posterior.mean, (2, 1))
            ends[:, i] = np.clip(ends[:, i] + np.array([-step, step]), posterior.lower[i], posterior.upper[i])
            below, above = (self.numbers(end) for end in ends)
            width = ends[1, i] - ends[0, i] or 1.0
            slopes.append({key: (above[key] - below[key]) / width for key in RANDOMISED})
        if not slopes:
            return {key: np.zeros_like(self.corrected[key]) for key in RANDOMISED}
        by_key = {key: np.stack([one[key] for one in slopes]) for key in RANDOMISED}
        variance = {key: np.einsum("i...,ij,j...->...", of, posterior.covariance, of) for key, of in by_key.items()}
        return {key: np.sqrt(np.maximum(of, 0.0)) for key, of in variance.items()}

    @cached_property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies of the model, the world first."""
        return tuple(self.bare.body(i).name or f"body_{i}" for i in range(self.bare.nbody))

    @cached_property
    def ranges(self) -> dict[str, dict[str, dict[str, Range]]]:
        """``joints``, ``bodies`` and ``feet`` → quantity → name → range, of what is not known exactly.

        Quantities of bodies are ``mass`` and ``com_x`` to ``com_z``; that of feet is ``friction``, by their geoms.
        """
        joints = {key: self._ranges(self.robot.joints, key, unit) for key, unit in JOINT_UNITS.items()}
        bodies = {"mass": self._ranges(self.body_names, "body_mass", "kg")}
        bodies |= {f"com_{axis}": self._ranges(self.body_names, "body_ipos", "m", i) for i, axis in enumerate("xyz")}
        feet = {"friction": self._ranges(self.robot.foot_geom_names, "foot_friction", "1")}
        every = {"joints": joints, "bodies": bodies, "feet": feet}
        return {kind: {key: of for key, of in own.items() if of} for kind, own in every.items()}

    def _ranges(self, names: Sequence[str], key: str, unit: str, column: int | None = None) -> dict[str, Range]:
        """Ranges within those of the drawn robots, which keep to the limits of the numbers."""
        arrays = [of[key] for of in (self.corrected, self.spreads, self.arrays)]
        own, spread, drawn = arrays if column is None else (of[..., column] for of in arrays)
        low, high = np.maximum(own - SIGMAS * spread, drawn.min(0)), np.minimum(own + SIGMAS * spread, drawn.max(0))
        known = spread <= LEAST_SHARE * np.maximum(np.abs(own), LEAST_SHARE)
        return {
            name: Range(float(own[i]), float(low[i]), float(high[i]), unit)
            for i, name in enumerate(names)
            if not known[i]
        }


class Export(ABC):
    """One file, or folder, beside a corrected robot that another simulator reads."""

    name: ClassVar[str]  # of the file or folder
    says: ClassVar[str]  # what it holds, and for which version of the simulator

    def lacks(self, corrected: CorrectedRobot) -> str | None:
        """Why the file cannot be written of a robot; None where it can."""
        return None

    @abstractmethod
    def write(self, folder: Path, corrected: CorrectedRobot) -> None:
        """Write the file into a folder."""


def shorter(value: float) -> float:
    """A number with six significant digits."""
    return float(f"{value:.6g}")


def literal(value: Any) -> str:
    """A value of plain numbers, texts and mappings as Python source, numbers with six significant digits."""

    def short(of: Any) -> Any:
        if isinstance(of, Mapping):
            return {key: short(one) for key, one in of.items()}
        if isinstance(of, list | tuple):
            return type(of)(short(one) for one in of)
        return shorter(of) if isinstance(of, float) else of

    if isinstance(value, Mapping) and value:
        inner = "".join(f"    {key!r}: {short(one)!r},\n" for key, one in value.items())
        return f"{{\n{inner}}}"
    return repr(short(value))
