"""Motions that robots of the benchmark make beside the jumps: plans of commands, drawn by seed, from a keyframe."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
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
    """Commands of a joint PD from the model's first keyframe; a kind draws what differs from plan to plan."""

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


@dataclass(frozen=True)
class SumOfSines(PlannedMotion):
    """A sum of sines at each joint about the keyframe, with amplitudes and phases drawn for each plan."""

    frequencies_hz: list[float]
    swing: list[float]  # largest departure of each joint from the keyframe, rad (m for slides), or one number for all
    onset_s: float  # the motion grows from rest over this time

    def commands(self, time: np.ndarray, pose: np.ndarray, robot: Robot, rng: np.random.Generator) -> PlannedCommands:
        """Set points within the joints' ranges, and the torque that holds them against gravity in the model."""
        joints, waves = len(robot.joints), len(self.frequencies_hz)
        size = rng.uniform(0.4, 1.0, (waves, joints))
        phase = rng.uniform(0, 2 * np.pi, (waves, joints))
        angle = 2 * np.pi * np.asarray(self.frequencies_hz)[:, None] * time[:, None, None]
        wave = (size * np.sin(angle + phase)).sum(axis=1)
        wave *= np.broadcast_to(self.swing, joints) / np.abs(wave).max(axis=0)
        position = pose + rise(time, self.onset_s)[:, None] * wave
        # Refuse it where planned joint positions (rows, joints) leave the range of a joint
        for i, joint in enumerate(robot.joints):
            number = robot.model.joint(joint).id
            low, high = robot.model.jnt_range[number]
            if robot.model.jnt_limited[number] and not (low <= position[:, i].min() and position[:, i].max() <= high):
                found = f"{joint} from {position[:, i].min():.3g} to {position[:, i].max():.3g}"
                raise InputError("motion.swing", found, f"within {low:.3g} and {high:.3g}", "make it smaller")
        # Torques that hold a robot of a fixed base at joint positions (rows, joints), N·m, (rows, joints)
        model, data = robot.model, mujoco.MjData(robot.model)
        torque = np.empty_like(position)
        for row, angles in enumerate(position):
            data.qpos[robot.joint_qpos] = angles
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, data.qfrc_bias)
            torque[row] = data.qfrc_bias[robot.joint_dofs]
        return PlannedCommands(position, torque)


@dataclass(frozen=True)
class Trot(PlannedMotion):
    """A trot about the pose of the keyframe; frequency, lift and stride are drawn for each plan.

    A leg in the air bends its ``bending`` joint by twice as much as its ``lifting`` joint turns forward, so that the
    foot rises straight where both links are of one length. On the ground the lifting joint sweeps the foot back.
    """

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


MOTIONS: dict[str, type[PlannedMotion]] = {"sines": SumOfSines, "trot": Trot}
"""Kinds of motions, as ``kind`` of a class of cases names them."""
