"""A motion of the benchmark: plans of commands, drawn by seed, from the pose of the model's first keyframe."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from leapgap.diagnosis.experiment_plans import planned
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class PlannedCommands:
    """What a plan asks of the joints, (rows, joints) each."""

    position: np.ndarray  # set points of the joint PD, rad (m for slides)
    torque: np.ndarray  # feed-forward, N·m


@dataclass(frozen=True)
class PlannedMotion(ABC):
    """Commands of a joint PD from a keyframe; a kind draws what differs from plan to plan."""

    name: ClassVar[str]

    plans: int  # number of different plans, from which each case draws its own
    seed: int  # seed of the plans, which do not know the cases
    length_s: float
    sample_period_s: float
    kp: list[float]  # N·m/rad of each joint, or one number for all
    kd: list[float]  # N·m·s/rad of each joint, or one number for all

    @abstractmethod
    def commands(self, time: np.ndarray, pose: np.ndarray, robot: Robot, rng: np.random.Generator) -> PlannedCommands:
        """Commands of one plan at ``time`` (rows,), s, from the joint angles ``pose`` (joints,), where it rests."""

    @staticmethod
    def start(robot: Robot) -> np.ndarray:
        """Positions of the model's first keyframe with the lowest foot on the ground, at rest, (nq + nv,)."""
        if not robot.model.nkey:
            raise InputError(robot.path, "no keyframe", "one with the pose that motions start from", "add a keyframe")
        state = np.concatenate([robot.model.key_qpos[0], np.zeros(robot.model.nv)])
        if robot.stands:
            feet = feet_positions(robot, state[None, : robot.model.nq])[0]
            state[2] += robot.ground_height - float((feet[:, 2] - robot.foot_radius).min())
        return state

    def draw(self, robot: Robot) -> list[Log]:
        """The plans, as logs of commands whose measured columns hold the first state."""
        rng = np.random.default_rng(self.seed)
        time = np.arange(round(self.length_s / self.sample_period_s) + 1) * self.sample_period_s
        start = self.start(robot)
        pose = start[robot.joint_qpos]
        kp, kd = (per_joint(gains, robot, key) for gains, key in ((self.kp, "kp"), (self.kd, "kd")))
        logs = []
        for number in range(self.plans):
            asked = self.commands(time, pose, robot, rng)
            speed = np.gradient(asked.position, self.sample_period_s, axis=0)
            columns: dict[str, np.ndarray] = {}
            for i, joint in enumerate(robot.joints):
                values = {"tau": asked.torque[:, i], "pos": asked.position[:, i], "vel": speed[:, i]}
                values |= {"kp": np.full(len(time), kp[i]), "kd": np.full(len(time), kd[i])}
                columns |= {f"cmd_{quantity}/{joint}": np.ascontiguousarray(v) for quantity, v in values.items()}
            info = LogInfo(robot.name, self.sample_period_s, "a planned motion")
            logs.append(planned(f"plan_{number}", columns, start, info, robot))
        return logs


def per_joint(gains: Sequence[float], robot: Robot, key: str) -> np.ndarray:
    """Gains of all joints, (joints,), from one for each or one for all."""
    if len(gains) not in (1, len(robot.joints)):
        expected = f"one number, or one for each of {', '.join(robot.joints)}"
        raise InputError(f"motion.{key}", f"{len(gains)} numbers", expected, "correct them")
    return np.broadcast_to(np.asarray(gains, dtype=float), len(robot.joints))


def rise(time: np.ndarray, length_s: float) -> np.ndarray:
    """A factor that grows smoothly from 0 to 1 over some seconds, (rows,)."""
    share = np.clip(time / length_s, 0, 1)
    return np.asarray(share**2 * (3 - 2 * share))
