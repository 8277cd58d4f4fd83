"""Base class of the files that other simulators read, and what they are written from."""

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np

from leapgap.export.posterior import SIGMAS, Posterior
from leapgap.robot.model import Robot
from leapgap.simulation.corrected_model import changed_model, joint_numbers

Gains = Mapping[str, tuple[float, float]]  # joint → kp and kd of its joint PD, N·m/rad and N·m·s/rad
DRAWN, SEED = 256, 0  # number of robots that are drawn from the posterior, and seed of the draw
LEAST_SHARE = 1e-9  # a number that varies by less than this share of its size is known


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


@dataclass(frozen=True)
class RobotNumbers:
    """Numbers of one robot that simulators randomise."""

    joints: Mapping[str, np.ndarray]  # as ``joint_numbers``, (joints,) each
    body_mass: np.ndarray  # of the bodies of the model, kg, (bodies,)
    body_ipos: np.ndarray  # centres of mass in body axes, m, (bodies, 3)
    body_inertia: np.ndarray  # principal moments, kg·m², (bodies, 3)
    body_iquat: np.ndarray  # principal axes in body axes, (bodies, 4)
    foot_friction: np.ndarray  # sliding friction, (feet,)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All of them by name; of those of joints, what simulators randomise."""
        fields = {key: getattr(self, key) for key in BODIES_AND_FEET}
        return {key: self.joints[key] for key in JOINT_UNITS} | fields


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


BODIES_AND_FEET = ("body_mass", "body_ipos", "body_inertia", "body_iquat", "foot_friction")
"""Numbers of bodies and feet that simulators randomise."""


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

    def numbers(self, drawn: np.ndarray) -> RobotNumbers:
        """Numbers of the robot with numbers (numbers,) of the posterior."""
        effects, robot = self.posterior.with_numbers(drawn), self.robot
        model = changed_model(self.bare, robot, effects)
        feet = [model.geom(name).id for name in robot.foot_geom_names]
        # copies: a view would keep the model, and its meshes, for each robot drawn
        inertias = (model.body_inertia.copy(), model.body_iquat.copy())
        bodies = (model.body_mass.copy(), model.body_ipos.copy(), *inertias)
        return RobotNumbers(joint_numbers(robot, effects, model), *bodies, model.geom_friction[feet, 0])

    @cached_property
    def corrected(self) -> RobotNumbers:
        """Numbers of the corrected robot."""
        return self.numbers(self.posterior.mean)

    @cached_property
    def drawn(self) -> np.ndarray:
        """Numbers drawn together from the posterior, (robots, numbers)."""
        return self.posterior.samples(DRAWN, np.random.default_rng(SEED))

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """Numbers of every drawn robot, by name: (robots, joints), (robots, bodies, …) or (robots, feet)."""
        every = [self.numbers(one).arrays for one in self.drawn]
        return {key: np.stack([one[key] for one in every]) for key in every[0]}

    @cached_property
    def spreads(self) -> dict[str, np.ndarray]:
        """Standard deviations of the same, by their slopes at the most likely numbers."""
        posterior, slopes = self.posterior, []
        for i, step in enumerate(np.sqrt(np.diag(posterior.covariance))):
            ends = np.tile(posterior.mean, (2, 1))
            ends[:, i] = np.clip(ends[:, i] + np.array([-step, step]), posterior.lower[i], posterior.upper[i])
            below, above = (self.numbers(end).arrays for end in ends)
            width = ends[1, i] - ends[0, i] or 1.0
            slopes.append({key: (above[key] - below[key]) / width for key in above})
        if not slopes:
            return {key: np.zeros_like(of) for key, of in self.corrected.arrays.items()}
        by_key = {key: np.stack([one[key] for one in slopes]) for key in slopes[0]}
        variance = {key: np.einsum("i...,ij,j...->...", of, posterior.covariance, of) for key, of in by_key.items()}
        return {key: np.sqrt(np.maximum(of, 0.0)) for key, of in variance.items()}

    @cached_property
    def body_names(self) -> tuple[str, ...]:
        """Names of the bodies of the model, the world first."""
        return tuple(self.bare.body(i).name or f"body_{i}" for i in range(self.bare.nbody))

    @cached_property
    def joint_ranges(self) -> dict[str, dict[str, Range]]:
        """Quantity → joint → range, of what is not known exactly."""
        found = {key: self._ranges(self.robot.joints, key, unit) for key, unit in JOINT_UNITS.items()}
        return {key: of for key, of in found.items() if of}

    @cached_property
    def body_ranges(self) -> dict[str, dict[str, Range]]:
        """``mass`` and ``com_x`` to ``com_z`` → body → range, of what is not known exactly."""
        found = {"mass": self._ranges(self.body_names, "body_mass", "kg")}
        found |= {f"com_{axis}": self._ranges(self.body_names, "body_ipos", "m", i) for i, axis in enumerate("xyz")}
        return {key: of for key, of in found.items() if of}

    @cached_property
    def foot_ranges(self) -> dict[str, Range]:
        """Sliding friction of the feet that is not known exactly: geom → range."""
        return self._ranges(self.robot.foot_geom_names, "foot_friction", "1")

    def _ranges(self, names: Sequence[str], key: str, unit: str, column: int | None = None) -> dict[str, Range]:
        """Ranges within those of the drawn robots, which keep to the limits of the numbers."""
        arrays = [of[key] for of in (self.corrected.arrays, self.spreads, self.arrays)]
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


def exactly(name: str) -> str:
    """The regular expression of one name, for simulators that take expressions."""
    return re.escape(name)


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
