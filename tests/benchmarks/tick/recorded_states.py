"""States of logged jumps at the updates of the MPC."""

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.task import schedule_of, target_of
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate


def estimates(jump: Log, robot: Robot) -> list[StateEstimate]:
    """What the controller would have been told at each update of a logged jump."""
    position, quaternion, velocity = (jump.stack(c) for c in (BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY))
    joint_pos, joint_vel = (jump.per_joint(c, robot.joints) for c in ("joint_pos", "joint_vel"))
    turning = np.stack([0 * jump.time, jump["base_angvel_y"], 0 * jump.time], axis=1)
    touching = np.ones(len(robot.feet), dtype=bool)
    rows = [int(np.argmin(np.abs(jump.time - t))) for t in np.arange(0, schedule_of(jump).take_off_s - 1e-6, 0.025)]
    measured = (position, quaternion, velocity, turning, joint_pos, joint_vel)
    return [StateEstimate(0.025 * i, *(part[row] for part in measured), touching) for i, row in enumerate(rows)]


def nearest(jump: Log, targets: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """The target (x, z), m, that is nearest to that of a jump."""
    own = target_of(jump)
    return min(targets, key=lambda target: math.dist(target, (own.x_m, own.z_m)))


def recorded_jumps(robot: Robot, needed: int = 4) -> tuple[str, list[tuple[Reference, list[StateEstimate]]]]:
    """Jumps with the reference nearest to their target: published ones, where there are some, else simulated ones."""
    references = {
        (target_of(j).x_m, target_of(j).z_m): Reference.of(j, robot)
        for j in jump_log.read_logs(Path("data/references/own"))
    }
    for folder in ("published", "simulated"):
        path = Path("data/jumps") / folder
        jumps = jump_log.read_logs(path) if path.is_dir() else []
        if references and len(jumps) >= needed:
            return folder, [(references[nearest(jump, references)], estimates(jump, robot)) for jump in jumps]
    raise InputError("data", f"no {needed} jumps, or no reference", "those of the pipeline", "run dvc repro first")
