"""Other descriptions of the same robot as hypotheses: each is judged as it is, without a fitted number."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from leapgap.diagnosis.gap import HeldOutGap, Interval, final_position_errors, motion_squares
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.errors import InputError
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class DescriptionFigures:
    """What another description of the robot makes of the gap."""

    robot: str
    """Name of its file."""
    gap: float
    closure: Interval
    """Beside the robot that was given; of logs by their own clock, with what that clock closes."""
    landing_misplaced_cm: float | None
    """Mean absolute error of the trunk's x in the last judged row; None without a base."""

    def to_json(self) -> dict[str, Any]:
        """Its entry of ``report.json``."""
        return asdict(self)


def judge_descriptions(robots: Sequence[Robot], heldout_gap: HeldOutGap) -> list[DescriptionFigures]:
    """Replay the logs by each robot; the one that closes most comes first."""
    found = [judge_description(robot, heldout_gap) for robot in robots]
    return sorted(found, key=lambda one: one.gap)


def judge_description(robot: Robot, heldout_gap: HeldOutGap) -> DescriptionFigures:
    """Replay the logs by one robot, in the same rows and channels."""
    judged = described(robot, heldout_gap.judged)
    motions = heldout_gap.replayer.with_robot(robot).motions(judged.whole_trials())
    squares = motion_squares(motions, judged)
    off = final_position_errors(motions, judged)
    landing = 100 * float(np.mean(np.abs(off))) if off else None
    name = robot.path.name if robot.path else robot.name
    return DescriptionFigures(name, heldout_gap.gap(squares), heldout_gap.closure(squares), landing)


def described(robot: Robot, judged: JudgedLogs) -> JudgedLogs:
    """The same logs, rows and channels with another description of their robot; ``InputError`` for another robot."""
    if robot.joints != judged.robot.joints or robot.has_free_base != judged.robot.has_free_base:
        raise InputError(
            "diagnose.robots",
            f"{robot.name} with the joints {', '.join(robot.joints)}",
            f"another description of {judged.robot.name}, with its joints {', '.join(judged.robot.joints)}",
            "leave it out, or name its joints so",
        )
    return replace(judged, robot=robot)
