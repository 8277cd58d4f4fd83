"""The border of a controller: what it is told is judged before it is used, and what it sends is safe in any case.

A value that no robot can have counts as not measured (NaN), for which every controller has a substitute. A tick without
a usable time repeats the last command for a short while, and then damps the joints. Both end with the first tick whose
time is usable again.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from leapgap.jumping.task import JointGains
from leapgap.logs.pair_force import by_pair, flat
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.simulation.controller import Command, StateEstimate

TIME_NOT_USABLE = "time not usable"
LARGEST = {"base_position": 1e4, "base_velocity": 1e2, "base_angular_velocity": 1e3, "joint_pos": 1e2, "joint_vel": 1e4}
"""Largest absolute value that can have been measured: m, m/s, rad/s, rad, rad/s."""
QUATERNION_NORMS = (0.9, 1.1)
LONGEST_GAP_S = 1.0  # Longest time between two ticks that follow each other
LARGEST_TIME_S = 1e9
NUMBERS = (int, float, np.floating, np.integer)
FLOAT, BOOL = np.dtype(np.float64), np.dtype(bool)


HOLD_TICKS = 20  # Ticks without a usable time for which the last command is repeated
DAMPING = JointGains(0.0, 3.0)  # Joint gains after that; velocities are brought to zero


class Border:
    """Judges the estimates of one controller, tick by tick."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.limit_nm = robot.torque_limits
        self.limited_ticks = 0
        """Ticks whose torques ``within_limits`` shrank; what is sent then is still the controller's own command."""
        self.joints_of_pair = [robot.joints_at(pair) for pair in PAIRS]
        self._sizes = dict.fromkeys(("base_position", "base_velocity", "base_angular_velocity"), 3)
        self._sizes |= {name: len(robot.joints) for name in ("joint_pos", "joint_vel")}
        self._used_s: float | None = None
        self._seen_s: float | None = None
        self._since_used = 0
        self._offset_s = 0.0
        self._last: Command | None = None
        self.newest: StateEstimate | None = None  # What ``judged`` returned last

    def judged(self, estimate: StateEstimate) -> StateEstimate | None:
        """The estimate, its impossible values NaN; None where its time cannot be used.

        A usable time follows that of the last used tick, or that of the tick before, by at most ``LONGEST_GAP_S``: one
        wrong time is left out, and a clock that was set is followed from its second tick on. The time of the returned
        estimate then goes on where it was, a tick's length for each tick, so that no jump begins or ends by it.
        """
        self.newest = self._judged(estimate)
        return self.newest

    def _judged(self, estimate: StateEstimate) -> StateEstimate | None:
        time_s, seen_s = number(estimate.time_s), self._seen_s
        self._seen_s = time_s if math.isfinite(time_s) else None
        self._since_used += 1
        if not math.isfinite(time_s) or abs(time_s) > LARGEST_TIME_S:
            return None
        if self._used_s is not None and not follows(time_s + self._offset_s, self._used_s):
            if seen_s is None or time_s == seen_s or not follows(time_s, seen_s):
                return None
            self._offset_s = self._used_s + self._since_used * (time_s - seen_s) - time_s
        self._used_s, self._since_used = time_s + self._offset_s, 0
        return self._possible(estimate)

    def sent(self, command: Command) -> Command:
        """Remember a command as the last one."""
        self._last = command
        return command

    def safe_command(self) -> Command:
        """Command of a tick without a usable time: the last one, later damping of all joints."""
        if self._last is not None and self._since_used <= HOLD_TICKS:
            return self._last
        zero = np.zeros(len(self.robot.joints))
        pose = zero if self._last is None else self._last.position
        return Command(zero, pose, zero, zero + DAMPING.kp_nm_per_rad, zero + DAMPING.kd_nms_per_rad, np.zeros(4))

    def within_limits(self, torque: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Feed-forward torques (joints,) and pair forces (4,), shrunk and counted where the motors cannot deliver them.

        The torques and the force of a pair shrink by one factor, so that the force keeps its direction, and with it the
        friction cone.
        """
        if (np.abs(torque) <= self.limit_nm).all():
            return torque, force
        share = np.ones(len(PAIRS))
        for pair, joints in enumerate(self.joints_of_pair):
            largest = float((np.abs(torque[joints]) / self.limit_nm[joints]).max(initial=0.0))
            share[pair] = min(1.0, 1.0 / largest) if largest > 0 else 1.0
        if (share == 1.0).all():
            return torque, force
        self.limited_ticks += 1
        shrunk = torque.copy()
        for pair, joints in enumerate(self.joints_of_pair):
            shrunk[joints] = np.clip(torque[joints] * share[pair], -self.limit_nm[joints], self.limit_nm[joints])
        return shrunk, flat(by_pair(force) * share[:, None])

    def _possible(self, estimate: StateEstimate) -> StateEstimate:
        """The estimate without impossible values; the same object where there are none."""
        changes: dict[str, Any] = {"time_s": self._used_s} if self._offset_s else {}
        for name, size in self._sizes.items():
            value = getattr(estimate, name)
            largest = LARGEST[name]
            if not (is_vector(value, size) and is_within(value, largest)):
                changes[name] = possible(value, size, largest)
        quaternion = estimate.base_quaternion
        if not is_vector(quaternion, 4):
            changes["base_quaternion"] = quaternion = possible(quaternion, 4, QUATERNION_NORMS[1])
        if not QUATERNION_NORMS[0] <= math.hypot(*quaternion) <= QUATERNION_NORMS[1]:
            changes["base_quaternion"] = np.full(4, np.nan)
        feet = estimate.foot_contact
        if not (type(feet) is np.ndarray and feet.shape == (len(self.robot.feet),) and feet.dtype == BOOL):
            changes["foot_contact"] = np.zeros(len(self.robot.feet), bool)
        return replace(estimate, **changes) if changes else estimate


def follows(time_s: float, before_s: float) -> bool:
    """Whether a time can be that of the tick after another one."""
    return 0.0 <= time_s - before_s <= LONGEST_GAP_S


def number(value: object) -> float:
    """A value as a float; NaN where it is no real number, or an integer beyond all floats."""
    if not isinstance(value, NUMBERS) or isinstance(value, bool):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.nan


def is_vector(value: object, size: int) -> bool:
    """Whether a value is an array of that many floats; one of a subclass, whose entries may be masked, is not."""
    return type(value) is np.ndarray and value.shape == (size,) and value.dtype == FLOAT


def is_within(vector: np.ndarray, largest: float) -> bool:
    """Whether no entry of a vector is larger; its length is tried first, which takes a third of the time."""
    return math.hypot(*vector.tolist()) <= largest or bool(np.abs(vector).max() <= largest)


def possible(value: object, size: int, largest: float) -> np.ndarray:
    """The entries of a vector that can have been measured, the others NaN.

    All are NaN where it is no vector of that many real numbers; texts that read as numbers are none.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        return np.full(size, np.nan)
    if array.shape != (size,) or array.dtype.kind not in "fiu":
        return np.full(size, np.nan)
    with np.errstate(invalid="ignore", over="ignore"):
        vector = array.astype(np.float64)
        if isinstance(value, np.ma.MaskedArray):
            vector[np.ma.getmaskarray(value)] = np.nan
        return np.where(np.abs(vector) <= largest, vector, np.nan)
