"""A robot with its drives in plain MuJoCo: a joint PD written by hand, stepped by itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np


@dataclass(frozen=True)
class Drive:
    """What a robot's drives do; arrays are by joint. Errors change its fields from what the log and the model say."""

    kp: np.ndarray
    kd: np.ndarray
    limit: np.ndarray
    """Largest torque, N·m."""
    position_gain: np.ndarray
    """Acting over logged gain."""
    velocity_gain: np.ndarray
    zero: np.ndarray
    """Measured − true position, rad."""
    offset: np.ndarray
    """Torque that is added, N·m."""
    droop: np.ndarray
    """Share of the largest torque that is lost per rad/s."""
    gravity: float = 0.0
    """Share of the weight that the drives carry by themselves."""
    delay_s: float = 0.0
    filter_s: float = 0.0
    """Time constant of the filter of set points."""
    slew_rad_s: float = np.inf
    """Fastest change of set points."""
    sag: float = 0.0
    """Share of all torques that is lost where every motor gives its largest."""

    @staticmethod
    def of(kp: Sequence[float], kd: Sequence[float], limit: np.ndarray) -> "Drive":
        """Drives that do what the log and the model say."""
        one, none = np.ones(len(kp)), np.zeros(len(kp))
        return Drive(np.array(kp), np.array(kd), limit, one, one, none, none, none)


@dataclass(frozen=True)
class Plant:
    """A robot: its compiled model and its drives."""

    model: mujoco.MjModel
    drive: Drive

    @property
    def joints(self) -> np.ndarray:
        """Numbers of the joints that have a motor, in the order of the model."""
        return np.sort(self.model.actuator_trnid[:, 0])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of these joints."""
        return tuple(self.model.joint(joint).name for joint in self.joints)

    def run(self, position: np.ndarray, velocity: np.ndarray, period_s: float, step_s: float, rest_rows: int) -> "Run":
        """Motion under set points (rows, joints); the first ``rest_rows`` rows are not logged."""
        model, data = self.model, mujoco.MjData(self.model)
        still = mujoco.MjData(model)
        at, dofs, drive = model.jnt_qposadr[self.joints], model.jnt_dofadr[self.joints], self.drive
        steps = int(np.ceil(period_s / step_s - 1e-9))
        model.opt.timestep = dt = period_s / steps
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)  # the drives are below
        data.qpos[:] = model.key_qpos[0]
        data.qpos[at] -= drive.zero
        target = position[0].copy()
        blend = 1 - np.exp(-dt / drive.filter_s) if drive.filter_s else 1.0
        weight = np.zeros(model.nv)
        qpos, qvel, torques = [], [], []
        for row in range(len(position)):
            for step in range(steps):
                if step == 0 and row >= rest_rows:
                    qpos.append(data.qpos.copy())
                    qvel.append(data.qvel.copy())
                sent = max(0, int(np.floor(row + (step * dt - drive.delay_s) / period_s + 1e-9)))
                target += np.clip(blend * (position[sent] - target), -drive.slew_rad_s * dt, drive.slew_rad_s * dt)
                q, speed = data.qpos[at], data.qvel[dofs]
                torque = drive.kp * drive.position_gain * (target - q - drive.zero) + drive.offset
                torque = torque + drive.kd * drive.velocity_gain * (velocity[sent] - speed)
                if drive.gravity:
                    still.qpos[:] = data.qpos
                    mujoco.mj_kinematics(model, still)
                    mujoco.mj_comPos(model, still)
                    mujoco.mj_rne(model, still, 0, weight)
                    torque = torque + drive.gravity * weight[dofs]
                if drive.sag:
                    torque = torque * (1 - min(0.9, drive.sag * np.mean(np.abs(torque) / drive.limit)))
                lost = drive.droop * speed
                torque = np.clip(torque, -drive.limit * np.maximum(0, 1 + lost), drive.limit * np.maximum(0, 1 - lost))
                data.qfrc_applied[dofs] = torque
                mujoco.mj_step(model, data)
                if step == 0 and row >= rest_rows:
                    torques.append(torque)
        return Run(np.array(qpos), np.array(qvel), np.array(torques), at, dofs, drive.zero)


@dataclass(frozen=True)
class Run:
    """A motion: one row a control period."""

    qpos: np.ndarray
    qvel: np.ndarray
    torque: np.ndarray
    """(rows, joints), N·m."""
    at: np.ndarray
    """Where the joints stand in ``qpos``."""
    dofs: np.ndarray
    zero: np.ndarray

    @property
    def shown(self) -> np.ndarray:
        """Joint positions as the encoders show them, (rows, joints), rad."""
        return self.qpos[:, self.at] + self.zero

    @property
    def speed(self) -> np.ndarray:
        """Joint velocities, (rows, joints), rad/s."""
        return self.qvel[:, self.dofs]


def build(
    file: Path,
    drive: Drive,
    rng: np.random.Generator | None = None,
    specs: Sequence[Callable[[mujoco.MjSpec], None]] = (),
    changes: Sequence[Callable[[mujoco.MjModel], None]] = (),
) -> Plant:
    """The robot of a model file with errors in it; with ``rng`` its numbers depart from the file by small amounts."""
    spec = mujoco.MjSpec.from_file(str(file))
    for change in specs:
        change(spec)
    model = spec.compile()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    sizes = {
        "body_mass": 0.005,
        "dof_damping": 0.1,
        "dof_frictionloss": 0.05,
        "dof_armature": 0.05,
        "geom_friction": 0.02,
        "geom_solref": 0.03,
    }
    for (name, size), own in zip(sizes.items(), rng.spawn(len(sizes)) if rng else (), strict=False):
        numbers = getattr(model, name)  # of contacts the first of each row: sliding friction, time constant
        numbers = numbers if numbers.ndim == 1 else numbers[:, 0]
        numbers *= 1 + size * own.standard_normal(numbers.shape)  # a tool comes last, and moves no other number
    for apply in changes:
        apply(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return Plant(model, drive)
