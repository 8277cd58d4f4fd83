"""Other descriptions of the same robot: each is judged as it is, without a fitted number, and by parts.

Parts are such as the masses of one in a robot with the feet of the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter

import mujoco
import numpy as np

from leapgap.diagnosis.gap import HeldOutGap, Interval, final_position_errors, motion_squares
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.effects.base import Effect, recompute_constants
from leapgap.errors import InputError
from leapgap.robot.model import Robot

OPTIONS = ("integrator", "cone", "impratio")  # Options of the model that make up the part ``simulation``


def own_bodies(robot: Robot) -> np.ndarray:
    """The base, where it floats, and the links that joints move, (bodies,)."""
    base = [robot.base_body] if robot.has_free_base else []
    return np.array([*base, *robot.joint_bodies])


def feet_of(robot: Robot) -> np.ndarray:
    """Geoms of the feet, (feet,)."""
    return np.array(robot.foot_geoms, dtype=int)


Places = Callable[[Robot], np.ndarray]
PARTS: dict[str, tuple[tuple[Places, tuple[str, ...]], ...]] = {
    "masses": ((own_bodies, ("body_mass", "body_inertia", "body_ipos", "body_iquat")),),
    "lengths": ((own_bodies, ("body_pos", "body_quat")), (feet_of, ("geom_pos",))),
    "joints": ((attrgetter("joint_dofs"), ("dof_damping", "dof_frictionloss", "dof_armature")),),
    "feet": ((feet_of, ("geom_friction", "geom_solref", "geom_solimp", "geom_size")),),
    "simulation": (),
}
"""Fields of the model that make up each part, by the places that they belong to."""


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


def best_mix(robot: Robot, other: Robot, heldout_gap: HeldOutGap) -> tuple[PartsOf, np.ndarray] | None:
    """Parts of another description, added one by one while the gap falls; None where that takes all of them or none.

    Beside them the sums of squares of each log, (logs,), by the parts that are best on the logs of the other folds.
    None also for robots of other bodies, whose parts do not correspond.
    """
    plain = all(len(one.bodies) == len(own_bodies(one)) for one in (robot, other))  # a base and one link a joint
    if not plain or len(robot.feet) != len(other.feet):
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
    return PartsOf(other=other, parts=chosen), held_out(tried, heldout_gap.folds)


def held_out(tried: dict[tuple[str, ...], np.ndarray], folds: np.ndarray) -> np.ndarray:
    """Sums of squares (logs,) of each log by the mix that is best on the logs of the other folds."""
    every = np.array(list(tried.values()))
    best = [every[:, folds != fold].sum(axis=1).argmin() for fold in folds]
    return np.asarray(every[best, np.arange(len(folds))])


@dataclass(frozen=True)
class DescriptionFigures:
    """What another description of the robot makes of the gap."""

    robot: str  # Name of its file; of a mix, which parts of it stand in the robot that was given
    gap: float
    closure: Interval  # Beside the robot that was given; of logs by their own clock, with what that clock closes
    landing_misplaced_cm: float | None
    """Mean absolute error of the trunk's x in the last judged row; None without a base."""


def judge_descriptions(robots: Sequence[Robot], heldout_gap: HeldOutGap) -> list[DescriptionFigures]:
    """Replay the logs by each robot, and by the given one with parts of it; what closes most comes first."""
    found, given = [], heldout_gap.judged
    for robot in robots:
        name, judged = robot.path.name if robot.path else robot.name, described(robot, given)
        motions = heldout_gap.replayer.with_robot(robot).motions(judged.whole_trials())
        whole = figures_of(name, motion_squares(motions, judged), final_position_errors(motions, judged), heldout_gap)
        found.append(whole)
        mix = best_mix(given.robot, robot, heldout_gap)
        if mix is not None and heldout_gap.gap(mix[1]) < whole.gap:
            effect, squares = mix
            motions = heldout_gap.replayer.motions(given.whole_trials([(effect,)] * len(given.logs)))
            said = f"{', '.join(effect.parts)} of {name}"
            found.append(figures_of(said, squares, final_position_errors(motions, given), heldout_gap))
    return sorted(found, key=lambda one: one.gap)


def figures_of(name: str, squares: np.ndarray, off: Sequence[float], heldout_gap: HeldOutGap) -> DescriptionFigures:
    """Figures of a description from sums of squares (logs,) and errors at the end of the logs, m."""
    landing = 100 * float(np.mean(np.abs(off))) if off else None
    return DescriptionFigures(name, heldout_gap.gap(squares), heldout_gap.closure(squares), landing)


def described(robot: Robot, judged: JudgedLogs) -> JudgedLogs:
    """The same logs, rows and channels with another description of their robot; ``InputError`` for another robot."""
    if robot.joints != judged.robot.joints or robot.has_free_base != judged.robot.has_free_base:
        raise InputError(
            "descriptions",
            f"{robot.name} with the joints {', '.join(robot.joints)}",
            f"another description of {judged.robot.name}, with its joints {', '.join(judged.robot.joints)}",
            "leave it out, or name its joints so",
        )
    return replace(judged, robot=robot)
