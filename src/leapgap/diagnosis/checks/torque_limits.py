"""Do the logs ask for more torque than the model's motors give, and did the robot deliver it?"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.diagnosis.checks.base import Check, CheckResult, have_joints
from leapgap.diagnosis.checks.pieces import MOST, Pieces, shares
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.logs.state import commanded_torque
from leapgap.robot.model import Robot

WINDOW_S = 0.03  # Length of the pieces that begin where more is asked than the model gives
ROWS = 4  # They have so many rows at least
SURE = 3.0  # Standard errors by which a robot delivers more than the limit, or not all that is asked
TOLD = 3  # So many joints are told, those with the most such rows
NOISE = 3.0
"""More is asked than the limit where it is more by so many standard deviations of what measurements make of it."""
LIKE_ASKED = 2.0
"""A measured torque that is so many times as large as what was asked, or as small, is of another unit or sign."""


@dataclass(frozen=True)
class Unlimited(Effect):
    """Motors that give whatever is asked."""

    name = "unlimited"

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Take the limits of all motors away."""
        model.actuator_forcelimited[robot.joint_actuators] = 0


class TorqueLimits(Check):
    """Torque beyond a model's limit that the robot delivered shows that the limit is too low.

    The statistic is the share of what was asked beyond the limit that the robot delivered: 0 for a robot that is
    limited as its model is, 1 for one that is not limited there. It is taken from the measured torque, where there is
    one, else from the motion in short pieces: those replayed with the limit and without.
    """

    name = "torque_limits"
    threshold = 0.5
    place = 7
    velocities_in_time = True

    def run(self, logs: Sequence[Log], robot: Robot | None, threshold: float) -> CheckResult | None:
        """Count rows beyond a limit, and see what the robot did there."""
        if robot is None or not have_joints(logs, robot.joints):
            return None
        limited = np.isfinite(robot.torque_limits) & robot.driven
        joints = tuple(
            joint for joint, has in zip(robot.joints, limited, strict=True) if has and joint in logs[0].joints
        )
        if not joints or any(f"joint_vel/{joint}" not in log for log in logs for joint in joints):
            return None
        limits = robot.torque_limits[[robot.joints.index(joint) for joint in joints]]
        asked = [commanded_torque(log, joints) for log in logs]
        if not any(of_log.any() for of_log in asked) or min(map(len, asked)) < ROWS:
            return None
        beyond = [np.abs(of_log) > limits + NOISE * noise(of_log) for of_log in asked]
        per_log = {log.name: float(rows.any(axis=1).mean()) for log, rows in zip(logs, beyond, strict=True)}
        every = np.concatenate(beyond)
        if not every.any():
            says = "no sample commands more torque than the model's limit"
            return CheckResult(self.name, True, 0.0, threshold, says, per_log)
        largest = np.max([np.abs(of_log).max(axis=0) for of_log in asked], axis=0)
        share, worst = every.mean(axis=0), np.argsort(-every.mean(axis=0), kind="stable")[:TOLD]
        says = f"{100 * every.any(axis=1).mean():.2g} % of the samples command more torque than the model's limit: "
        says += "; ".join(
            f"{joints[k]} {100 * share[k]:.2g} % of the samples, {largest[k]:.3g} of {limits[k]:.3g} N·m at most"
            for k in worst.tolist()
            if share[k] > 0
        )
        others = int((share > 0).sum()) - len(worst)
        says += f"; {others} other joints less often" if others > 0 else ""
        told = measured_share(logs, joints, asked, beyond, limits) or moved_share(logs, robot, beyond)
        if told is None:
            return CheckResult(self.name, True, 0.0, threshold, says, per_log)
        given, error, by = told
        delivered = given > threshold and given > SURE * error
        withheld = -SURE * error < given < threshold and 1 - given > SURE * error  # less than none: something else acts
        says += (
            f"; by {by} the robot delivered it ({100 * given:.0f} ± {100 * error:.0f} %): the model's limit is too low"
            if delivered
            else f"; by {by} the robot did not deliver it ({100 * given:.0f} ± {100 * error:.0f} %)"
            if withheld
            else f"; {by} does not show whether the robot delivered it"
        )
        return CheckResult(self.name, not delivered, max(0.0, given) if delivered else 0.0, threshold, says, per_log)


def noise(asked: np.ndarray) -> np.ndarray:
    """Standard deviation of the noise of torques (rows, joints) that a PD makes of noisy measurements, (joints,)."""
    return np.asarray(np.median(np.abs(np.diff(asked, n=2, axis=0)), axis=0) / 0.6745 / np.sqrt(6))


def measured_share(
    logs: Sequence[Log],
    joints: Sequence[str],
    asked: Sequence[np.ndarray],
    beyond: Sequence[np.ndarray],
    limits: np.ndarray,
) -> tuple[float, float, str] | None:
    """Share of the torque beyond the limits that the measured torque shows, its standard error, and by what.

    None without a measured torque, or with one that is not what was asked within the limits either.
    """
    if any(f"tau/{joint}" not in log for log in logs for joint in joints):
        return None
    more, excess, product, square = [], [], 0.0, 0.0
    for log, of_log, rows in zip(logs, asked, beyond, strict=True):
        measured = log.per_joint("tau", tuple(joints))
        sign = np.sign(of_log)
        more.append((measured * sign - limits)[rows])
        excess.append((np.abs(of_log) - limits)[rows])
        product += float((measured * of_log)[~rows].sum())
        square += float((of_log**2)[~rows].sum())
    if not 1 / LIKE_ASKED < product / max(square, np.finfo(float).tiny) < LIKE_ASKED:
        return None
    y, x = np.concatenate(more), np.concatenate(excess)
    share = float(y @ x / (x @ x))
    return share, float(np.sqrt(np.mean((y - share * x) ** 2) / (x @ x))), "the measured torque"


def moved_share(logs: Sequence[Log], robot: Robot, beyond: Sequence[np.ndarray]) -> tuple[float, float, str] | None:
    """The same by the motion of pieces that begin where a limit is first passed; None where there are too few."""
    rows = max(ROWS, logs[0].info.rows(WINDOW_S))
    starts = []
    for log_beyond in beyond:
        at = np.flatnonzero(log_beyond.any(axis=1))
        own: list[int] = []
        for row in at.tolist():
            if not own or row >= own[-1] + rows:
                own.append(row)
        starts.append(own)
    if sum(map(len, starts)) < MOST // 8:
        return None
    pieces = Pieces.of(logs, robot, starts, rows)
    if len(pieces.logs) < MOST // 8:
        return None
    (limited, measured), (free, _) = pieces.motions(), pieces.motions(effects=(Unlimited(),))
    (share,), (error,) = shares(measured - limited, [free - limited])
    return float(share), float(error), "the motion"
