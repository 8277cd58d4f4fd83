"""Planned jumps as one HTML page: each in four pictures, with its cost and its constraint violation."""

import json
from pathlib import Path

from leapgap.jumping.reports.keyframes import keyframes
from leapgap.logs.log import read_log
from leapgap.reports.page import render_page
from leapgap.robot.model import Robot


def html(folder: Path, robot: Robot) -> str:
    """The page of a folder of references with its index."""
    jumps = []
    for entry in json.loads((folder / "references.json").read_text()):
        jump = read_log(folder / entry["file"])
        torque = jump.per_joint("cmd_tau", robot.joints)
        drawn = {
            "strip": keyframes(jump, robot),
            "apex_m": float(jump["base_pos_z"].max()),
            "torque_nm": float(abs(torque).max()),
        }
        jumps.append(entry | drawn)
    return render_page(Path(__file__).with_name("references.html"), {}, jumps=jumps)
