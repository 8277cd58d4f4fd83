"""How far logged joints go beyond the ranges of a model: no real stop lets a joint far through.

Model files often have ranges that nothing of the robot has, such as ±π for a joint that turns freely. A replay would
be held at an end where the robot went on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.logs.log import Log
from leapgap.robot.model import Robot

BEYOND = 0.05  # a stop yields, and encoders have biases: beyond an end by a larger share of the range, it is none
ROWS = 3  # so many rows have to lie there: a single one may be an outlier
YIELDS_S = 0.1  # so long they have to last, s: a leg thrown against a stop comes back sooner (MuJoCo's in 0.02 s)


@dataclass(frozen=True)
class Reach:
    """How far a joint of some logs goes beyond its range in the model."""

    joint: str
    lowest: float
    highest: float  # of the logs, rad or m, without what lasts less than ``ROWS`` or ``YIELDS_S``
    range: tuple[float, float]  # ends of the joint's range in the model, rad or m

    @property
    def beyond(self) -> float:
        """How far it goes beyond its range, as a share of the range; 0 within."""
        low, high = self.range
        return max(low - self.lowest, self.highest - high, 0.0) / (high - low)

    @property
    def leaves(self) -> bool:
        """Whether it goes so far that the ends of the range are no stops."""
        return self.beyond > BEYOND

    @property
    def says(self) -> str:
        """Where the joint was, and the range that the model has."""
        low, high = self.range
        furthest = self.highest if self.highest - high > low - self.lowest else self.lowest
        return f"{self.joint} was logged at {furthest:.3g}, outside of {low:.3g} to {high:.3g}, the model's range"


def reaches(logs: Sequence[Log], robot: Robot) -> list[Reach]:
    """How far each joint that is logged and has a range goes."""
    model, found = robot.model, []
    for joint in robot.joints:
        at, column = model.joint(joint).id, f"joint_pos/{joint}"
        rows = [(np.sort(log[column]), max(ROWS, log.info.rows(YIELDS_S))) for log in logs if column in log]
        lasting = [(of[few - 1], of[-few]) for of, few in rows if len(of) >= few]
        if model.jnt_limited[at] and lasting:
            low, high = (float(end) for end in model.jnt_range[at])
            lowest, highest = min(least for least, _ in lasting), max(most for _, most in lasting)
            found.append(Reach(joint, float(lowest), float(highest), (low, high)))
    return found


def without_false_stops(logs: Sequence[Log], robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """The robot without the ends of ranges that logs go far beyond, and a sentence on each such joint."""
    left = [reach for reach in reaches(logs, robot) if reach.leaves]
    if not left:
        return robot, ()
    said = tuple(f"{reach.says}: replays have no stops there" for reach in left)
    return replace(robot, unstopped=(*robot.unstopped, *(reach.joint for reach in left))), said
