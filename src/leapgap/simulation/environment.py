"""The corrected robot as a Gymnasium environment, with its delays, motors and sensors."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.simulation.simulator import Reading, Simulator

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:
    raise InputError("lg.Environment", "no gymnasium", "the extra gym", "pip install 'leapgap[gym]'") from error


class Environment(gymnasium.Env[np.ndarray, np.ndarray]):
    """Set points of the joint PD are the actions, readings of the sensors the observations.

    A subclass says what a task is: ``reward`` and ``is_over``. As it stands there is no reward, and an episode ends
    when its time is over.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # as Gymnasium declares it

    def __init__(
        self,
        robot: Robot | Path | str,
        effects: Sequence[Effect] = (),
        period_s: float = 0.02,
        kp: np.ndarray | float = 20.0,
        kd: np.ndarray | float = 0.5,
        seconds: float = 10.0,
        start_noise: float = 0.0,
    ) -> None:
        """As ``Simulator``, with the gains of the joint PD and the length of an episode.

        ``start_noise``: standard deviation of the first joint positions, rad.
        """
        self.simulator = Simulator(robot, effects, period_s)
        self.kp, self.kd, self.start_noise = kp, kd, start_noise
        self.most_steps = max(1, round(seconds / period_s))
        first = self.simulator.reset()
        own = self.simulator.robot
        joints = [own.model.joint(joint) for joint in self.simulator.joints]
        ranges = [joint.range if own.model.jnt_limited[joint.id] else (-np.pi, np.pi) for joint in joints]
        low, high = np.array(ranges, np.float64).T
        self.action_space = spaces.Box(low, high, dtype=np.float64)
        self.observation_space = spaces.Box(-np.inf, np.inf, first.vector.shape, np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode at the model's first keyframe, or at ``options["start"]``, as ``Simulator.reset``."""
        super().reset(seed=seed)
        start = (options or {}).get("start")
        if start is None and self.start_noise:
            start = self.simulator._rest()
            at = self.simulator.robot.joint_qpos
            start[at] += self.start_noise * self.np_random.standard_normal(len(at))
        reading = self.simulator.reset(start)
        return reading.vector, {"time_s": reading.time_s}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """Hold a set point for one control period."""
        reading = self.simulator.step(np.asarray(action, float), kp=self.kp, kd=self.kd)
        info = {"time_s": reading.time_s}
        late = self.simulator.steps >= self.most_steps
        return reading.vector, self.reward(reading, action), self.is_over(reading), late, info

    def reward(self, reading: Reading, action: np.ndarray) -> float:
        """Reward of a step, by what the sensors report at its end."""
        return 0.0

    def is_over(self, reading: Reading) -> bool:
        """Whether the episode has ended before its time, such as by a fall."""
        return False
