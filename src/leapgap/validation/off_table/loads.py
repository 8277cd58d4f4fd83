"""Off-table effects on the body, from outside, and on what is measured."""

from abc import abstractmethod
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Commands, parameter, recompute_constants
from leapgap.effects.contacts import foot_geoms
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.validation.off_table.base import OffTableEffect, Process

SLOSH_HZ = 2.5
SLOSH_DAMPING_RATIO = 0.1
BATTERY_PLAY_M = 0.03
BATTERY_FRICTION = 0.15  # friction of the loose battery on its tray, as a share of its weight
GRAVITY = 9.81


@dataclass(frozen=True)
class MovingMass(OffTableEffect):
    """Part of the trunk's mass on a slide along the trunk's x axis."""

    needs_base = True

    mass_kg: float = parameter(0.0, "kg", 0.0, 3.0)

    def change_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        """Add the body last, so that the indices of the robot's own bodies and joints stay."""
        body = spec.bodies[robot.base_body].add_body()
        body.name, body.pos = self.name, robot.model.body_ipos[robot.base_body]
        body.explicitinertial, body.mass, body.inertia = True, 1.0, [1e-4] * 3
        slide = body.add_joint()
        slide.name, slide.type, slide.axis = self.name, mujoco.mjtJoint.mjJNT_SLIDE, [1.0, 0.0, 0.0]
        slide.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        slide.range = [-BATTERY_PLAY_M, BATTERY_PLAY_M]

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Take the mass from the trunk and give it to the slide."""
        if self.is_nominal:
            return
        body = model.body(self.name).id
        model.body_mass[robot.base_body] -= self.mass_kg
        model.body_mass[body] = self.mass_kg
        self.mount(model, model.joint(self.name).id)
        recompute_constants(model)

    @abstractmethod
    def mount(self, model: mujoco.MjModel, joint: int) -> None:
        """Set the forces and limits that hold the mass in its place."""


@dataclass(frozen=True)
class SloshingPayload(MovingMass):
    """A half-full tank: a mass on a soft, hardly damped spring."""

    name = "sloshing_payload"

    def mount(self, model: mujoco.MjModel, joint: int) -> None:
        """Mount the mass on a spring with the natural frequency of the liquid."""
        omega = 2 * 3.141592653589793 * SLOSH_HZ
        model.jnt_stiffness[joint] = self.mass_kg * omega**2
        model.dof_damping[model.jnt_dofadr[joint]] = 2 * SLOSH_DAMPING_RATIO * self.mass_kg * omega
        model.jnt_range[joint] = [-0.12, 0.12]


@dataclass(frozen=True)
class LooseBattery(MovingMass):
    """A battery that slides in its tray, from stop to stop, against a little friction."""

    name = "loose_battery"

    def mount(self, model: mujoco.MjModel, joint: int) -> None:
        """Set the friction of the tray; its stops are the limits of the slide."""
        model.dof_frictionloss[model.jnt_dofadr[joint]] = BATTERY_FRICTION * self.mass_kg * GRAVITY


ANCHOR_M = np.array([-1.0, 0.0, 0.4])  # anchor of the tether from the trunk's first place, m: behind and above
DRAG_AREA = 0.1  # ½ ρ c_d A of a quadruped from the front, N·s²/m²: about 0.6 kg/m³ × 1.3 × 0.12 m²
STICKY_M = 0.005  # height above the ground up to which the floor holds a foot
RISING_M_S = 0.02  # speed of a rising foot from which the floor holds with its whole force


@dataclass(frozen=True)
class Tether(OffTableEffect):
    """A safety line, slack at the start, that pulls the trunk back like a spring once it is taut."""

    name = "tether"
    needs_base = True

    stiffness_n_m: float = parameter(0.0, "N/m", 0.0, 500.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Pull at the origin of the trunk."""
        anchor = jump.stack(BASE_POSITION)[0] + ANCHOR_M
        slack = float(np.linalg.norm(ANCHOR_M))
        body = robot.base_body

        def pull(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            line = anchor - data.xpos[body]
            length = float(np.linalg.norm(line))
            if length > slack:
                force = self.stiffness_n_m * (length - slack) * line / length
                mujoco.mj_applyFT(model, data, force, np.zeros(3), data.xpos[body], body, data.qfrc_applied)

        return pull


@dataclass(frozen=True)
class Wind(OffTableEffect):
    """Steady wind along x, positive from behind: drag of the trunk in the wind less its drag in still air."""

    name = "wind"
    needs_base = True

    speed_m_s: float = parameter(0.0, "m/s", -20.0, 20.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Push at the trunk's centre of mass."""
        body, wind = robot.base_body, np.array([self.speed_m_s, 0.0, 0.0])

        def blow(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            still = -data.qvel[:3]
            air = wind + still
            data.xfrc_applied[body, :3] += DRAG_AREA * (np.linalg.norm(air) * air - np.linalg.norm(still) * still)

        return blow


@dataclass(frozen=True)
class StickyFloor(OffTableEffect):
    """A floor of glue or suction: it pulls down a foot that leaves it, over the first millimetres."""

    name = "sticky_floor"
    places = "feet"

    force_n: float = parameter(0.0, "N", 0.0, 150.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Hold the feet at the location, each with up to the whole force."""
        geoms = foot_geoms(model, robot, self.location)
        radius = model.geom_size[geoms, 0]
        last: dict[int, float] = {}

        def hold(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            for geom, size in zip(geoms, radius, strict=True):
                centre = data.geom_xpos[geom]
                # Height of the stated ground under a point, m
                tops = [
                    box.top_m
                    for box in jump.info.terrain
                    if abs(centre[0] - box.x_m) < box.size_m[0] / 2 and abs(centre[1] - box.y_m) < box.size_m[1] / 2
                ]
                height = centre[2] - size - max(tops, default=0.0)
                rising = (height - last.get(int(geom), height)) / model.opt.timestep
                last[int(geom)] = height
                if height < STICKY_M and rising > 0:
                    force = np.array([0.0, 0.0, -self.force_n * min(1.0, rising / RISING_M_S)])
                    body = int(model.geom_bodyid[geom])
                    mujoco.mj_applyFT(model, data, force, np.zeros(3), centre, body, data.qfrc_applied)

        return hold


LOSSES_SEED = 20_240_229
BURST_S = 0.012  # length of a burst in which all commands are lost


@dataclass(frozen=True)
class TiltedImu(OffTableEffect):
    """An inertial unit mounted askew in pitch: orientation is reported nose-down by a constant."""

    name = "tilted_imu"
    needs_base = True

    tilt_rad: float = parameter(0.0, "rad", -0.3, 0.3)

    def change_measured(self, motion: Motion, period_s: float, robot: Robot) -> Motion:
        """Turn the reported orientation about the base's y axis."""
        return self._turned(motion, self.tilt_rad)

    def true_start(self, start: Motion, robot: Robot) -> Motion:
        """Turn the logged orientation back by the tilt: the true first state."""
        return self._turned(start, -self.tilt_rad)

    def _turned(self, motion: Motion, angle: float) -> Motion:
        turn = np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
        qpos: np.ndarray = motion.qpos.copy()
        for row in qpos:
            level = row[3:7].copy()
            mujoco.mju_mulQuat(row[3:7], level, turn)
        return replace(motion, qpos=qpos)


@dataclass(frozen=True)
class PacketLoss(OffTableEffect):
    """Bursts of lost commands: the joints keep the last command that arrived."""

    name = "packet_loss"

    share: float = parameter(0.0, "1", 0.0, 0.8)

    def change_commands(self, commands: Commands, period_s: float, robot: Robot) -> Commands:
        """Repeat the last command through each burst; the bursts are the same on every jump of equal length."""
        rows, burst = len(commands.torque), max(1, round(BURST_S / period_s))
        bursts = np.random.default_rng(LOSSES_SEED).random(-(-rows // burst)) < self.share
        lost = np.repeat(bursts, burst)[:rows]
        lost[:1] = False
        last_received = np.maximum.accumulate(np.where(lost, 0, np.arange(rows)))
        return commands.each(lambda sent: sent[last_received])
