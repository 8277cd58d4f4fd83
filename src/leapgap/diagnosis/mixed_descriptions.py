"""Parts of another description of the robot in the given one: the masses of one, the feet of the other."""

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

from leapgap.diagnosis.gap import HeldOutGap
from leapgap.effects.base import Effect, recompute_constants
from leapgap.robot.model import Robot


def own_bodies(robot: Robot) -> np.ndarray:
    """The base, where it floats, and the links that joints move, (bodies,)."""
    base = [robot.base_body] if robot.has_free_base else []
    return np.array([*base, *robot.joint_bodies])


def dofs_of(robot: Robot) -> np.ndarray:
    """Degrees of freedom of the joints, (joints,)."""
    return robot.joint_dofs


def feet_of(robot: Robot) -> np.ndarray:
    """Geoms of the feet, (feet,)."""
    return np.array(robot.foot_geoms, dtype=int)


Places = Callable[[Robot], np.ndarray]
PARTS: dict[str, tuple[tuple[Places, tuple[str, ...]], ...]] = {
    "masses": ((own_bodies, ("body_mass", "body_inertia", "body_ipos", "body_iquat")),),
    "lengths": ((own_bodies, ("body_pos", "body_quat")), (feet_of, ("geom_pos",))),
    "joints": ((dofs_of, ("dof_damping", "dof_frictionloss", "dof_armature")),),
    "feet": ((feet_of, ("geom_friction", "geom_solref", "geom_solimp", "geom_size")),),
    "simulation": (),
}
"""Fields of the model that make up each part, by the places that they belong to."""
OPTIONS = ("integrator", "cone", "impratio")  # Options of the model that make up the part ``simulation``


@dataclass(frozen=True)
class PartsOf(Effect):
    """Some parts of a robot as another description has them."""

    name = "parts_of_description"

    other: Robot | None = field(default=None, compare=False)
    parts: tuple[str, ...] = ()

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Copy the fields of the parts from the other model."""
        if self.other is None or not self.parts:
            return
        for part in self.parts:
            for places, fields in PARTS[part]:
                for name in fields:
                    getattr(model, name)[places(robot)] = getattr(self.other.model, name)[places(self.other)]
        if "simulation" in self.parts:
            for option in OPTIONS:
                setattr(model.opt, option, getattr(self.other.model.opt, option))
        bodies = own_bodies(robot)
        model.body_sameframe[bodies] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)
        recompute_constants(model)


@dataclass(frozen=True)
class Mix:
    """The parts of another description that close most of the gap."""

    effect: PartsOf
    squares: np.ndarray
    """Sums of squares of each log by the parts that are best on the logs of the other folds, (logs,)."""


def best_mix(robot: Robot, other: Robot, heldout_gap: HeldOutGap) -> Mix | None:
    """Parts of another description, added one by one while the gap falls; None where that takes all of them or none.

    Each log is judged with the mix that is best on the logs of the other folds. None also for robots of other bodies,
    whose parts do not correspond.
    """
    if not same_bodies(robot, other):
        return None
    tried: dict[tuple[str, ...], np.ndarray] = {}
    chosen: tuple[str, ...] = ()
    squares = heldout_gap.nominal
    while True:
        more = [tuple(p for p in PARTS if p in chosen or p == part) for part in PARTS if part not in chosen]
        found = heldout_gap.squares_with([[(PartsOf(other=other, parts=p),)] * len(squares) for p in more])
        tried |= dict(zip(more, found, strict=True))
        best = min(more, key=lambda parts: tried[parts].sum(), default=chosen)
        if not more or tried[best].sum() >= squares.sum():
            break
        chosen, squares = best, tried[best]
    if chosen in ((), tuple(PARTS)):
        return None
    return Mix(PartsOf(other=other, parts=chosen), held_out(tried, heldout_gap.folds))


def held_out(tried: dict[tuple[str, ...], np.ndarray], folds: np.ndarray) -> np.ndarray:
    """Sums of squares (logs,) of each log by the mix that is best on the logs of the other folds."""
    every = np.array(list(tried.values()))
    best = [every[:, folds != fold].sum(axis=1).argmin() for fold in folds]
    return np.asarray(every[best, np.arange(len(folds))])


def same_bodies(robot: Robot, other: Robot) -> bool:
    """Whether two robots consist of a base and one link a joint, and have equally many feet."""
    plain = all(len(one.bodies) == len(own_bodies(one)) for one in (robot, other))
    return plain and len(robot.feet) == len(other.feet)
