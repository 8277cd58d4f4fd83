"""Robots that are pushed from outside, by plain MuJoCo: an arm, and a quadruped that jumps.

Nothing of the project but the form of a log is used. The pushes are forces of the simulation that no command knows of.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from leapgap.logs.log import Log, LogInfo

PERIOD_S = 0.002
ARM = """
<mujoco model="arm">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 1 0" damping="{shoulder}" frictionloss="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" damping="{elbow}" frictionloss="0.05"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.6" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator>
</mujoco>
"""
JOINTS = ("shoulder", "elbow")
KP, KD = 15.0, 0.5


@dataclass(frozen=True)
class Push:
    """A torque at a joint, or a force on the trunk, from outside."""

    log: int
    at: str
    time_s: float
    """Middle of the push, s from the first row of its log."""
    duration_s: float
    peak: float
    """N·m or N."""

    def force(self, time_s: float) -> float:
        """A half sine for a joint; the impulse is 2/π of peak × duration."""
        phase = (time_s - self.time_s) / self.duration_s + 0.5
        return self.peak * float(np.sin(np.pi * phase)) if 0 <= phase <= 1 else 0.0

    @property
    def impulse(self) -> float:
        """N·m·s or N·s."""
        return 2 / np.pi * self.peak * self.duration_s


def arm_swing(log: int, pushes: list[Push], elbow: float = 0.1, motion: int | None = None) -> Log:
    """One log of 4 s of an arm that swings by a joint PD, pushed; ``elbow`` is its damping there, N·m·s/rad.

    Logs of one number ``motion`` are asked for the same motion; None: each for its own.
    """
    noise, rng = np.random.default_rng(log), np.random.default_rng(100 + (log if motion is None else motion))
    model = mujoco.MjModel.from_xml_string(ARM.format(shoulder=0.1, elbow=elbow))
    data, rows, steps = mujoco.MjData(model), round(4.0 / PERIOD_S), round(PERIOD_S / model.opt.timestep)
    time = np.arange(rows) * PERIOD_S
    size, rate, phase = rng.uniform(0.2, 0.5, (2, 2)), rng.uniform(0.3, 1.0, (2, 2)), rng.uniform(0, 6, (2, 2))
    angle = 2 * np.pi * rate[:, :, None] * time + phase[:, :, None]
    wanted = (size[:, :, None] * np.sin(angle)).sum(axis=1).T
    speed = (size[:, :, None] * 2 * np.pi * rate[:, :, None] * np.cos(angle)).sum(axis=1).T
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    qpos, qvel = np.empty((rows, 2)), np.empty((rows, 2))
    for row in range(rows):
        qpos[row], qvel[row] = data.qpos, data.qvel
        for _ in range(steps):
            torque = KP * (wanted[row] - data.qpos) + KD * (speed[row] - data.qvel)
            for push in pushes:
                if push.log == log:
                    torque[JOINTS.index(push.at)] += push.force(data.time)
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
    columns = {"time": time}
    for i, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": qpos[:, i] + 3e-4 * noise.standard_normal(rows),
            f"joint_vel/{joint}": qvel[:, i] + 1e-2 * noise.standard_normal(rows),
            f"cmd_tau/{joint}": np.zeros(rows),
            f"cmd_pos/{joint}": wanted[:, i],
            f"cmd_vel/{joint}": speed[:, i],
            f"cmd_kp/{joint}": np.full(rows, KP),
            f"cmd_kd/{joint}": np.full(rows, KD),
        }
    return Log(f"swing_{log}", columns, LogInfo("arm", PERIOD_S, "plain MuJoCo"))


def write_arm(folder: Path) -> Path:
    """The model file of the arm, as its owner believes it."""
    path = folder / "arm.xml"
    path.write_text(ARM.format(shoulder=0.1, elbow=0.1))
    return path


A1 = Path(__file__).parents[2] / "src" / "leapgap" / "robot" / "a1.xml"
JUMP_KP, JUMP_KD, JUMP_PERIOD_S, JUMP_ROWS = 100.0, 2.0, 0.001, 700
CROUCH, STRETCH = (0.0, 1.1, -2.2), (0.0, 0.75, -1.25)
"""Angles of hip, thigh and calf before the jump and at its take-off, rad."""
BASE = ("base_pos_x", "base_pos_y", "base_pos_z", "base_quat_w", "base_quat_x", "base_quat_y", "base_quat_z")
BASE_RATES = (*(f"base_linvel_{axis}" for axis in "xyz"), *(f"base_angvel_{axis}" for axis in "xyz"))


def quadruped_jump(
    log: int, pushes: list[Push], lag_s: float = 0.0, late: str | None = None, late_rows: int = 10
) -> Log:
    """A jump of the A1 from a crouch by a joint PD; pushes along x or z act on the trunk's centre of mass.

    Motors follow with the time constant ``lag_s``. Commands of the leg ``late`` are so many rows old. The log ends
    before it lands.
    """
    rng = np.random.default_rng(200 + log)
    model = mujoco.MjModel.from_xml_path(str(A1))
    data, trunk = mujoco.MjData(model), model.body("trunk").id
    joints = [model.joint(j).name for j in range(1, model.njnt)]
    crouch = np.tile(CROUCH, 4) + rng.uniform(-0.05, 0.05) * np.tile((0, 1, -2), 4)
    stretch = np.tile(STRETCH, 4) + rng.uniform(-0.1, 0.1) * np.tile((0, 1, -1), 4)
    data.qpos[7:], data.qpos[2] = crouch, 0.4
    mujoco.mj_kinematics(model, data)
    data.qpos[2] -= min(data.geom(leg).xpos[2] for leg in ("FR", "FL", "RR", "RL")) - 0.02
    begin_s, lasts_s = 0.2 + rng.uniform(0, 0.02), 0.15 + rng.uniform(0, 0.03)
    time = np.arange(JUMP_ROWS) * JUMP_PERIOD_S
    share = np.clip((time - begin_s) / lasts_s, 0, 1)[:, None]
    wanted = crouch + (stretch - crouch) * share**2 * (3 - 2 * share)
    speed = np.gradient(wanted, JUMP_PERIOD_S, axis=0)
    old = np.array([late_rows * (joint.partition("_")[0] == late) for joint in joints])
    at = np.maximum(np.arange(JUMP_ROWS)[:, None] - old, 0)
    asked, asked_speed = (np.take_along_axis(own, at, axis=0) for own in (wanted, speed))
    for _ in range(300):  # settles in the crouch
        data.qfrc_applied[6:] = JUMP_KP * (crouch - data.qpos[7:]) - JUMP_KD * data.qvel[6:]
        mujoco.mj_step(model, data)
    qpos, qvel, begin = np.empty((JUMP_ROWS, model.nq)), np.empty((JUMP_ROWS, model.nv)), data.time
    kept, given = np.exp(-JUMP_PERIOD_S / lag_s) if lag_s else 0.0, data.qfrc_applied[6:].copy()
    for row in range(JUMP_ROWS):
        qpos[row], qvel[row] = data.qpos, data.qvel
        torque = JUMP_KP * (asked[row] - data.qpos[7:]) + JUMP_KD * (asked_speed[row] - data.qvel[6:])
        given = np.clip(torque, -33.5, 33.5) + kept * (given - np.clip(torque, -33.5, 33.5))
        data.qfrc_applied[6:] = given
        data.xfrc_applied[trunk] = 0
        for push in pushes:
            if push.log == log and abs(data.time - begin - push.time_s) <= push.duration_s / 2:
                data.xfrc_applied[trunk, "xyz".index(push.at)] += push.peak
        mujoco.mj_step(model, data)
    sigma = np.concatenate([np.full(3, 1e-3), np.full(4, 7e-4), np.full(12, 6e-4)])
    qpos = qpos + sigma * rng.standard_normal(qpos.shape)
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    sigma = np.concatenate([np.full(3, 0.01), np.full(3, 0.02), np.full(12, 0.06)])
    qvel = qvel + sigma * rng.standard_normal(qvel.shape)
    columns = {"time": time}
    columns |= dict(zip(BASE, qpos[:, :7].T, strict=True)) | dict(zip(BASE_RATES, qvel[:, :6].T, strict=True))
    for i, joint in enumerate(joints):
        columns |= {
            f"joint_pos/{joint}": qpos[:, 7 + i],
            f"joint_vel/{joint}": qvel[:, 6 + i],
            f"cmd_tau/{joint}": np.zeros(JUMP_ROWS),
            f"cmd_pos/{joint}": wanted[:, i],
            f"cmd_vel/{joint}": speed[:, i],
            f"cmd_kp/{joint}": np.full(JUMP_ROWS, JUMP_KP),
            f"cmd_kd/{joint}": np.full(JUMP_ROWS, JUMP_KD),
        }
    columns = {name: np.ascontiguousarray(values) for name, values in columns.items()}
    return Log(f"jump_{log}", columns, LogInfo("a1", JUMP_PERIOD_S, "plain MuJoCo"))
