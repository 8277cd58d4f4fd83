"""The errors of owners' robots, logs and model files, each with a random size at a random place."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from leapgap.validation.owners.plant import Run
from leapgap.validation.owners.robots import OwnersRobot

ALL = "all"
TOLD_VELOCITY = r"velocit.*(late|lag|behind|filter|smooth|coarse|quanti|resol|steps of)"
TOLD_SET_POINTS = r"(set.?point|command)s?.*(held|hold|coarse|repeat|stay|every)"
TOLD_LIMIT = r"(torque|ask).*(more than|beyond|above|exceed)"  # how a check may say it, in words of any version


@dataclass(frozen=True)
class Error:
    """One error: its name, and what it changes."""

    name: str  # name of the effect that it is, or of the fact about the log
    location: str = ALL
    parameters: dict[str, float] = field(default_factory=dict)
    drive: dict[str, Any] = field(default_factory=dict)  # fields of the robot's ``OwnersDrive``
    spec: Callable[[mujoco.MjSpec], None] | None = None
    model: Callable[[mujoco.MjModel], None] | None = None
    file_limit: np.ndarray | None = None  # largest torques that the model file states, (joints,), N·m
    held_rows: int = 1  # rows for which the log repeats a set point while the robot has every one
    velocity: Callable[[np.ndarray, float], np.ndarray] | None = None  # logged from true ones, by the period
    same: tuple[str, ...] = ()  # effects that do just the same on this robot
    told: str | None = None  # words by which a check may tell it; None: no check can
    is_fact: bool = False  # whether it is of the log alone, so that no effect is to be named


@dataclass(frozen=True)
class Situation:
    """What sizes are drawn by: the robot, its joints, and its motion without errors."""

    robot: OwnersRobot
    joints: tuple[str, ...]
    limit: np.ndarray
    inertia: np.ndarray  # of each joint where no other moves, kg·m²
    run: Run
    dofs: np.ndarray  # degrees of freedom of the joints
    rng: np.random.Generator

    @property
    def torque(self) -> np.ndarray:
        """Largest torque of each joint in the motion, N·m."""
        return np.abs(self.run.torque).max(0)

    @property
    def speed(self) -> np.ndarray:
        """Largest speed of each joint in the motion, rad/s."""
        return np.abs(self.run.speed).max(0)

    def size(self, least: float, most: float) -> float:
        """A size whose logarithm is drawn evenly."""
        return round(float(least * (most / least) ** self.rng.uniform()), 4)

    def sign(self) -> float:
        """Plus or minus one."""
        return float(self.rng.choice([-1.0, 1.0]))

    def joint(self) -> int:
        """A joint whose motor has something to do."""
        return int(self.rng.choice(np.flatnonzero(self.torque >= 0.15 * self.torque.max())))

    def place(self) -> tuple[str, np.ndarray]:
        """All joints or one of them, and which, bool (joints,)."""
        if self.rng.random() < 0.5:
            return ALL, np.ones(len(self.joints), dtype=bool)
        at = self.joint()
        return self.joints[at], self.only(at, True, False)

    def only(self, at: int, value: Any, others: Any = 0.0) -> np.ndarray:
        """A number of one joint, and another of the others, (joints,)."""
        return np.where(np.arange(len(self.joints)) == at, value, others)

    def gain(self, least: float, most: float) -> float:
        """A gain that is clearly not one."""
        return self.size(least, 0.75) if self.rng.random() < 0.4 else self.size(1.35, most)


def position_gain(s: Situation) -> Error:
    """The stiffness that acts is not the one that is logged."""
    (place, at), scale = s.place(), s.gain(0.3, s.robot.largest_gain)
    same = () if any(s.robot.kd) else ("torque_gain",)
    return Error("position_gain", place, {"scale": scale}, {"position_gain": np.where(at, scale, 1.0)}, same=same)


def velocity_gain(s: Situation) -> Error:
    """The damping of the drive that acts is not the one that is logged."""
    (place, at), scale = s.place(), s.gain(0.3, min(5.0, s.robot.largest_gain))
    same = () if s.robot.sends_velocity else ("joint_damping",)
    return Error("velocity_gain", place, {"scale": scale}, {"velocity_gain": np.where(at, scale, 1.0)}, same=same)


def gravity_compensation(s: Situation) -> Error:
    """The drive carries the weight by itself."""
    share = round(float(s.rng.uniform(0.5, 1)), 3)
    return Error("gravity_compensation", ALL, {"share": share}, {"gravity": share})


def command_delay(s: Situation) -> Error:
    """Set points arrive late."""
    delay = s.size(0.025, s.robot.longest_delay_s)
    return Error("command_delay", ALL, {"delay_s": delay}, {"delay_s": delay})


def set_point_filter(s: Situation) -> Error:
    """The drive smooths its set points."""
    time_constant = s.size(0.025, s.robot.longest_delay_s)
    return Error("set_point_filter", ALL, {"time_constant_s": time_constant}, {"filter_s": time_constant})


def set_point_slew(s: Situation) -> Error:
    """The drive moves its set points no faster than this."""
    rate = round(float(s.speed.max() * s.rng.uniform(0.3, 0.7)), 3)
    return Error("set_point_slew", ALL, {"rate_rad_s": rate}, {"slew_rad_s": rate})


def encoder_bias(s: Situation) -> Error:
    """The zero of one encoder is off."""
    at, bias = s.joint(), s.sign() * s.size(0.05, s.robot.largest_zero_rad)
    return Error("encoder_bias", s.joints[at], {"bias_rad": bias}, {"zero": s.only(at, bias)})


def torque_offset(s: Situation) -> Error:
    """A constant torque at one joint."""
    at = s.joint()
    torque = s.sign() * round(float(s.torque[at] * s.rng.uniform(0.2, 0.6)), 4)
    return Error("torque_offset", s.joints[at], {"torque_nm": torque}, {"offset": s.only(at, torque)})


def torque_limit(s: Situation) -> Error:
    """The model file states less than a motor gives, or the drive gives less than the file states."""
    at = s.joint()
    capped = s.only(at, s.torque * s.rng.uniform(0.4, 0.7), s.limit)
    if s.rng.random() < 0.5:
        scale = float(s.limit[at] / capped[at])
        return Error("torque_limit", s.joints[at], {"scale": scale}, file_limit=capped, told=TOLD_LIMIT)
    return Error("torque_limit", s.joints[at], {"scale": float(capped[at] / s.limit[at])}, {"limit": capped})


def duty_limit(s: Situation) -> Error:
    """The largest torque of a motor falls with its speed."""
    at = s.joint()
    torque, speed = s.run.torque[:, at], s.run.speed[:, at]
    driving = torque * speed > 0
    needed = (1 - np.abs(torque) / s.limit[at])[driving] / np.abs(speed[driving])
    droop = round(float(np.quantile(needed, s.rng.uniform(0.1, 0.4))), 4)
    lost, same = {"droop": s.only(at, droop)}, ("torque_speed_limit",)
    return Error("duty_limit", s.joints[at], {"droop_s_rad": droop}, lost, same=same)


def supply_sag(s: Situation) -> Error:
    """All torques fall where the motors together give much."""
    load = float((np.abs(s.run.torque) / s.limit).mean(1).max())
    sag = round(float(s.rng.uniform(0.2, 0.6)) / load, 4)
    return Error("supply_sag", ALL, {"share": sag}, {"sag": sag})


def link_payload(s: Situation) -> Error:
    """A tool that the model does not have."""
    mass, tool = s.size(*s.robot.tool_kg), str(s.robot.tool)

    def carry(spec: mujoco.MjSpec) -> None:
        link = spec.joint(tool).parent
        carried = link.add_body(name="tool", pos=s.robot.tool_at)
        carried.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.02, 0, 0], mass=mass, contype=0, conaffinity=0)

    return Error("link_payload", tool, {"mass_kg": mass}, spec=carry)


def joint_friction(s: Situation) -> Error:
    """More Coulomb friction than the model has."""
    place, at = s.place()
    torque = round(float(s.torque[at].min() * s.size(0.1, 0.4)), 4)
    return Error("joint_friction", place, {"torque_nm": torque}, model=added("dof_frictionloss", torque, s, at))


def joint_damping(s: Situation) -> Error:
    """More viscous friction than the model has."""
    place, at = s.place()
    damping = round(float((s.torque / s.speed)[at].min() * s.size(0.1, 0.5)), 4)
    return Error("joint_damping", place, {"damping": damping}, model=added("dof_damping", damping, s, at))


def armature(s: Situation) -> Error:
    """Heavier rotors than the model has."""
    place, at = s.place()
    inertia = round(float(s.inertia[at].min() * s.size(0.3, 2.0)), 5)
    return Error("armature", place, {"inertia": inertia}, model=added("dof_armature", inertia, s, at))


def added(numbers: str, value: float, s: Situation, at: np.ndarray) -> Callable[[mujoco.MjModel], None]:
    """Adds to a number of the model by joint."""

    def add(model: mujoco.MjModel) -> None:
        getattr(model, numbers)[s.dofs[at]] += value

    return add


def contact_damping(s: Situation) -> Error:
    """Feet that damp less, or more, at the same stiffness."""
    ratio = s.size(0.1, 0.4) if s.rng.random() < 0.5 else s.size(2.5, 6.0)

    def soften(model: mujoco.MjModel) -> None:
        time, damping = model.geom_solref[:, 0].copy(), model.geom_solref[:, 1].copy()
        model.geom_solref[:, 1] = damping * ratio
        model.geom_solref[:, 0] = time / ratio  # MuJoCo's stiffness is 1 / (time · damping)²

    return Error("contact_damping", ALL, {"ratio": ratio}, model=soften)


def velocity(s: Situation) -> Error:
    """Velocities of the log are late, filtered or coarse; the drive has the true ones."""
    kind, size = str(s.rng.choice(["late", "filtered", "coarse"])), s.size(0.03, 0.07)

    def logged(true: np.ndarray, period_s: float) -> np.ndarray:
        time = np.arange(len(true)) * period_s
        if kind == "coarse":
            step = 3 * size
            return np.round(true / step) * step
        if kind == "late":
            return np.stack([np.interp(time - size, time, one) for one in true.T], axis=1)
        blend, shown = 1 - np.exp(-period_s / size), true.copy()
        for row in range(1, len(true)):
            shown[row] = shown[row - 1] + blend * (true[row] - shown[row - 1])
        return shown

    name = f"velocity_{kind}"
    return Error(name, ALL, {"size": size}, velocity=logged, told=TOLD_VELOCITY, is_fact=True)


def set_points(s: Situation) -> Error:
    """The log repeats set points while the robot has every one."""
    rows = s.robot.policy_rows if s.robot.policy_rows > 1 else int(s.rng.integers(4, 9))
    return Error("set_points_held", ALL, {"rows": rows}, held_rows=rows, told=TOLD_SET_POINTS, is_fact=True)


DRIVES = (position_gain, command_delay, encoder_bias, torque_limit, duty_limit, supply_sag)
JOINTS = (joint_friction, joint_damping, armature)
HELD = (*DRIVES, *JOINTS, set_point_filter, set_point_slew, torque_offset, link_payload)
OF_ROBOT: Mapping[str, tuple[Callable[[Situation], Error], ...]] = {
    "so101": HELD,
    "ur5e_125": (*HELD, velocity_gain, gravity_compensation, velocity, set_points),
    "ur5e_500": (*HELD, velocity_gain, gravity_compensation, velocity, set_points),
    "bench": (*HELD, velocity_gain, gravity_compensation, velocity, velocity, set_points),
    "go2": (*DRIVES, *JOINTS, velocity_gain, contact_damping, set_points),
}
"""What may be wrong with each robot, its log and its file."""
