"""An open-loop trot of a quadruped: diagonal legs in turn, by joint angles alone."""

from dataclasses import dataclass

import numpy as np

from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.validation.motions.base import PlannedCommands, PlannedMotion, rise


@dataclass(frozen=True)
class Trot(PlannedMotion):
    """A trot about the pose of the keyframe; frequency, lift and stride are drawn for each plan.

    A leg in the air bends its ``bending`` joint by twice as much as its ``lifting`` joint turns forward, so that the
    foot rises straight where both links are of one length. On the ground the lifting joint sweeps the foot back.
    """

    name = "trot"

    diagonals: list[list[str]]  # limbs that step together, in two lists
    lifting: str  # joint group that carries the upper link
    bending: str  # joint group that carries the lower link
    frequency_hz: list[float]  # least and most steps of a leg in a second
    lift_rad: list[float]  # least and most turn of the lifting joints in the air; the sign bends or straightens a leg
    stride_rad: list[float]  # least and most turn of the lifting joints in half a step; positive walks forward
    duty: float  # share of a step in which a foot is on the ground; above one half both diagonals stand in between
    still_s: float  # the robot stands this long before the trot begins
    onset_s: float  # steps grow to their whole size over this time

    def commands(self, time: np.ndarray, pose: np.ndarray, robot: Robot, rng: np.random.Generator) -> PlannedCommands:
        """Set points of one gait, without feed-forward torque."""
        frequency, lift, stride = (
            float(rng.uniform(least, most)) for least, most in (self.frequency_hz, self.lift_rad, self.stride_rad)
        )
        growth = rise(time - self.still_s, self.onset_s)
        position = np.tile(pose, (len(time), 1))
        for half, limbs in enumerate(self.diagonals):
            raised, swept = steps(frequency * time + half / 2, self.duty)
            for limb in limbs:
                position[:, joint_at(limb, self.lifting, robot)] += growth * (lift * raised - stride * swept)
                position[:, joint_at(limb, self.bending, robot)] -= 2 * growth * lift * raised
        return PlannedCommands(position, np.zeros_like(position))


def steps(cycles: np.ndarray, duty: float) -> tuple[np.ndarray, np.ndarray]:
    """Height of a foot, from 0 to 1, and its place from 1 in front to −1 behind, over counted steps (rows,)."""
    phase = cycles % 1
    air = np.clip((phase - duty) / (1 - duty), 0, 1)
    return np.sin(np.pi * air) ** 2, np.where(phase < duty, 1 - 2 * phase / duty, -np.cos(np.pi * air))


def joint_at(limb: str, group: str, robot: Robot) -> int:
    """Index of the joint of a limb in a group; ``InputError`` where there is not just one."""
    both = set(robot.joints_at(limb).tolist()) & set(robot.joints_at(group).tolist())
    if len(both) != 1:
        expected = "one joint of each group in each limb"
        raise InputError("motion", f"{len(both)} joints of {limb} in the group {group}", expected, "correct the names")
    return both.pop()
