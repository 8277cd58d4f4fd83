"""Logs of the arm of the guide's example, by plain MuJoCo; motions of its own, so that no answer is the guide's."""

import json
import runpy
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from tests.code import ROOT

EXAMPLE = SimpleNamespace(**runpy.run_path(str(ROOT / "docs" / "examples" / "arm_logs.py")))
BELIEVED, TRUE = (float(elbow.split('"')[1]) for elbow in (EXAMPLE.BELIEVED, EXAMPLE.TRUE))
"""Damping of the elbow that the model file states, and that the robot has, N·m·s/rad."""
JOINTS, KP, KD, PERIOD_S = EXAMPLE.JOINTS, EXAMPLE.KP, EXAMPLE.KD, EXAMPLE.PERIOD_S


def write_model(folder: Path) -> Path:
    """The model file, as its owner believes it."""
    path = folder / "arm.xml"
    path.write_text(EXAMPLE.MODEL.format(elbow=EXAMPLE.BELIEVED))
    return path


def arm(elbow: str = EXAMPLE.BELIEVED, mass: float = 0.8) -> str:
    """The model with other attributes of the elbow, and another mass of the lower link, kg."""
    return str(EXAMPLE.MODEL.format(elbow=elbow).replace('mass="0.8"', f'mass="{mass}"'))


def swing(seed: int, seconds: float = 2.0, xml: str = arm(EXAMPLE.TRUE)) -> dict[str, np.ndarray]:
    """Columns of one log of the true arm: a sum of sines is asked of each joint, the PD torque enters as a force."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(xml)
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


def write_parquet(folder: Path, logs: int = 4, xml: str = arm(EXAMPLE.TRUE), first: int = 0) -> Path:
    """The logs in the documented form (docs/reference/log_format.md), from seed ``first`` on, by pyarrow alone."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(first, first + logs):
        table = pa.table(swing(i, xml=xml)).replace_schema_metadata({"leapgap": json.dumps(EXAMPLE.INFO)})
        pq.write_table(table, folder / f"swing_{i}.parquet")
    return folder
