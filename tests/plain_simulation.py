"""Logs of any robot by plain MuJoCo: its makers' model file, ``mj_step``, and a joint PD written here by hand.

Nothing of the project but the form of a log is used, so that a fault of the replay cannot hide in both.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.logs.log import Log, LogInfo

STEP_S = 0.001
BASE = ("base_pos_x", "base_pos_y", "base_pos_z", "base_quat_w", "base_quat_x", "base_quat_y", "base_quat_z")
BASE_RATES = (*(f"base_linvel_{a}" for a in "xyz"), *(f"base_angvel_{a}" for a in "xyz"))


def published(package: str, path: str) -> Path:
    """A model file as its makers publish it, in an installed package, which is found without importing it."""
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        pytest.skip(f"{package} is not installed; make test installs it")
    return Path(found.submodule_search_locations[0]) / path


@dataclass(frozen=True)
class Pd:
    """Gains of a joint PD, the same at all joints, and the size of the motion that is asked for."""

    kp: float = 20.0
    kd: float = 0.5
    swing: float = 0.2
    push: float = 1.0
    """Size of the feed-forward torque, N·m."""


@dataclass(frozen=True)
class Plain:
    """A simulation of the makers' own model."""

    model: mujoco.MjModel
    joints: list[str]
    """Hinge and slide joints that are commanded, in the order of the model."""
    log: Log
    qpos: np.ndarray
    """(rows, nq), as simulated."""
    torque: np.ndarray
    """(rows, joints), N·m, as the PD asks for it before any limit."""


Send = Callable[[mujoco.MjModel, mujoco.MjData, np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]
"""Puts the PD into a simulation: dofs, torque of the PD at this state, kp, and kd q̇* + kp q* + feed-forward."""


def by_force(model: mujoco.MjModel, data: mujoco.MjData, dofs: np.ndarray, torque: np.ndarray, *_: np.ndarray) -> None:
    """The torque of the PD as a force applied to the joints; the model's motors are left alone."""
    data.qfrc_applied[dofs] = torque


def by_motors(model: mujoco.MjModel, data: mujoco.MjData, dofs: np.ndarray, torque: np.ndarray, *_: np.ndarray) -> None:
    """The torque of the PD through the makers' own torque motors, which clip it."""
    for actuator in range(model.nu):
        at = np.flatnonzero(dofs == model.jnt_dofadr[model.actuator_trnid[actuator, 0]])[0]
        data.ctrl[actuator] = torque[at] / (model.actuator_gear[actuator, 0] * model.actuator_gainprm[actuator, 0])


def simulate(
    path: Path,
    send: Send,
    pd: Pd = Pd(),
    rows: int = 501,
    lift_m: float = 0.0,
    commanded: Callable[[str], bool] = lambda _: True,
    change: Callable[[mujoco.MjModel], None] = lambda _: None,
    servo: bool = False,
    model: mujoco.MjModel | None = None,
    steps: int = 1,
    row_s: float = STEP_S,
) -> Plain:
    """Simulate the model file from its keyframe or pose, with sines asked of every joint that is commanded.

    ``servo``: the makers' own position servos get the set points, and their gains are the log's. ``model`` stands in
    place of the file. Of so many ``steps`` of the simulation and its PD one row of ``row_s`` is logged.
    """
    model = model or mujoco.MjModel.from_xml_path(str(path))
    change(model)
    model.opt.timestep = row_s / steps
    data, rng = mujoco.MjData(model), np.random.default_rng(7)
    data.qpos[:] = model.key_qpos[0] if model.nkey else model.qpos0
    floats = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    if floats:
        data.qpos[2] += lift_m
        data.qvel[:6] = 0.3 * rng.standard_normal(6)
    every = [model.joint(j).name for j in range(model.njnt) if model.jnt_type[j] in (2, 3)]
    joints = [name for name in every if commanded(name)]
    at = np.array([model.joint(name).qposadr[0] for name in joints])
    dofs = np.array([model.joint(name).dofadr[0] for name in joints])
    kp, kd = np.full(len(joints), pd.kp), np.full(len(joints), pd.kd)
    if servo:
        assert [model.joint(j).name for j in model.actuator_trnid[:, 0]] == joints
        kp, kd = -model.actuator_biasprm[:, 1], -model.actuator_biasprm[:, 2]
    time = np.arange(rows) * row_s
    size, rate, phase = (rng.uniform(low, high, len(joints)) for low, high in ((0.5, 1), (1, 4), (0, 6)))
    angle = 2 * np.pi * rate * time[:, None] + phase
    wanted = data.qpos[at] + pd.swing * size * (np.sin(angle) - np.sin(phase))
    wanted = np.clip(wanted, *model.actuator_ctrlrange.T) if servo else wanted
    speed = 0 * wanted if servo else pd.swing * size * 2 * np.pi * rate * np.cos(angle)
    push = 0 * wanted if servo else pd.push * np.sin(angle + 1)
    qpos, qvel, torque = np.empty((rows, model.nq)), np.empty((rows, model.nv)), np.empty((rows, len(joints)))
    for row in range(rows):
        qpos[row], qvel[row] = data.qpos, data.qvel
        torque[row] = push[row] + kp * (wanted[row] - data.qpos[at]) + kd * (speed[row] - data.qvel[dofs])
        for _ in range(steps):
            asked = push[row] + kp * (wanted[row] - data.qpos[at]) + kd * (speed[row] - data.qvel[dofs])
            if servo:
                data.ctrl[:] = wanted[row]
            else:
                send(model, data, dofs, asked, kp, push[row] + kp * wanted[row] + kd * speed[row])
            mujoco.mj_step(model, data)
    columns = {"time": time}
    if floats:
        columns |= dict(zip(BASE, qpos[:, :7].T, strict=True)) | dict(zip(BASE_RATES, qvel[:, :6].T, strict=True))
    for name in every:
        columns[f"joint_pos/{name}"] = qpos[:, model.joint(name).qposadr[0]]
        columns[f"joint_vel/{name}"] = qvel[:, model.joint(name).dofadr[0]]
    for i, name in enumerate(joints):
        sent = {"tau": push[:, i], "pos": wanted[:, i], "vel": speed[:, i]}
        sent |= {"kp": np.full(rows, kp[i]), "kd": np.full(rows, kd[i])}
        columns |= {f"cmd_{quantity}/{name}": values for quantity, values in sent.items()}
    columns = {name: np.ascontiguousarray(values) for name, values in columns.items()}
    info = LogInfo(path.stem, row_s, "plain MuJoCo")
    return Plain(model, joints, Log(path.stem, columns, info), qpos, torque)
