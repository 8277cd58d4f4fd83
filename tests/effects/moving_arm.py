"""An arm of three joints under a joint PD, stepped by plain MuJoCo: what an effect has to do, written without it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from leapgap.effects.base import Effect
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout

MJCF = """<mujoco model="arm"><option timestep="0.001"/><worldbody>
  <geom name="floor" type="plane" size="3 3 0.1" pos="0 0 -2"/>
  <body name="turret"><joint name="yaw" axis="0 0 1" damping="0.3" armature="0.02"/>
    <geom type="cylinder" size="0.05 0.05" mass="1"/>
    <body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0" damping="0.2 0.03" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.2"/>
      <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" damping="0.1" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02" mass="0.6"/></body></body></body></worldbody>
  <actuator><general joint="yaw" biastype="affine" forcerange="-40 40"/>
    <general joint="shoulder" biastype="affine" forcerange="-40 40"/>
    <general joint="elbow" biastype="affine" forcerange="-40 40"/></actuator></mujoco>"""
JOINTS = ("yaw", "shoulder", "elbow")
KP, KD, PERIOD_S = 40.0, 1.5, 0.001


@dataclass(frozen=True)
class Sent:
    """Commands of one motion, (rows, joints) each."""

    push: np.ndarray
    wanted: np.ndarray
    speed: np.ndarray

    @property
    def asked(self) -> np.ndarray:
        """Torque of a PD at rest at zero, N·m."""
        return np.asarray(self.push + KP * self.wanted + KD * self.speed)


Step = Callable[[mujoco.MjModel, mujoco.MjData, int], None]
"""Called before every step of the simulation with the row."""


def load(folder: Path, mjcf: str = MJCF) -> Robot:
    """The arm as the instrument reads it."""
    (folder / "arm.xml").write_text(mjcf, encoding="utf-8")
    return Robot.load(folder / "arm.xml")


def commands(seed: int, rows: int = 600) -> Sent:
    """Two sines at each joint, and a push."""
    rng, time = np.random.default_rng(seed), np.arange(rows) * PERIOD_S
    size, pulse = rng.uniform(0.2, 0.5, (2, 3, 1)), 2 * np.pi * rng.uniform(0.5, 2.5, (2, 3, 1))
    angle = pulse * time + rng.uniform(0, 6, (2, 3, 1))
    wanted, speed = (size * np.sin(angle)).sum(axis=0).T, (size * pulse * np.cos(angle)).sum(axis=0).T
    return Sent(2 * np.sin(angle[0].T + 1), wanted, speed)


SENT = commands(3)
"""The commands of most tests."""


def simulate(
    sent: Sent,
    change: Callable[[mujoco.MjModel], None] = lambda _: None,
    before: Step = lambda *_: None,
    steps: int = 1,
    mjcf: str = MJCF,
    control: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities (rows, joints) of the changed model, several steps a row, by ``mj_step``."""
    model = mujoco.MjModel.from_xml_string(mjcf)
    model.actuator_biasprm[:3, 1], model.actuator_biasprm[:3, 2] = -KP, -KD
    model.opt.timestep = PERIOD_S / steps
    change(model)
    data = mujoco.MjData(model)
    data.qpos[:3], data.qvel[:3] = sent.wanted[0], sent.speed[0]
    qpos, qvel = np.empty((len(sent.push), 3)), np.empty((len(sent.push), 3))
    asked = sent.asked if control is None else control
    for row in range(len(sent.push)):
        qpos[row], qvel[row] = data.qpos[:3], data.qvel[:3]
        for _ in range(steps):
            data.ctrl[:] = asked[row]
            before(model, data, row)
            mujoco.mj_step(model, data)
    return qpos, qvel


def unpowered(model: mujoco.MjModel) -> None:
    """The shoulder's motor is simulated by the test instead."""
    model.actuator_biasprm[1], model.actuator_gainprm[1] = 0, 0


def heat_up(sent: Sent, loss: float, rises: list[float] | None = None) -> Step:
    """A shoulder of 40 N·m that gives a share 1 / (1 + r): ṙ = loss (τ / 40)² / (1 + r) − r / 60 s of the asked τ.

    By Euler's method; ``rises`` gets r at every step.
    """
    rise = 0.0

    def act(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        nonlocal rise
        if rises is not None:
            rises.append(rise)
        given = (sent.asked[row, 1] - KP * data.qpos[1] - KD * data.qvel[1]) / (1 + rise)
        data.qfrc_applied[1] = given
        rise += model.opt.timestep * (loss * given**2 * (1 + rise) / 40**2 - rise / 60)

    return act


def rub(sent: Sent, share: float) -> Step:
    """An elbow with friction that is a share of its motor's torque, along its own velocity."""

    def act(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        carried = np.clip(sent.asked[row, 2] - KP * data.qpos[2] - KD * data.qvel[2], -40, 40)
        data.qfrc_applied[2] = -share * abs(carried) * np.tanh(data.qvel[2] / 0.05)

    return act


def as_log(name: str, sent: Sent, qpos: np.ndarray, qvel: np.ndarray) -> Log:
    """A log of a motion and its commands."""
    columns = {"time": np.arange(len(qpos)) * PERIOD_S}
    for i, joint in enumerate(JOINTS):
        columns |= {f"joint_pos/{joint}": qpos[:, i], f"joint_vel/{joint}": qvel[:, i]}
        columns |= {f"cmd_tau/{joint}": sent.push[:, i], f"cmd_pos/{joint}": sent.wanted[:, i]}
        columns |= {f"cmd_vel/{joint}": sent.speed[:, i], f"cmd_kp/{joint}": np.full(len(qpos), KP)}
        columns[f"cmd_kd/{joint}"] = np.full(len(qpos), KD)
    columns = {key: np.ascontiguousarray(values) for key, values in columns.items()}
    return Log(name, columns, LogInfo("arm", PERIOD_S, "plain MuJoCo"))


def replay(robot: Robot, log: Log, *found: Effect) -> np.ndarray:
    """Positions (rows, joints) by the replay of a log with effects."""
    return Replayer(robot).motions([Rollout(log, found)])[0].qpos
