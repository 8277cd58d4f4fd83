"""Numbers of effects that move feet, by kinematics: a foot that carries weight is on the ground."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.diagnosis.channels import displaced
from leapgap.diagnosis.engine.intervals import Course, Effects, Intervals
from leapgap.diagnosis.engine.points import prior_of
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.diagnosis.robust_least_squares import Products
from leapgap.logs.base_estimate import measured_stance
from leapgap.robot.model import Robot
from leapgap.simulation.rollout import Rollout

REACH_M = 0.15  # Distance from the ground up to which a foot is looked for, m
SLOW_M_S = 0.2  # Speed of a foot below which it stands, m/s
OFF_M = 0.001  # By how much a foot that stands is off the ground or in it: feet are soft, and heights of bases noisy, m
FURTHEST = 3.0  # Times ``OFF_M`` that all feet may sink in by, and prior deviations that a number may depart by


@dataclass(frozen=True)
class Planted:
    """The feet that stand in some logs, and how far they are from the ground."""

    intervals: Intervals
    stands: tuple[np.ndarray, ...]
    """Of each log, bool, (instants, feet)."""

    @staticmethod
    def of(intervals: Intervals) -> "Planted":
        """By contacts or forces of the feet, where a log has them, else by how slow they are."""
        return Planted(intervals, tuple(stance_of(own, intervals.robot) for own in intervals.courses))

    def gaps(self, effects: Sequence[Effects]) -> np.ndarray:
        """Distance of the feet that stand from the ground by effects on each log, m, all in one row; NaN: far off."""
        found, robot = [], self.intervals.robot
        for log, (own, stands) in enumerate(zip(self.intervals.courses, self.stands, strict=True)):
            true = displaced(own.reference, -self.intervals.misreported(log, effects[log]), robot)
            with self.intervals.replayer.working_model(Rollout(own.states.log, effects[log])) as working:
                model, data = working.model, working.data
                feet, ground = [model.geom(name).id for name in robot.foot_geom_names], model.geom_bodyid == 0
                model.geom_margin[:] = model.body_margin[:] = REACH_M
                gap = np.full(stands.shape, np.inf)
                for k in np.flatnonzero(stands.any(axis=1)):
                    data.qpos[: true.qpos.shape[1]] = true.qpos[k]
                    mujoco.mj_kinematics(model, data)
                    mujoco.mj_collision(model, data)
                    pairs, distances = data.contact.geom, data.contact.dist
                    for foot, geom in enumerate(feet):
                        on_ground = (pairs == geom).any(axis=1) & ground[pairs].any(axis=1)
                        gap[k, foot] = distances[on_ground].min(initial=np.inf)
            found.append(gap[stands])
        gaps = np.concatenate(found)
        return np.where(np.isfinite(gaps), gaps, np.nan)

    def numbers(
        self, acting: Sequence[Effects], hypotheses: Sequence[Hypothesis]
    ) -> list[tuple[float, Hypothesis, np.ndarray]]:
        """How much nearer each effect alone brings the feet to the ground beside others on each log, with its numbers.

        The first is by how much that is likelier, nats, by Student's distribution of the distances in ``OFF_M``: some
        feet do not stand. The best first. All feet may sink in a little by as much.
        """
        now = self.gaps(acting)
        found = ((*self.numbers_about(acting, h, h.nominal, now), h) for h in hypotheses)
        return sorted(((gain, h, own) for gain, own, h in found), key=lambda one: -one[0])

    def numbers_about(
        self, acting: Sequence[Effects], h: Hypothesis, near: np.ndarray, now: np.ndarray | None = None
    ) -> tuple[float, np.ndarray]:
        """The same of one effect, by how it moves the feet ``near`` some numbers, where the feet are ``now``."""
        names = [own.states.log.name for own in self.intervals.courses]

        def gaps_by(numbers: np.ndarray) -> np.ndarray:
            sets = [(*own, *h.on(log, numbers).on_model_ground()) for own, log in zip(acting, names, strict=True)]
            return self.gaps(sets) / OFF_M

        base = gaps_by(near) if now is None else now / OFF_M
        size, slopes = prior_of(h), []
        for k, by in enumerate(h.moderate):
            changed = near.copy()
            changed[k] += by
            slopes.append((gaps_by(changed) - base) / by * size[k])
        moved = np.stack(slopes, axis=1)
        off = base - moved @ ((near - h.nominal) / size)
        columns = np.column_stack([off, moved, np.ones(len(off))])
        columns = columns[np.isfinite(columns).all(axis=1), None]
        (loss, weights), (without, _) = map(likeliest, (columns, columns[:, :, [0, -1]]))
        return without - loss, h.clip(h.nominal + size * weights[:-1])


def likeliest(columns: np.ndarray) -> tuple[float, np.ndarray]:
    """Loss of distances (column 0), nats, by the numbers of the other columns that make them likeliest; the numbers."""
    products, prior = Products.of(columns), np.ones(columns.shape[2] - 1)
    weights = products.fit(prior, FURTHEST)
    return products.penalised_loss(weights, prior), weights[1:]


def stance_of(course: Course, robot: Robot) -> np.ndarray:
    """Feet that stand in each instant of a log, bool, (instants, feet)."""
    measured = measured_stance(course.states.log, robot)
    if measured is not None:
        return measured[course.rows]
    model, motion = robot.model, course.reference
    data, moves, slow = mujoco.MjData(model), np.zeros((3, model.nv)), np.zeros((len(motion), len(robot.feet)), bool)
    for k in range(len(motion)):
        data.qpos[:] = motion.qpos[k]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for foot, geom in enumerate(robot.foot_geoms):
            mujoco.mj_jacGeom(model, data, moves, None, geom)
            slow[k, foot] = np.linalg.norm(moves @ motion.qvel[k]) < SLOW_M_S
    return slow
