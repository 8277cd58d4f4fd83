"""The demo: a simulated robot with a hidden effect moves, and its logs are diagnosed against the model without it.

The robot is the package's own. It stands on its feet, bends and stretches its legs, each leg a little differently.
Effect and place are drawn from a number, so that the same number always gives the same robot.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.logs.log import Log, LogInfo
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.robot.model import Robot
from leapgap.simulation.open_loop import Course, MotionPlan, run_open_loop
from leapgap.simulation.presets import draw_values
from leapgap.simulation.sensors import SensorNoise

HIDDEN: tuple[dict[str, Any], ...] = (
    {"name": "joint_damping", "damping": (0.5, 1.0)},
    {"name": "payload", "mass_kg": (0.8, 1.6)},
    {"name": "torque_gain", "scale": (0.55, 0.7)},
    {"name": "command_delay", "location": "all", "delay_s": (0.006, 0.010)},
    {"name": "joint_friction", "torque_nm": (1.0, 2.0)},
)
"""Effects of which one is hidden, with the range of its value; at a drawn joint where it names no place."""
LOGS = 3
ROWS = 600
PERIOD_S = 0.001
KP, KD = 100.0, 2.0  # gains of the joint PD, N·m/rad and N·m·s/rad
STRETCH = 0.15  # mean share of the joint angles of the crouch that the legs are stretched by
COMMON, OWN = 0.10, 0.05  # amplitudes of that share: common to all legs, and of each leg
FREQUENCIES_HZ = (1.0, 2.5)
BEGIN_S = 0.3  # time in which the motion grows from standing


@dataclass(frozen=True)
class DemoRobot:
    """A simulated robot with a hidden effect, and the logs of its motion."""

    robot: Robot  # the robot as its model file has it, without the effect
    hidden: Effect
    logs: tuple[Log, ...]

    @property
    def answer(self) -> str:
        """The hidden effect in words, such as ``joint_damping at RR_calf: damping 0.8 N·m·s/rad``."""
        place = "" if self.hidden.location in (None, "all") else f" at {self.hidden.location}"
        values = ", ".join(
            f"{one.name} {getattr(self.hidden, one.name):.3g}{'' if one.unit == '1' else f' {one.unit}'}"
            for one in self.hidden.parameters(self.robot)
        )
        return f"{self.hidden.name}{place}: {values}"


def simulate(number: int) -> DemoRobot:
    """The robot with this number: its hidden effect and three logs of 0.6 s at 1 kHz."""
    if number < 0:
        raise InputError("--number", str(number), "0 or a larger whole number", "leave it out for the default")
    robot, rng = Robot.load(), np.random.default_rng(number)
    hidden = draw_effect(robot, rng)
    plans = [MotionPlan(f"squat_{i}", squat(robot, f"squat_{i}", rng)) for i in range(LOGS)]
    course = Course(settle_s=0.5, after_landing_s=0.0)
    return DemoRobot(robot, hidden, tuple(run_open_loop(plans, robot, (hidden,), SensorNoise(), course, rng)))


def draw_effect(robot: Robot, rng: np.random.Generator) -> Effect:
    """One effect of ``HIDDEN`` with a drawn value, at a drawn joint if it acts at one."""
    entry = draw_values(HIDDEN[int(rng.integers(len(HIDDEN)))], rng)
    if effects.known()[entry["name"]].places != "none":
        pose = robot.model.key(0).qpos[robot.joint_qpos]  # the motion moves the joints that are bent in it
        moving = [joint for joint, angle in zip(robot.joints, pose, strict=True) if angle != 0]
        entry.setdefault("location", str(rng.choice(moving)))
    return effects.from_config([entry])[0]


def squat(robot: Robot, name: str, rng: np.random.Generator) -> Log:
    """Set points of a motion as a log: the legs stretch and bend around the pose of the model's first keyframe."""
    time = np.arange(ROWS) * PERIOD_S
    pose = robot.model.key(0).qpos
    grown = np.clip(time / BEGIN_S, 0, 1)
    common = STRETCH + COMMON * sine(time, rng)
    stretch = {leg: grown * (common + OWN * sine(time, rng)) for leg in map(robot.limb_of, robot.joints)}
    columns = {"time": time}
    start = (BASE_POSITION + BASE_QUATERNION, pose[:7]), (BASE_VELOCITY + BASE_ANGULAR_VELOCITY, np.zeros(6))
    for names, values in start:
        columns |= {one: np.full(ROWS, value) for one, value in zip(names, values, strict=True)}
    for joint, angle in zip(robot.joints, pose[robot.joint_qpos], strict=True):
        position = angle * (1 - stretch[robot.limb_of(joint)])
        velocity = np.gradient(position, PERIOD_S)
        columns |= {f"{kind}_pos/{joint}": position for kind in ("cmd", "joint")}
        columns |= {f"{kind}_vel/{joint}": velocity for kind in ("cmd", "joint")}
        columns |= {f"cmd_tau/{joint}": np.zeros(ROWS)}
        columns |= {f"cmd_kp/{joint}": np.full(ROWS, KP), f"cmd_kd/{joint}": np.full(ROWS, KD)}
    return Log(name, columns, LogInfo(robot.name, PERIOD_S, "simulated by leapgap demo"))


def sine(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A sine of drawn frequency and phase at these times, s."""
    return np.sin(2 * np.pi * (rng.uniform(*FREQUENCIES_HZ) * time + rng.uniform()))
