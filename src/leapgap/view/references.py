"""Planned jumps as one HTML page: each in four pictures, with its cost and what holds."""

import json
from pathlib import Path

from leapgap.recording.jump import read
from leapgap.robot.model import Robot
from leapgap.view.page import rendered
from leapgap.view.strip import strip


def html(folder: Path, robot: Robot) -> str:
    """The page of a folder of references with its index."""
    jumps = []
    for entry in json.loads((folder / "references.json").read_text()):
        jump = read(folder / entry["file"])
        torque = jump.per_joint("cmd_tau", robot.joints)
        drawn = {
            "strip": strip(jump, robot),
            "apex_m": float(jump["base_pos_z"].max()),
            "torque_nm": float(abs(torque).max()),
        }
        jumps.append(entry | drawn)
    return rendered("references.html", {}, jumps=jumps)
