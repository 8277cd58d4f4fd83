"""Interface of a controller: at each control tick it takes a state estimate and returns joint commands."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StateEstimate:
    """State of the robot as the controller gets it at one tick: measured, noisy and delayed. SI units."""

    time_s: float  # time since the first row
    base_position: np.ndarray  # origin of the base in the world, (3,)
    base_quaternion: np.ndarray  # base to world, w x y z, (4,)
    base_velocity: np.ndarray  # of that origin, in the world, (3,)
    base_angular_velocity: np.ndarray  # in base axes, as a gyro, (3,)
    joint_pos: np.ndarray  # (joints,), rad, joint order of the robot
    joint_vel: np.ndarray  # (joints,), rad/s
    foot_contact: np.ndarray  # whether each foot touches, bool, (feet,), foot order of the robot


@dataclass(frozen=True)
class Command:
    """Joint commands until the next tick: feed-forward torque and joint PD; shape (joints,) each."""

    torque: np.ndarray  # feed-forward, N·m
    position: np.ndarray  # set point, rad
    velocity: np.ndarray  # set point, rad/s
    kp: np.ndarray  # N·m/rad
    kd: np.ndarray  # N·m·s/rad
    planned_force: np.ndarray  # u_mpc, the ground force that the feed-forward stands for, front x z, rear x z, N, (4,)


class Controller(ABC):
    """Controller of one robot. It may keep a state, so each run gets a new one."""

    @abstractmethod
    def command(self, estimate: StateEstimate) -> Command:
        """Command for this tick; called once a control period, in order of time."""
