"""Logs of a quadruped that carries a payload, made by plain MuJoCo: of leapgap only the model file of the A1 is used.

    python docs/examples/quadruped_logs.py FOLDER [KG]

writes into FOLDER

- ``robot.xml``: the model, as its owner believes it: without the payload;
- ``logs/squat_0.parquet`` …: six squats, with what a real quadruped logs: joints, attitude and gyro of the IMU, set
  points and gains. Position and velocity of the base are not logged.

KG is the mass of the payload at the trunk's centre of mass, 2 by default.
"""

import json
import sys
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet

JOINTS = tuple(f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf"))
KP, KD = 60.0, 2.0  # of the joint PD, N·m/rad and N·m·s/rad
LOGS, PERIOD_S, SETTLE_S, LENGTH_S, BEGIN_S = 6, 0.002, 1.0, 2.0, 0.3
STRETCH, COMMON, OWN = 0.15, 0.10, 0.04
"""Mean share of the crouch's angles by which the legs stretch, and its amplitudes: of all legs, and of each."""
ANGLE_NOISE, SPEED_NOISE, ATTITUDE_NOISE, GYRO_NOISE = 2e-4, 1e-2, 5e-4, 5e-3
"""Standard deviations, rad and rad/s."""


def model_file() -> Path:
    """The A1 of the installed package."""
    spec = find_spec("leapgap")
    assert spec and spec.origin
    return Path(spec.origin).parent / "robot" / "a1.xml"


def squat(seed: int, payload_kg: float) -> dict[str, np.ndarray]:
    """Columns of one log: the legs stretch and bend about the crouch, each a little differently."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_path(str(model_file()))
    trunk = model.body("trunk").id
    model.body_mass[trunk] += payload_kg
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    crouch = np.array([data.joint(joint).qpos[0] for joint in JOINTS])
    qpos = np.array([model.joint(joint).qposadr[0] for joint in JOINTS])
    dofs = np.array([model.joint(joint).dofadr[0] for joint in JOINTS])
    time = np.arange(round(LENGTH_S / PERIOD_S)) * PERIOD_S

    def sine() -> np.ndarray:
        return np.sin(2 * np.pi * (rng.uniform(0.8, 2.0) * time + rng.uniform()))

    common, grown = COMMON * sine(), np.clip(time / BEGIN_S, 0, 1)
    legs = np.repeat([grown * (STRETCH + common + OWN * sine()) for _ in range(4)], 3, axis=0).T
    wanted = crouch * (1 - legs)
    speed = np.gradient(wanted, PERIOD_S, axis=0)
    steps = round(PERIOD_S / model.opt.timestep)

    def step(position: np.ndarray, velocity: np.ndarray) -> None:
        for _ in range(steps):
            torque = KP * (position - data.qpos[qpos]) + KD * (velocity - data.qvel[dofs])
            data.qfrc_applied[dofs] = torque.clip(-33.5, 33.5)
            mujoco.mj_step(model, data)

    for _ in range(round(SETTLE_S / PERIOD_S)):
        step(wanted[0], 0 * wanted[0])
    rows = len(time)
    measured, attitude, gyro = np.empty((rows, 2, 12)), np.empty((rows, 4)), np.empty((rows, 3))
    for row in range(rows):
        measured[row] = data.qpos[qpos], data.qvel[dofs]
        attitude[row], gyro[row] = data.qpos[3:7], data.qvel[3:6]
        step(wanted[row], speed[row])
    measured += rng.standard_normal(measured.shape) * np.array([[ANGLE_NOISE], [SPEED_NOISE]])
    attitude += ATTITUDE_NOISE / 2 * rng.standard_normal(attitude.shape)
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    gyro += GYRO_NOISE * rng.standard_normal(gyro.shape)
    columns = {"time": time}
    columns |= {f"base_quat_{axis}": attitude[:, i] for i, axis in enumerate("wxyz")}
    columns |= {f"base_angvel_{axis}": gyro[:, i] for i, axis in enumerate("xyz")}
    for i, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": measured[:, 0, i],
            f"joint_vel/{joint}": measured[:, 1, i],
            f"cmd_tau/{joint}": np.zeros(rows),
            f"cmd_pos/{joint}": wanted[:, i],
            f"cmd_vel/{joint}": speed[:, i],
            f"cmd_kp/{joint}": np.full(rows, KP),
            f"cmd_kd/{joint}": np.full(rows, KD),
        }
    return columns


def main(folder: Path, payload_kg: float = 2.0, logs: int = LOGS) -> None:
    """Write the model and all logs."""
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(model_file().read_text(encoding="utf-8"), encoding="utf-8")
    info = {"format_version": 2, "robot": "a1", "sample_period_s": PERIOD_S, "source": "plain MuJoCo"}
    for i in range(logs):
        table = pa.table(squat(i, payload_kg)).replace_schema_metadata({"leapgap": json.dumps(info)})
        pa.parquet.write_table(table, folder / "logs" / f"squat_{i}.parquet")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(float, sys.argv[2:3]))
