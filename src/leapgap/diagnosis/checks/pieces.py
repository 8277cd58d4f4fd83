"""Short pieces of logs, replayed by the model under different readings of their columns: which one do they follow?

A reading is judged before anything is fitted, so only such differences count that no cause makes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.effects.base import Effect
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log
from leapgap.logs.noise import noise_of
from leapgap.logs.state import States, columns_of, logged_motion
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

MOST = 24  # Largest number of pieces


def as_logged(log: Log) -> Log:
    """The reading that changes nothing."""
    return log


@dataclass(frozen=True)
class Pieces:
    """Pieces of equal length with their measured motions, those of joints alone."""

    robot: Robot
    replayer: Replayer
    logs: tuple[Log, ...]  # Each piece as a log; states that were not measured are in its columns as they are estimated
    of_log: tuple[str, ...]  # Name of the log that each piece is of
    resolved: np.ndarray  # Standard deviation of the noise of positions, (joints,), the largest of the logs

    @staticmethod
    def of(logs: Sequence[Log], robot: Robot, starts: Sequence[Sequence[int]], rows: int) -> "Pieces":
        """Pieces of so many ``rows`` that begin at some rows of each log; at most ``MOST`` of them, evenly chosen."""
        chosen = [(k, start) for k, of_log in enumerate(starts) for start in of_log if start + rows <= len(logs[k])]
        if len(chosen) > MOST:
            chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, MOST).round().astype(int)]
        pieces, names, noise = [], [], np.zeros(len(robot.joints))
        for k, log in enumerate(logs):
            own = [start for of, start in chosen if of == k]
            if not own:
                continue
            known = replace(log, columns={**log.columns, **columns_of(States.of(log, robot).motion, robot)})
            pieces += [rows_between(known, start, start + rows, f"{log.name}_{start}") for start in own]
            names += [log.name] * len(own)
            position = log.per_joint("joint_pos", robot.joints)
            noise = np.maximum(noise, noise_of(np.diff(position, axis=0), log.info.sample_period_s))
        slots = max((len(log.info.terrain) for log in logs), default=0)
        return Pieces(robot, Replayer(robot, max(1, slots)), tuple(pieces), tuple(names), noise)

    def some(self, number: int) -> "Pieces":
        """So many of the pieces, evenly chosen."""
        at = np.unique(np.linspace(0, len(self.logs) - 1, number).round().astype(int)).tolist()
        logs, of_log = (tuple(values[k] for k in at) for values in (self.logs, self.of_log))
        return replace(self, logs=logs, of_log=of_log)

    def motions(
        self, read: Callable[[Log], Log] = as_logged, effects: tuple[Effect, ...] = (), velocities: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Simulated and measured positions of the joints by a reading, (pieces, rows, joints) each, or velocities."""
        logs = [read(piece) for piece in self.logs]
        measured = [logged_motion(log, self.robot) for log in logs]
        trials = [Rollout(log, effects, measured=of) for log, of in zip(logs, measured, strict=True)]
        simulated = self.replayer.motions(trials)

        def of_joints(motions: Sequence[Motion]) -> np.ndarray:
            if velocities:
                return np.stack([of.qvel[:, self.robot.joint_dofs] for of in motions])
            return np.stack([of.qpos[:, self.robot.joint_qpos] for of in motions])

        return of_joints(simulated), of_joints(measured)

    @cached_property
    def moved(self) -> np.ndarray:
        """How far joints depart from going on at their first velocity, as measured, (pieces, rows, joints)."""
        return np.stack([departure(log, self.robot) for log in self.logs])


def departure(log: Log, robot: Robot) -> np.ndarray:
    """How far joints depart from going on at their first velocity, (rows, joints)."""
    position, velocity = (log.per_joint(of, robot.joints) for of in ("joint_pos", "joint_vel"))
    return position - position[:1] - velocity[:1] * (log.time - log.time[0])[:, None]


def spread_starts(logs: Sequence[Log], rows: int, pieces: int) -> list[list[int]]:
    """Starts of so many pieces in all, spread evenly over the logs."""
    each = max(1, round(pieces / len(logs)))
    return [
        np.linspace(0, len(log) - rows, each + 2)[1:-1].round().astype(int).tolist() if len(log) > rows else []
        for log in logs
    ]


def shares(errors: np.ndarray, directions: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """How much of each direction is in the errors, and the standard errors, (directions,) each.

    Arrays are (pieces, rows, joints). Each joint counts by the size of the directions over that of its errors; the
    standard errors are those of leaving out each piece in turn.
    """
    x = np.stack(list(directions), axis=-1)
    left = errors - x[..., 0] * (errors * x[..., 0]).sum() / max(float((x[..., 0] ** 2).sum()), np.finfo(float).tiny)
    weight = 1 / np.maximum((left**2).mean(axis=(0, 1)), np.finfo(float).tiny)
    gram = np.einsum("prjk,prjl,j->pkl", x, x, weight)
    product = np.einsum("prjk,prj,j->pk", x, errors, weight)

    def solve(which: np.ndarray) -> np.ndarray:
        return np.linalg.lstsq(gram[which].sum(axis=0), product[which].sum(axis=0), rcond=None)[0]

    every = np.arange(len(errors))
    parts = np.array([solve(np.delete(every, one)) for one in every])
    return solve(every), np.asarray(parts.std(axis=0) * np.sqrt(max(1, len(every) - 1)))
