"""Other descriptions of the same robot as hypotheses: each is judged as it is, without a fitted number."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from leapgap.diagnosis.closure import Interval
from leapgap.diagnosis.gap import HeldOutGap, final_position_errors, motion_squares
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.mixed_descriptions import Mix, best_mix
from leapgap.errors import InputError
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class DescriptionFigures:
    """What another description of the robot makes of the gap."""

    robot: str  # Name of its file; of a mix, which parts of it stand in the robot that was given
    gap: float
    closure: Interval  # Beside the robot that was given; of logs by their own clock, with what that clock closes
    landing_misplaced_cm: float | None
    """Mean absolute error of the trunk's x in the last judged row; None without a base."""

    def to_json(self) -> dict[str, Any]:
        """Its entry of ``report.json``."""
        return asdict(self)


def judge_descriptions(robots: Sequence[Robot], heldout_gap: HeldOutGap) -> list[DescriptionFigures]:
    """Replay the logs by each robot, and by the given one with parts of it; what closes most comes first."""
    found = []
    for robot in robots:
        whole = judge_description(robot, heldout_gap)
        mix = best_mix(heldout_gap.judged.robot, robot, heldout_gap)
        found.append(whole)
        if mix is not None and heldout_gap.gap(mix.squares) < whole.gap:
            found.append(judge_mix(mix, whole.robot, heldout_gap))
    return sorted(found, key=lambda one: one.gap)


def judge_mix(mix: Mix, name: str, heldout_gap: HeldOutGap) -> DescriptionFigures:
    """Figures of the given robot with parts of the description of this name."""
    judged = heldout_gap.judged
    motions = heldout_gap.replayer.motions(judged.whole_trials([(mix.effect,)] * len(judged.logs)))
    said = f"{', '.join(mix.effect.parts)} of {name}"
    return figures_of(said, mix.squares, final_position_errors(motions, judged), heldout_gap)


def judge_description(robot: Robot, heldout_gap: HeldOutGap) -> DescriptionFigures:
    """Replay the logs by one robot, in the same rows and channels."""
    judged = described(robot, heldout_gap.judged)
    motions = heldout_gap.replayer.with_robot(robot).motions(judged.whole_trials())
    name = robot.path.name if robot.path else robot.name
    return figures_of(name, motion_squares(motions, judged), final_position_errors(motions, judged), heldout_gap)


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
