"""A robot with its drives in plain MuJoCo: a joint PD written by hand, stepped by itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np


@dataclass(frozen=True)
class Run:
    """A motion: one row a control period."""

    qpos: np.ndarray
    qvel: np.ndarray
    torque: np.ndarray  # of the drives, (rows, joints), N·m
    shown: np.ndarray  # joint positions as the encoders show them, (rows, joints), rad
    speed: np.ndarray  # joint velocities, (rows, joints), rad/s


@dataclass(frozen=True)
class OwnersDrive:
    """What a robot's drives do, by joint or alike. Errors change its fields from what the log and the model say."""

    kp: np.ndarray
    kd: np.ndarray
    limit: np.ndarray  # largest torque, N·m
    position_gain: np.ndarray | float = 1.0  # acting over logged gain
    velocity_gain: np.ndarray | float = 1.0
    zero: np.ndarray | float = 0.0  # measured − true position, rad
    offset: np.ndarray | float = 0.0  # torque that is added, N·m
    droop: np.ndarray | float = 0.0  # share of the largest torque that is lost per rad/s
    gravity: float = 0.0  # share of the weight that the drives carry by themselves
    delay_s: float = 0.0
    filter_s: float = 0.0  # time constant of the filter of set points
    slew_rad_s: float = np.inf  # fastest change of set points
    sag: float = 0.0  # share of all torques that is lost where every motor gives its largest


@dataclass(frozen=True)
class OwnersPlant:
    """A robot: its compiled model and its drives."""

    model: mujoco.MjModel
    drive: OwnersDrive

    @property
    def joints(self) -> np.ndarray:
        """Numbers of the joints that have a motor, in the order of the model."""
        return np.sort(self.model.actuator_trnid[:, 0])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of these joints."""
        return tuple(self.model.joint(joint).name for joint in self.joints)

    @property
    def dofs(self) -> np.ndarray:
        """Their degrees of freedom."""
        return self.model.jnt_dofadr[self.joints]

    def run(self, position: np.ndarray, velocity: np.ndarray, period_s: float, step_s: float, rest_rows: int) -> Run:
        """Motion under set points (rows, joints); the first ``rest_rows`` rows are not logged."""
        model, data = self.model, mujoco.MjData(self.model)
        still = mujoco.MjData(model)
        at, dofs, drive = model.jnt_qposadr[self.joints], self.dofs, self.drive
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
        all_qpos, all_qvel = np.array(qpos), np.array(qvel)
        return Run(all_qpos, all_qvel, np.array(torques), all_qpos[:, at] + drive.zero, all_qvel[:, dofs])


def build(
    file: Path,
    drive: OwnersDrive,
    rng: np.random.Generator | None = None,
    specs: Sequence[Callable[[mujoco.MjSpec], None]] = (),
    changes: Sequence[Callable[[mujoco.MjModel], None]] = (),
) -> OwnersPlant:
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
    return OwnersPlant(model, drive)
