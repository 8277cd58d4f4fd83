"""A LeRobot dataset of a small servo arm, made by plain MuJoCo: nothing of leapgap is used here.

    python docs/examples/servo_arm_logs.py FOLDER

writes into FOLDER

- ``robot.xml``: the model, with position servos of 18 N·m/rad;
- ``dataset/``: a LeRobot dataset (version 3) of four episodes at 50 Hz: joint angles and actions in degrees, no
  velocities and no gains, as a follower arm records them.

The servos that moved have 11 N·m/rad, and 0.15 N·m more Coulomb friction than the model.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet

MODEL = """<mujoco model="servo_arm">
  <compiler angle="radian"/>
  <option timestep="0.002"/>
  <worldbody>
    <body name="turret" pos="0 0 0.06">
      <joint name="pan" axis="0 0 1" range="-1.9 1.9" damping="0.6" frictionloss="{friction}" armature="0.028"/>
      <geom type="cylinder" size="0.03 0.03" mass="0.15" contype="0" conaffinity="0"/>
      <body name="upper" pos="0 0 0.05">
        <joint name="lift" axis="0 1 0" range="-1.8 1.8" damping="0.6" frictionloss="{friction}" armature="0.028"/>
        <geom type="capsule" fromto="0 0 0 0.11 0 0" size="0.015" mass="0.2" contype="0" conaffinity="0"/>
        <body name="fore" pos="0.11 0 0">
          <joint name="elbow" axis="0 1 0" range="-1.7 1.7" damping="0.6" frictionloss="{friction}" armature="0.028"/>
          <geom type="capsule" fromto="0 0 0 0.13 0 0" size="0.013" mass="0.25" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="pan" kp="{kp}" forcerange="-3.35 3.35"/>
    <position joint="lift" kp="{kp}" forcerange="-3.35 3.35"/>
    <position joint="elbow" kp="{kp}" forcerange="-3.35 3.35"/>
  </actuator>
</mujoco>
"""
BELIEVED, TRUE = {"kp": 18, "friction": 0.05}, {"kp": 11, "friction": 0.2}
JOINTS = ("pan", "lift", "elbow")
RATE_HZ, LENGTH_S, EPISODES = 50, 8.0, 4
TICK_DEG = 360 / 4096  # of the encoders


def episode(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Actions and measured angles of one episode, degrees, (frames, joints): smooth motion between random poses."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(MODEL.format(**TRUE))
    data, frames = mujoco.MjData(model), round(LENGTH_S * RATE_HZ)
    knots = rng.uniform(-0.8, 0.8, (9, 3))
    place = np.linspace(0, len(knots) - 1.001, frames)
    share = 0.5 - 0.5 * np.cos(np.pi * np.clip(1.6 * (place % 1), 0, 1))[:, None]
    last = place.astype(int)
    action = np.degrees(knots[last] * (1 - share) + knots[last + 1] * share)
    action = np.rint(action / TICK_DEG) * TICK_DEG
    data.qpos[:] = data.ctrl[:] = np.radians(action[0])
    mujoco.mj_step(model, data, nstep=1000)
    measured = np.empty((frames, 3))
    for frame in range(frames):
        measured[frame] = np.degrees(data.qpos)
        data.ctrl[:] = np.radians(action[frame])
        mujoco.mj_step(model, data, nstep=round(1 / RATE_HZ / model.opt.timestep))
    return action, np.rint(measured / TICK_DEG) * TICK_DEG


def main(folder: Path) -> None:
    """Write the model and the dataset."""
    chunk = folder / "dataset" / "data" / "chunk-000"
    for path in (chunk, folder / "dataset" / "meta"):
        path.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(MODEL.format(**BELIEVED), encoding="utf-8")
    feature = {"dtype": "float32", "shape": [3], "names": [f"{joint}.pos" for joint in JOINTS]}
    info = {"codebase_version": "v3.0", "robot_type": "servo_arm_follower", "fps": RATE_HZ}
    info |= {"features": {"action": feature, "observation.state": feature}}
    (folder / "dataset" / "meta" / "info.json").write_text(json.dumps(info), encoding="utf-8")
    episodes = [episode(seed) for seed in range(EPISODES)]
    frames = len(episodes[0][0])
    table = {
        "action": pa.array(np.concatenate([action for action, _ in episodes]).tolist()),
        "observation.state": pa.array(np.concatenate([measured for _, measured in episodes]).tolist()),
        "timestamp": pa.array(np.tile(np.arange(frames, dtype=np.float32) / RATE_HZ, EPISODES)),
        "episode_index": pa.array(np.repeat(np.arange(EPISODES), frames)),
    }
    pa.parquet.write_table(pa.table(table), chunk / "file-000.parquet")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
