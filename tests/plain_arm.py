"""Logs of a small arm by plain MuJoCo and a PD written by hand: nothing of the library makes them."""

from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

ARM = """<mujoco model="arm">
  <option timestep="0.0005"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1.5" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" damping="{damping}" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general joint="shoulder" gainprm="1" biastype="affine" forcerange="-60 60"/>
    <general joint="elbow" gainprm="1" biastype="affine" forcerange="-60 60"/>
  </actuator>
</mujoco>"""
JOINTS = ("shoulder", "elbow")
KP, KD, PERIOD_S, BELIEVED, TRUE = 60.0, 1.5, 0.001, 0.05, 0.45
"""Gains in N·m/rad and N·m·s/rad; damping of the elbow that the model file states, and that the robot has."""


def write_model(folder: Path, damping: float = BELIEVED) -> Path:
    """The model file, as its owner believes it."""
    path = folder / "arm.xml"
    path.write_text(ARM.format(damping=damping))
    return path


def swing(seed: int, seconds: float = 2.0) -> dict[str, np.ndarray]:
    """Columns of one log of the true arm: a sum of sines is asked of each joint, the PD torque enters as a force."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(ARM.format(damping=TRUE))
    data, rows = mujoco.MjData(model), round(seconds / PERIOD_S)
    time = np.arange(rows) * PERIOD_S
    size, rate, phase = rng.uniform(0.2, 0.5, (2, 3)), rng.uniform(0.4, 1.6, (2, 3)), rng.uniform(0, 6, (2, 3))
    angle = 2 * np.pi * rate[:, :, None] * time + phase[:, :, None]
    wanted = (size[:, :, None] * np.sin(angle)).sum(axis=1).T
    speed = (size[:, :, None] * 2 * np.pi * rate[:, :, None] * np.cos(angle)).sum(axis=1).T
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    position, velocity = np.empty((rows, 2)), np.empty((rows, 2))
    for row in range(rows):
        position[row], velocity[row] = data.qpos, data.qvel
        for _ in range(round(PERIOD_S / model.opt.timestep)):
            data.qfrc_applied[:] = KP * (wanted[row] - data.qpos) + KD * (speed[row] - data.qvel)
            mujoco.mj_step(model, data)
    columns = {"time": time}
    for i, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": position[:, i] + 2e-4 * rng.standard_normal(rows),
            f"joint_vel/{joint}": velocity[:, i] + 5e-3 * rng.standard_normal(rows),
            f"cmd_tau/{joint}": np.zeros(rows),
            f"cmd_pos/{joint}": wanted[:, i],
            f"cmd_vel/{joint}": speed[:, i],
            f"cmd_kp/{joint}": np.full(rows, KP),
            f"cmd_kd/{joint}": np.full(rows, KD),
        }
    return columns


def write_csv(folder: Path, logs: int = 4) -> Path:
    """The logs as a stranger has them: tables with names of their own."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(logs):
        columns = {name.replace("/", "_"): pa.array(values) for name, values in swing(i).items()}
        pa.csv.write_csv(pa.table(columns), folder / f"swing_{i}.csv")
    return folder


def write_parquet(folder: Path, logs: int = 4) -> Path:
    """The logs in the documented form (docs/formats.md), written by pyarrow alone."""
    folder.mkdir(parents=True, exist_ok=True)
    about = (
        '{"format_version": 1, "robot": "arm", "sample_period_s": 0.001, "source": "plain MuJoCo", "terrain": [],'
        ' "schedule": {"double_contact_s": 0.5, "rear_contact_s": 0.3, "flight_s": 1.2},'
        ' "target": {"x_m": 0, "z_m": 0}}'
    )
    for i in range(logs):
        table = pa.table({name: pa.array(values) for name, values in swing(i).items()})
        table = table.replace_schema_metadata({b"leapgap": about.encode()})
        pq.write_table(table, folder / f"swing_{i}.parquet")
    return folder
