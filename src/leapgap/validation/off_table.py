"""Off-table effects: the diagnosis has no hypothesis for them, so the right verdict is ``unknown``.

They may act at every simulation step and keep a state of their own.
"""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from leapgap.effects.base import Commands, Effect, parameter, recompute_constants
from leapgap.effects.contacts import foot_geoms
from leapgap.errors import InputError
from leapgap.logs.log import Log
from leapgap.logs.schema import BASE_POSITION
from leapgap.registry import subclasses
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.presets import BentCalf

COGS = 40  # cogging periods per turn of the joint: rotor slots behind the gear give more, planet gears fewer
TOOTH_STIFFNESS = 4000.0  # stiffness of the teeth in contact, N·m/rad
TOOTH_DAMPING = 2.0  # damping of the teeth in contact, N·m·s/rad
SLOSH_HZ = 2.5
SLOSH_DAMPING_RATIO = 0.1
BATTERY_PLAY_M = 0.03
BATTERY_FRICTION = 0.15  # friction of the loose battery on its tray, as a share of its weight
GRAVITY = 9.81
ANCHOR_M = np.array([-1.0, 0.0, 0.4])  # anchor of the tether from the trunk's first place, m: behind and above
DRAG_AREA = 0.1  # ½ ρ c_d A of a quadruped from the front, N·s²/m²: about 0.6 kg/m³ × 1.3 × 0.12 m²
STICKY_M = 0.005  # height above the ground up to which the floor holds a foot
RISING_M_S = 0.02  # speed of a rising foot from which the floor holds with its whole force
LOSSES_SEED = 20_240_229
BURST_S = 0.012  # length of a burst in which all commands are lost
Process = Callable[[mujoco.MjModel, mujoco.MjData], None]
"""Called before every simulation step, after applied forces were set to zero.

It adds forces or changes the model, which belongs to this run alone.
"""


@dataclass(frozen=True)
class OffTableEffect(Effect):
    """An effect outside ``leapgap.effects``, the table of hypotheses of a diagnosis."""

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """The process that acts at each step of one jump; ``None`` where the methods ``change_…`` do everything."""
        return None


@dataclass(frozen=True)
class Crosstalk(OffTableEffect):
    """Current sensors that also feel the neighbour on their board: a joint gets a share of the next motor's torque.

    Next in the leg, from the body outwards; the last joint's neighbour is the first one.
    """

    name = "crosstalk"
    places = "joints"

    share: float = parameter(0.0, "1", 0.0, 0.5)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Add to each joint at the location what its neighbour's motor delivered in the last step."""
        at = robot.joints_at(self.location)
        dofs, neighbours = robot.joint_dofs[at], robot.joint_actuators[[neighbour(robot, int(joint)) for joint in at]]

        def leak(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[dofs] += self.share * np.asarray(data.actuator_force[neighbours])

        return leak


def neighbour(robot: Robot, joint: int) -> int:
    """Index of the joint that is next to a joint (index) in its limb."""
    for members in robot.topology.limbs.values():
        if robot.joints[joint] in members:
            return robot.joints.index(members[(members.index(robot.joints[joint]) + 1) % len(members)])
    return joint


@dataclass(frozen=True)
class CableSpring(OffTableEffect):
    """Stiff cables across the joints: a spring about the joint angles of the crouch."""

    name = "cable_spring"
    places = "joints"

    stiffness_nm_rad: float = parameter(0.0, "N·m/rad", 0.0, 30.0)

    def change_model(self, model: mujoco.MjModel, robot: Robot) -> None:
        """Set stiffness and rest angle of the joints."""
        for dof in robot.joint_dofs[robot.joints_at(self.location)]:
            joint = int(model.dof_jntid[dof])
            address = int(model.jnt_qposadr[joint])
            model.jnt_stiffness[joint] = self.stiffness_nm_rad
            if model.nkey:
                model.qpos_spring[address] = robot.model.key_qpos[0, address]


@dataclass(frozen=True)
class Motors:
    """The motors of a location with their joint PD, as the model has them when this is made."""

    actuators: np.ndarray
    dofs: np.ndarray
    qpos: np.ndarray  # indices of the motors and of their joints in the model, (motors,) each
    gain: np.ndarray  # (motors,), N·m per unit of control
    bias: np.ndarray  # (motors, 3): constant, N·m per rad and N·m per rad/s
    limit: np.ndarray  # (motors, 2) least and largest torque, N·m

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: Robot, location: str) -> "Motors":
        """The motors of a location with copies of the model's numbers."""
        at = robot.joints_at(location)
        actuators = robot.joint_actuators[at]
        return cls(
            actuators,
            robot.joint_dofs[at],
            robot.joint_qpos[at],
            model.actuator_gainprm[actuators, 0].copy(),
            model.actuator_biasprm[actuators, :3].copy(),
            model.actuator_forcerange[actuators].copy(),
        )

    def torque(self, data: mujoco.MjData) -> np.ndarray:
        """Torques that the motors give in the present state, (motors,), N·m."""
        q, v = data.qpos[self.qpos], data.qvel[self.dofs]
        torque = self.gain * data.ctrl[self.actuators] + self.bias[:, 1] * q + self.bias[:, 2] * v
        return np.clip(torque, self.limit[:, 0], self.limit[:, 1])


@dataclass(frozen=True)
class Backlash(OffTableEffect):
    """Play in the gears: the rotor turns freely within it before its teeth push the link.

    The joint's armature is the rotor; encoder and joint PD sit at the link.
    """

    name = "backlash"
    places = "joints"

    play_rad: float = parameter(0.0, "rad", 0.0, 0.15)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Drive a rotor, integrated here, with the motor's torque, and the link with the torque of the teeth."""
        motors = Motors.of(model, robot, self.location)
        dofs, inertia = motors.dofs, model.dof_armature[motors.dofs].copy()
        model.actuator_gainprm[motors.actuators], model.actuator_biasprm[motors.actuators] = 0.0, 0.0
        model.dof_armature[dofs] = 0.0
        mujoco.mj_setConst(model, mujoco.MjData(model))
        rotor: dict[str, np.ndarray] = {}

        def mesh(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            q, v = data.qpos[motors.qpos], data.qvel[dofs]
            if not rotor:
                rotor["q"], rotor["v"] = q.copy(), v.copy()
            twist = rotor["q"] - q
            beyond = twist - np.clip(twist, -self.play_rad / 2, self.play_rad / 2)
            teeth = np.where(beyond != 0, TOOTH_STIFFNESS * beyond + TOOTH_DAMPING * (rotor["v"] - v), 0.0)
            rotor["v"] = rotor["v"] + model.opt.timestep * (motors.torque(data) - teeth) / inertia
            rotor["q"] = rotor["q"] + model.opt.timestep * rotor["v"]
            data.qfrc_applied[dofs] += teeth

        return mesh


@dataclass(frozen=True)
class Cogging(OffTableEffect):
    """A torque that ripples with the joint's angle q: amplitude · sin(40 q); its mean is zero."""

    name = "cogging"
    places = "joints"

    amplitude_nm: float = parameter(0.0, "N·m", 0.0, 10.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Add the ripple torque at the joints of the location."""
        at = robot.joints_at(self.location)
        dofs, qpos = robot.joint_dofs[at], robot.joint_qpos[at]

        def ripple(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[dofs] += self.amplitude_nm * np.sin(COGS * data.qpos[qpos])

        return ripple


@dataclass(frozen=True)
class DeadBand(OffTableEffect):
    """A driver that gives no small currents: of a torque τ the joint gets what is left of its size beyond the band.

    Unlike dry friction it takes from torques at rest as well, and does nothing while the motor is idle.
    """

    name = "dead_band"
    places = "joints"

    torque_nm: float = parameter(0.0, "N·m", 0.0, 6.0)

    def process(self, model: mujoco.MjModel, robot: Robot, jump: Log) -> Process | None:
        """Take the band away from what the motors of the location give."""
        motors = Motors.of(model, robot, self.location)

        def take(model: mujoco.MjModel, data: mujoco.MjData) -> None:
            data.qfrc_applied[motors.dofs] -= np.clip(motors.torque(data), -self.torque_nm, self.torque_nm)

        return take


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
        omega = 2 * np.pi * SLOSH_HZ
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


KINDS: list[type[OffTableEffect] | type[BentCalf]] = [*subclasses(OffTableEffect), BentCalf]
FAMILIES = {kind.name: kind for kind in sorted(KINDS, key=lambda kind: kind.name)}
"""All off-table effects by name, in alphabetical order; the bent calf is in ``leapgap.simulation.presets``."""


def family(name: str) -> type[OffTableEffect] | type[BentCalf]:
    """The off-table effect of this name; an unknown name is an ``InputError``."""
    if name not in FAMILIES:
        raise InputError("withhold", f"off-table effect {name}", f"one of {', '.join(FAMILIES)}", "correct the name")
    return FAMILIES[name]
