"""The robots of the owners' family: their drives, motions, rates and noise."""

from dataclasses import dataclass

import numpy as np

REST_S = 1.0  # the robot holds its first set points this long before a log begins
RISE_S = 1.0  # motions reach their whole size in this time


@dataclass(frozen=True)
class OwnersRobot:
    """A robot with its drives, and how it is moved and logged."""

    model: str  # name of its model file, without the ending
    period_s: float
    length_s: float
    kp: tuple[float, ...]  # of each joint, N·m/rad, as the log says
    kd: tuple[float, ...]
    swing_rad: tuple[float, ...]  # amplitude of each joint; of a quadruped the lift and the stride of the thighs
    fastest_hz: float
    tool: str | None  # joint whose link carries a tool; None: nothing does
    tool_kg: tuple[float, float]
    tool_at: tuple[float, float, float]  # in the frame of the link, m
    noise: tuple[float, float]  # standard deviations of joint positions and velocities, rad and rad/s
    ticks: tuple[float, float] = (0.0, 0.0)  # resolution of joint positions and velocities; 0: fine
    logs_velocity: bool = True
    sends_velocity: bool = False
    policy_rows: int = 1  # rows for which the controller holds a set point
    largest_gain: float = 20.0
    longest_delay_s: float = 0.15
    largest_zero_rad: float = 0.6
    step_s: float = 0.0005

    @property
    def walks(self) -> bool:
        """Whether the robot stands on the ground."""
        return self.tool is None

    def set_points(self, time: np.ndarray, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Set points of one log at ``time`` (rows,), s, from the joint angles ``pose`` (joints,), (rows, joints)."""
        began = np.clip(time / RISE_S, 0, 1)
        growth = began**3 * (10 - 15 * began + 6 * began**2)  # without a jump of the acceleration
        if self.walks:
            # Turns of hip, thigh and calf of the legs FL, FR, RL and RR, (rows, 12): diagonals lift in turn
            lift, stride = np.array(self.swing_rad) * rng.uniform(0.8, 1.2, 2)
            cycles = self.fastest_hz * rng.uniform(0.85, 1) * time
            turns = np.zeros((len(time), 4, 3))
            for leg, half in enumerate((0.0, 0.5, 0.5, 0.0)):
                phase = (cycles + half) % 1
                raised = np.sin(np.pi * np.clip((phase - 0.6) / 0.4, 0, 1)) ** 2
                swept = np.where(phase < 0.6, 1 - phase / 0.3, -np.cos(np.pi * (phase - 0.6) / 0.4))
                turns[:, leg, 1], turns[:, leg, 2] = lift * raised - stride * swept, -2 * lift * raised
            return pose + growth[:, None] * turns.reshape(len(time), 12)
        sines = np.zeros((len(time), len(pose)))
        for of_fastest, size in ((0.15, 0.5), (0.4, 0.3), (1.0, 0.2)):
            frequency = 2 * np.pi * self.fastest_hz * of_fastest * rng.uniform(0.8, 1, len(pose))
            amplitude = size * rng.uniform(0.3, 1, len(pose)) * np.array(self.swing_rad)
            sines += amplitude * np.sin(frequency * time[:, None] + rng.uniform(0, 2 * np.pi, len(pose)))
        return pose + growth[:, None] * sines


def ur5e(period_s: float) -> OwnersRobot:
    """A UR5e whose set points come every so many seconds; its velocities are sent too."""
    return OwnersRobot(
        model="ur5e",
        period_s=period_s,
        length_s=5.0,
        kp=(800.0,) * 3 + (200.0,) * 3,
        kd=(80.0,) * 3 + (20.0,) * 3,
        swing_rad=(0.8, 0.4, 0.5, 0.8, 0.8, 1.0),
        fastest_hz=1.2,
        tool="wrist_3_joint",
        tool_kg=(0.4, 4.0),
        tool_at=(0.0, 0.16, 0.0),
        noise=(0.0001, 0.004),
        sends_velocity=True,
        largest_gain=5.0,
    )


ROBOTS = {
    "so101": OwnersRobot(
        model="so101",
        period_s=1 / 30,
        length_s=6.0,
        kp=(17.8,) * 6,
        kd=(0.0,) * 6,
        swing_rad=(0.7, 0.5, 0.6, 0.6, 0.8, 0.5),
        fastest_hz=0.9,
        tool="wrist_roll",
        tool_kg=(0.05, 0.3),
        tool_at=(0.08, 0.0, 0.0),
        noise=(0.0003, 0.0),
        ticks=(2 * np.pi / 4096, 0.0),
        logs_velocity=False,
    ),
    "ur5e_125": ur5e(0.008),
    "bench": OwnersRobot(
        model="bench",
        period_s=0.01,
        length_s=15.0,
        kp=(12.0, 8.0),
        kd=(0.8, 0.4),
        swing_rad=(0.7, 0.9),
        fastest_hz=1.5,
        tool="knee",
        tool_kg=(0.08, 0.4),
        tool_at=(0.2, 0.0, 0.0),
        noise=(0.0002, 0.005),
        ticks=(2 * np.pi / 4096, 0.024),
    ),
    "go2": OwnersRobot(
        model="go2",
        period_s=0.002,
        length_s=3.0,
        kp=(80.0,) * 12,
        kd=(2.0,) * 12,
        swing_rad=(0.4, 0.15),
        fastest_hz=2.5,
        tool=None,
        tool_kg=(0.0, 0.0),
        tool_at=(0.0, 0.0, 0.0),
        noise=(0.0003, 0.02),
        policy_rows=10,
        largest_gain=3.0,
        longest_delay_s=0.06,
        largest_zero_rad=0.15,
    ),
    "ur5e_500": ur5e(0.002),
}
"""The robots, of which cases are made in turn."""
BASE_NOISE = {"base_pos": 0.0003, "base_quat": 0.0005, "base_linvel": 0.004, "base_angvel": 0.008}
"""Standard deviations of the measured base of a robot that walks: m, rad, m/s, rad/s."""
