"""Logs of an arm of three joints by plain MuJoCo and a joint PD written here, with the faults that tests ask for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot

JOINTS = ("base", "shoulder", "elbow")
STEP_S = 0.0005
ARM = """
<mujoco model="arm3">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body pos="0 0 1"><joint name="base" axis="0 0 1" range="-3 3" damping="0.1" armature="0.02" frictionloss="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.1 0 0.1" size=".04" mass="1.5" contype="0" conaffinity="0"/>
      <body pos="0.1 0 0.1"><joint name="shoulder" axis="0 1 0" range="-2.6 2.6" damping="0.1" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size=".03" mass="1.2" contype="0" conaffinity="0"/>
        <body pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" range="-2.4 2.4" damping="0.05" armature="0.01"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.25" size=".025" mass="0.7" contype="0" conaffinity="0"/>
  </body></body></body></worldbody>
  <actuator><motor joint="base" ctrlrange="-{limit} {limit}"/><motor joint="shoulder" ctrlrange="-{limit} {limit}"/>
    <motor joint="elbow" ctrlrange="-{limit} {limit}"/></actuator>
</mujoco>"""
KP, KD = np.array([60.0, 60.0, 40.0]), np.array([1.5, 1.5, 1.0])


def robot(folder: Path, limit: float = 200.0) -> Robot:
    """The arm as its model file has it."""
    path = folder / "arm3.xml"
    path.write_text(ARM.format(limit=limit))
    return Robot.load(path)


@dataclass(frozen=True)
class Truth:
    """What the robot is and does, beside its model."""

    limit: float = 200.0
    gains: float = 1.0
    """Gains that act over those of the log."""
    delay_s: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    mass: float = 1.0
    """Of the last link, over the model's."""
    points_s: float = 0.005
    """Time between set points that the controller receives."""
    line: str = "held"
    """What it does between: ``held``, ``ahead`` on a line to the next, ``late`` on a line from the one before."""
    logged_s: float = 0.005
    """Time between set points of the log: the log holds them."""
    size: float = 0.5


def logs(
    truth: Truth = Truth(), number: int = 3, period_s: float = 0.005, seconds: float = 3.0, torque: bool = False
) -> list[Log]:
    """Sines asked of all joints; noise of sensors. ``torque``: the log has what the motors gave."""
    return [one_log(truth, seed, period_s, seconds, torque) for seed in range(number)]


def one_log(truth: Truth, seed: int, period_s: float, seconds: float, torque: bool) -> Log:
    rng = np.random.default_rng(100 + seed)
    model = mujoco.MjModel.from_xml_string(ARM.format(limit=500.0))
    model.opt.timestep = STEP_S
    model.dof_damping[:] += truth.damping
    model.dof_frictionloss[:] += truth.friction
    model.body_mass[-1] *= truth.mass
    model.body_inertia[-1] *= truth.mass
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data, rows = mujoco.MjData(model), round(seconds / period_s)
    sizes, rates, phases = (rng.uniform(*ends, (2, 3)) for ends in ((0.3, 1), (0.3, 1.6), (0, 6)))

    def at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle = 2 * np.pi * rates * t[:, None, None] + phases
        wanted = (truth.size * sizes * np.sin(angle)).sum(axis=1)
        return wanted, (truth.size * sizes * 2 * np.pi * rates * np.cos(angle)).sum(axis=1)

    def sent(t: np.ndarray, points_s: float, line: str) -> tuple[np.ndarray, ...]:
        point = np.floor(t / points_s + 1e-6) * points_s
        if line == "held":
            return at(point)
        part = ((t - point) / points_s)[:, None]
        first = point - (points_s if line == "late" else 0.0)
        return tuple((1 - part) * a + part * b for a, b in zip(at(first), at(first + points_s), strict=True))

    fine = np.arange(rows * round(period_s / STEP_S)) * STEP_S
    wanted, speed = sent(fine - truth.delay_s, truth.points_s, truth.line)
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    every = round(period_s / STEP_S)
    position, velocity, gave = (np.empty((rows, 3)) for _ in range(3))
    for k in range(len(fine)):
        pd = KP * (wanted[k] - data.qpos) + KD * (speed[k] - data.qvel)
        applied = np.clip(truth.gains * pd, -truth.limit, truth.limit)
        if k % every == 0:
            position[k // every], velocity[k // every], gave[k // every] = data.qpos, data.qvel, applied
        data.qfrc_applied[:] = applied
        mujoco.mj_step(model, data)
    time = np.arange(rows) * period_s
    logged, logged_speed = sent(time, max(truth.logged_s, truth.points_s if truth.line == "held" else 0.0), "held")
    columns = {"time": time}
    for k, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": position[:, k] + 1e-4 * rng.standard_normal(rows),
            f"joint_vel/{joint}": velocity[:, k] + 5e-3 * rng.standard_normal(rows),
            f"cmd_pos/{joint}": logged[:, k],
            f"cmd_vel/{joint}": logged_speed[:, k],
            f"cmd_tau/{joint}": np.zeros(rows),
            f"cmd_kp/{joint}": np.full(rows, KP[k]),
            f"cmd_kd/{joint}": np.full(rows, KD[k]),
        }
        if torque:
            columns[f"tau/{joint}"] = gave[:, k] + 0.05 * rng.standard_normal(rows)
    return Log(f"log_{seed}", columns, LogInfo("arm3", period_s, "plain MuJoCo"))


def changed(log: Log, change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Log:
    """The log with some columns replaced."""
    columns = dict(log.columns)
    return Log(log.name, columns | change(columns), log.info)
