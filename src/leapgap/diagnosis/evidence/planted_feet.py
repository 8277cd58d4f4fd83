"""How the legs are made and what the robot weighs, by feet that stand."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.diagnosis.evidence.base import LEAST_LOGS, Evidence, Source, agree, slopes, sure
from leapgap.effects.bodies import Payload
from leapgap.effects.shape import LegGeometry
from leapgap.logs.base_estimate import columns_of_feet, stance_by_force
from leapgap.logs.contacts import has_feet_in_world, runs_of
from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.kinematics import each_pose, gather
from leapgap.robot.model import Robot
from leapgap.robot.model_file import gravity_of

STILL_M_PER_S, STILL_RAD_PER_S = 0.02, 0.2  # A robot whose base and joints are slower than this stands still
SHORTEST_S = 0.1  # Shorter stances tell little
BELIEVED = 0.3
"""Feet that bear another weight than the model's by a larger share, or logs that scatter by it, are not in newtons."""


CALIBRATED = 0.03  # Standard deviation of the scale of force sensors, by which their weight only leads a fit
MARGIN_S = 0.02  # So much at both ends of a stance is left out
FLAT_M = 0.003  # A foot whose height scatters by more, standard deviation, does not stand, whatever its force says
TOLD = 0.01  # A parameter is told where its scatter over resampled logs is below this, m
DRAWS = 200  # Number of times that logs are drawn anew, with repetition, to see how far their answer scatters


class Standing(Source):
    """Feet that stand still bear the weight of the robot, where their forces are in newtons."""

    name = "standing"

    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """Take the mass that the feet bear over that of the model; forces in another unit are told, and say no more."""
        if not robot.has_free_base:
            return []
        borne = {log.name: mass for log in logs if (mass := mass_borne(log, robot)) is not None}
        if len(borne) < LEAST_LOGS:
            return []
        mass, spread = agree(borne)
        own = float(robot.model.body_subtreemass[robot.base_body])
        bears = (
            f"feet bear {mass:.2f} ± {spread:.2f} kg where the robot stands still, and the model weighs {own:.2f} kg"
        )
        scatter = float(np.std(list(borne.values())))
        if max(abs(mass - own), scatter) > BELIEVED * own:
            says = f"{bears}: their forces are not in newtons, so they do not show its mass"
            return [Evidence(self.name, "weight_borne", mass, spread, "kg", borne, says)]
        (parameter,) = Payload.parameters(robot)
        spread = float(np.hypot(spread, CALIBRATED * own))
        added = mass - own if sure(mass - own, spread) else parameter.nominal
        per_log = {name: value - own for name, value in borne.items()}
        quantity = f"{Payload.name}.{parameter.name}"
        return [Evidence(self.name, quantity, added, spread, "kg", per_log, bears, held=False)]


def mass_borne(log: Log, robot: Robot) -> float | None:
    """Mass that the forces of the feet bear while the robot stands still, kg; None where it never does, or unlogged."""
    force = columns_of_feet(log, robot, "foot_force")
    speeds = [f"base_linvel_{axis}" for axis in "xyz"]
    joints = [f"joint_vel/{joint}" for joint in robot.joints]
    if force is None or not all(name in log for name in (*speeds, *joints)):
        return None
    still = (np.abs(log.stack(speeds)) < STILL_M_PER_S).all(axis=1)
    still &= (np.abs(log.stack(joints)) < STILL_RAD_PER_S).all(axis=1)
    long_enough = [run for run in runs_of(still) if log.time[run.stop - 1] - log.time[run.start] >= SHORTEST_S]
    if not long_enough:
        return None
    of_rows = np.concatenate([force[run].sum(axis=1) for run in long_enough])
    return float(np.median(of_rows)) / float(np.linalg.norm(gravity_of(robot.model)))


@dataclass(frozen=True)
class Normal:
    """Normal equations of one log: what its stances ask of the parameters."""

    matrix: np.ndarray  # (parameters + 1, parameters + 1), the last for what a foot sinks in under its force
    right: np.ndarray  # (parameters + 1,)

    def of_some(self, kept: np.ndarray) -> "Normal":
        """The equations where the other parameters are nominal."""
        return Normal(self.matrix[np.ix_(kept, kept)], self.right[kept])

    @staticmethod
    def solve(of: Sequence["Normal"]) -> np.ndarray:
        """The parameters that fit some logs together, and the softness of the feet, m/N, (parameters + 1,)."""
        matrix, right = (np.sum([getattr(one, name) for one in of], axis=0) for name in ("matrix", "right"))
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled, *_ = np.linalg.lstsq(matrix / np.outer(size, size), right / size, rcond=1e-6)
        return np.asarray(scaled / size)


class PlantedFeet(Source):
    """The height of a foot that carries weight stays the same, whatever the trunk and the joints do.

    Height alone is used: along the ground a round foot rolls, and may slip. Which feet carry weight is by their forces;
    how far a soft foot sinks in under its force is fitted too.
    """

    name = "planted_feet"

    def gather(self, logs: Sequence[Log], robot: Robot, before: Sequence[Evidence] = ()) -> list[Evidence]:
        """Fit the parameters of ``leg_geometry`` to the stances of all logs together; resampled logs say how surely.

        Those that the stances do not surely ask for keep the model's value, and the others are fitted anew.
        """
        if LegGeometry.lacks(robot) or not all(has_feet_in_world(log, robot) for log in logs):
            return []
        found = {log.name: normal for log in logs if (normal := stances_of(log, robot)) is not None}
        if len(found) < LEAST_LOGS:
            return []
        every = list(found.values())
        value, spread = solve_together(every)
        kept = np.append(sure(value, spread)[:-1], True)
        value, spread = np.where(kept, value, 0.0), spread.copy()
        value[kept], spread[kept] = solve_together([normal.of_some(kept) for normal in every])
        alone = {log: Normal.solve([normal]) for log, normal in found.items()}
        told = []
        for k, p in enumerate(LegGeometry.parameters(robot)):
            if spread[k] > TOLD:
                continue
            says = (
                f"planted feet keep their height with {p.name} off by {1000 * value[k]:.1f} ± {1000 * spread[k]:.1f} mm"
            )
            per_log = {log: float(own[k]) for log, own in alone.items()}
            quantity = f"{LegGeometry.name}.{p.name}"
            told.append(Evidence(self.name, quantity, float(value[k]), float(spread[k]), p.unit, per_log, says))
        return told


def solve_together(every: Sequence[Normal]) -> tuple[np.ndarray, np.ndarray]:
    """The parameters that fit all logs, and their standard deviation over resampled logs, (parameters,) each."""
    rng = np.random.default_rng(0)
    draws = [Normal.solve([every[k] for k in rng.integers(0, len(every), len(every))]) for _ in range(DRAWS)]
    return Normal.solve(every), np.std(draws, axis=0)


def stances_of(log: Log, robot: Robot) -> Normal | None:
    """What the stances of a log ask of the parameters of ``leg_geometry``; None where no foot stands long enough."""
    stands = stance_by_force(log, robot)
    if stands is None:
        return None
    qpos = motion_of(log, robot).qpos

    def heights(model: mujoco.MjModel) -> np.ndarray:
        return foot_heights(model, robot, qpos)

    _, height, by = slopes(LegGeometry, robot, heights)
    force = columns_of_feet(log, robot, "foot_force")
    if force is None:
        return None
    by = np.concatenate([by, force[:, :, None]], axis=2)
    parts = [
        (height[run, foot] - height[run, foot].mean(), by[run, foot] - by[run, foot].mean(axis=0))
        for foot in range(len(robot.feet))
        for run in stances(stands[:, foot], log)
        if height[run, foot].std() < FLAT_M
    ]
    if not parts:
        return None
    right, matrix = (np.concatenate(of) for of in zip(*parts, strict=True))
    return Normal(matrix.T @ matrix, -matrix.T @ right)


def stances(stands: np.ndarray, log: Log) -> list[slice]:
    """Runs of rows in which a foot stands (bool, (rows,)) for long enough, without their ends."""
    margin = log.info.rows(MARGIN_S)
    runs = [slice(run.start + margin, run.stop - margin) for run in runs_of(stands)]
    return [run for run in runs if run.stop - run.start > log.info.rows(SHORTEST_S)]


def foot_heights(model: mujoco.MjModel, robot: Robot, qpos: np.ndarray) -> np.ndarray:
    """Height of the centre of each foot, m, (rows, feet)."""
    heights = (data.geom_xpos[robot.foot_geoms, 2] for data in each_pose(model, qpos))
    return gather(len(qpos), heights, (len(robot.feet),))
