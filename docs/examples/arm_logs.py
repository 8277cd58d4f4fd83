"""Logs of a small arm, made by plain MuJoCo: nothing of leapgap is used here.

    python docs/examples/arm_logs.py FOLDER [ELBOW]

writes into FOLDER

- ``robot.xml``: the model, as its owner believes it. The elbow's damping is 0.05 N·m·s/rad there.
- ``measured/swing_0.csv`` …: what the owner's logger wrote, angles in degrees, columns with names of its own.
- ``logs/swing_0.parquet`` …: the same in the form of docs/reference/log_format.md, written by pyarrow.

The arm that swings has an elbow damping of 0.45 N·m·s/rad: the model is wrong by 0.40. ELBOW names another truth, as
MuJoCo attributes of the elbow joint, such as ``'damping="0.05" stiffness="4"'``.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

MODEL = """<mujoco model="arm">
  <option timestep="0.0005"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.05" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="1.5" contype="0" conaffinity="0"/>
      <body name="lower" pos="0 0 -0.4">
        <joint name="elbow" axis="0 1 0" {elbow} armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.8" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general joint="shoulder" gainprm="1" biastype="affine" forcerange="-60 60"/>
    <general joint="elbow" gainprm="1" biastype="affine" forcerange="-60 60"/>
  </actuator>
</mujoco>
"""
BELIEVED, TRUE = 'damping="0.05"', 'damping="0.45"'  # of the elbow, N·m·s/rad
JOINTS = ("shoulder", "elbow")
KP, KD = 60.0, 1.5  # of the joint PD, N·m/rad and N·m·s/rad
PERIOD_S, LENGTH_S = 0.001, 2.0
ANGLE_NOISE, SPEED_NOISE = 2e-4, 5e-3  # standard deviations, rad and rad/s
INFO = {"format_version": 2, "robot": "arm", "sample_period_s": PERIOD_S, "source": "plain MuJoCo"}


def swing(seed: int, elbow: str) -> dict[str, np.ndarray]:
    """Columns of one log of the true arm: a joint PD follows a sum of three sines at each joint."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(MODEL.format(elbow=elbow))
    data = mujoco.MjData(model)
    time = np.arange(round(LENGTH_S / PERIOD_S)) * PERIOD_S
    amplitude, frequency, phase = rng.uniform([[[0.2]], [[0.4]], [[0]]], [[[0.5]], [[1.6]], [[6]]], (3, 2, 3))
    pulse = 2 * np.pi * frequency[..., None]
    angle = pulse * time + phase[..., None]
    position = (amplitude[..., None] * np.sin(angle)).sum(axis=1).T  # (rows, joints)
    velocity = (amplitude[..., None] * pulse * np.cos(angle)).sum(axis=1).T
    data.qpos[:], data.qvel[:] = position[0], velocity[0]
    measured = np.empty((len(time), 2, 2))
    for row in range(len(time)):
        measured[row] = data.qpos, data.qvel
        for _ in range(round(PERIOD_S / model.opt.timestep)):
            data.qfrc_applied[:] = KP * (position[row] - data.qpos) + KD * (velocity[row] - data.qvel)
            mujoco.mj_step(model, data)
    measured += rng.standard_normal(measured.shape) * np.array([[ANGLE_NOISE], [SPEED_NOISE]])
    columns = {"time": time}
    for i, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": measured[:, 0, i],
            f"joint_vel/{joint}": measured[:, 1, i],
            f"cmd_tau/{joint}": np.zeros(len(time)),
            f"cmd_pos/{joint}": position[:, i],
            f"cmd_vel/{joint}": velocity[:, i],
            f"cmd_kp/{joint}": np.full(len(time), KP),
            f"cmd_kd/{joint}": np.full(len(time), KD),
        }
    return columns


def as_measured(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same as the owner's logger has it: degrees, and no gains, for they are constant."""
    found = {"stamp": columns["time"]}
    for joint in JOINTS:
        for theirs, ours in (("q", "joint_pos"), ("dq", "joint_vel"), ("q_set", "cmd_pos"), ("dq_set", "cmd_vel")):
            found[f"{theirs}_{joint}"] = np.degrees(columns[f"{ours}/{joint}"])
    return found


def main(folder: Path, elbow: str = TRUE, logs: int = 4) -> None:
    """Write the model and all logs in both forms."""
    for name in ("measured", "logs"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(MODEL.format(elbow=BELIEVED), encoding="utf-8")
    for i in range(logs):
        columns = swing(i, elbow)
        pa.csv.write_csv(pa.table(as_measured(columns)), folder / "measured" / f"swing_{i}.csv")
        table = pa.table(columns).replace_schema_metadata({"leapgap": json.dumps(INFO)})
        pa.parquet.write_table(table, folder / "logs" / f"swing_{i}.parquet")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:3])
