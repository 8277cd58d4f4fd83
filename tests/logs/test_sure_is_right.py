"""Nothing that a proposed map calls sure is wrong, over logs that strangers may write: drawn ones, and traps."""

import re
from pathlib import Path

import pytest

from leapgap.logs.map_proposal.evidence import SURE
from leapgap.logs.map_proposal.report import propose_map
from leapgap.robot.model import Robot
from tests.logs import foreign_logs

CLAIMS = {
    "time": r"time is \S+ in (\S+):",
    "positions": r"positions are in ([^:]+):",
    "velocities": r"velocities are in ([^:]+):",
    "cmd_pos": r"cmd_pos is in ([^:,]+)[:,]",
    "quaternion": r"the quaternion of the base is (\S \S \S \S)",
    "gyro": r"the gyro is in ([^:]+):",
}
"""What a sentence under Sure claims, and the value in it."""
MODELS = {"arm": foreign_logs.arm_xml, "quadruped": foreign_logs.quadruped_xml}


def sure_and_wrong(sentences: list[str], truth: dict[str, str]) -> list[str]:
    """Sentences that are not true, or that claim what this test knows nothing of."""
    wrong = []
    for sentence in sentences:
        found = {claim: match[1] for claim, pattern in CLAIMS.items() if (match := re.match(pattern, sentence))}
        if not found or any(truth.get(claim) != value for claim, value in found.items()):
            wrong.append(sentence)
    return wrong


def robot_of(name: str, folder: Path) -> Robot:
    path = folder / f"{name}.xml"
    path.write_text(MODELS[name]())
    return Robot.load(path)


@pytest.mark.parametrize("number", range(100))
def test_nothing_sure_is_wrong_in_drawn_logs(number: int, tmp_path: Path) -> None:
    name, foreign, format = foreign_logs.drawn(number)
    robot = robot_of(name, tmp_path)
    found = propose_map(foreign_logs.write(tmp_path, foreign, format), robot).proposal
    assert sure_and_wrong(found.notes_of(SURE), foreign.truth) == []
