"""What an experiment starts from."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.logs.log import Log
from leapgap.logs.state import motion_of
from leapgap.robot.model import Robot

MOST_PLACES, MOST_PLACES_FLOATING = 3, 1  # Number of sets of joints that are moved by themselves


@dataclass(frozen=True)
class Given:
    """What experiments start from: the logs, the robot, and where the causes that are to be told apart act."""

    logs: tuple[Log, ...]  # The logs, of which each has the rows that are judged
    robot: Robot
    places: tuple[str, ...] = ()  # Locations of the causes, without doubles

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that the logs command, in the order of the robot."""
        return tuple(joint for joint in self.robot.joints if f"cmd_kp/{joint}" in self.logs[0])

    @property
    def is_jumps(self) -> bool:
        """Whether every log is a jump to a stated target."""
        return all("target" in log.info.extra for log in self.logs)

    @property
    def is_even(self) -> bool:
        """Whether all rows last one period, so that commands can be planned on it."""
        return all(log.is_even for log in self.logs)

    @property
    def has_gains(self) -> bool:
        """Whether a joint PD acts anywhere."""
        return any(bool(log.per_joint("cmd_kp").any()) for log in self.logs)

    def median(self, quantity: str) -> dict[str, float]:
        """Median of a commanded quantity over all logs, by joint."""
        return {
            joint: float(np.median(np.concatenate([log[f"{quantity}/{joint}"] for log in self.logs])))
            for joint in self.joints
        }

    @cached_property
    def fastest(self) -> float:
        """Largest speed of a joint in the logs, rad/s, of those that are commanded."""
        motions = [motion_of(log, self.robot) for log in self.logs]
        dofs = self.robot.joint_dofs[[self.robot.joints.index(joint) for joint in self.joints]]
        return max(float(np.percentile(np.abs(motion.qvel[:, dofs]), 99)) for motion in motions)

    @cached_property
    def pose(self) -> np.ndarray:
        """The state at rest that sines are about, (nq + nv,).

        That of a standing robot is its first row; the median pose of a robot that is held.
        """
        model, motions = self.robot.model, [motion_of(log, self.robot) for log in self.logs]
        state = np.concatenate([motions[0].qpos[0], np.zeros(model.nv)])
        if not self.robot.has_free_base:
            state[: model.nq] = np.median(np.concatenate([motion.qpos for motion in motions]), axis=0)
        return state

    @property
    def sine_places(self) -> list[tuple[str, ...]]:
        """Sets of joints to move: those of the causes' places that are smaller than the robot, then all."""
        robot, found = self.robot, []
        singles = robot.joint_groups if robot.has_free_base and robot.joint_groups else self.joints
        for location in (*self.places, *singles):
            if location in robot.feet or location == "all":
                continue
            joints = tuple(robot.joints[i] for i in robot.joints_at(location) if robot.joints[i] in self.joints)
            if joints and joints != self.joints and joints not in found:
                found.append(joints)
        return [*found[: MOST_PLACES_FLOATING if robot.has_free_base else MOST_PLACES], self.joints]
