"""Jumps of a point mass by plain MuJoCo, logged by a writer whose rows last 0 to 3 steps and claim to last one.

The mass is pushed up by forces that are known, and its legs swing sideways, which moves no foot forward. Nothing of
the project but the form of a log is used.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from leapgap.jumping.task import ContactSchedule, Target, jump_info
from leapgap.logs.log import Log
from tests.conftest import A1_BODY

STEP_S = 0.001
SCHEDULED_ROWS = [*range(0, 800, 25), *range(800, 1201, 100)]
"""Rows at which the steps of a jump begin, and the last one's end."""
FORWARD_M_S = 1.2
HIPS, CROUCH = ("FR_hip", "FL_hip", "RR_hip", "RL_hip"), {"hip": 0.0, "thigh": 1.0, "calf": -2.0}
LEGS = [f"{leg}_{part}" for leg in ("FR", "FL", "RR", "RL") for part in CROUCH]
MODEL = f"""<mujoco><option timestep="{STEP_S}" integrator="Euler"/><worldbody>
<body pos="0 0 0.3"><freejoint/><geom size="0.1" mass="{A1_BODY.mass_kg}"/></body></worldbody></mujoco>"""


@dataclass(frozen=True)
class PlainJump:
    """A log, and what is true of it."""

    log: Log
    instants: np.ndarray
    """When each row was written, s, (1201,)."""
    state: np.ndarray
    """x, z and their rates at the instants, (1201, 4)."""

    @property
    def step_s(self) -> np.ndarray:
        """True lengths of the scheduled steps, (36,)."""
        return np.diff(self.instants[SCHEDULED_ROWS])


def forces(seed: int) -> np.ndarray:
    """Upward force of both pairs together in each of the scheduled steps, N, (36,): none in flight."""
    weight = A1_BODY.mass_kg * 9.81
    pushes = weight + np.random.default_rng(seed).normal(0, 25, 32)
    return np.concatenate([pushes, np.zeros(4)])


def plain_jump(name: str, seed: int, force_seed: int = 0, uneven: bool = True) -> PlainJump:
    """A jump of 1201 rows; ``uneven`` rows show messages that are up to 2 ms old, even ones the state as it is."""
    rng = np.random.default_rng(seed)
    steps = rng.choice(4, 1200, p=(0.25, 0.4, 0.25, 0.1)) if uneven else np.ones(1200, int)
    if uneven:
        steps[rng.integers(0, 1200, 6)] = 12
    at = np.concatenate([[3], 3 + np.cumsum(steps)])
    pushed = forces(force_seed)
    held = pushed[np.clip(np.searchsorted(at[SCHEDULED_ROWS], np.arange(at[-1] + 1), side="right") - 1, 0, 35)]
    position, velocity = fall(held)
    size, rate, phase = rng.uniform(0.2, 0.4, 4), rng.uniform(4, 9, 4), rng.uniform(0, 6, 4)
    angle = rate * STEP_S * np.arange(at[-1] + 1)[:, None] + phase
    late = rng.choice(3, (len(at), 5), p=(0.6, 0.3, 0.1)) if uneven else np.zeros((len(at), 5), int)
    shown = np.maximum.accumulate(at[:, None] - late, axis=0)  # rows of the mass, then of each hip
    base = shown[:, 0]
    columns = {"time": STEP_S * np.arange(len(at)), "base_quat_w": np.ones(len(at))}
    columns |= {f"base_quat_{axis}": np.zeros(len(at)) for axis in "xyz"}
    columns |= {f"base_pos_{axis}": position[base, i] for i, axis in enumerate("xyz")}
    columns |= {f"base_linvel_{axis}": velocity[base, i] for i, axis in enumerate("xyz")}
    columns["base_angvel_y"] = np.zeros(len(at))
    for joint in LEGS:
        hip = HIPS.index(joint) if joint in HIPS else None
        columns[f"joint_pos/{joint}"] = np.full(len(at), CROUCH[joint.split("_")[1]])
        columns[f"joint_vel/{joint}"] = np.zeros(len(at))
        if hip is not None:
            one = angle[shown[:, 1 + hip], hip]
            columns[f"joint_pos/{joint}"] = size[hip] * np.sin(one)
            columns[f"joint_vel/{joint}"] = size[hip] * rate[hip] * np.cos(one)
        for command in ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd"):
            columns[f"{command}/{joint}"] = np.zeros(len(at))
    step_of_row = np.minimum(np.searchsorted(SCHEDULED_ROWS, np.arange(1201), side="right") - 1, 35)
    for axis in ("front_x", "front_z", "rear_x", "rear_z"):
        columns[f"train_force/{axis}"] = pushed[step_of_row] / 2 if axis.endswith("z") else np.zeros(len(at))
    info = jump_info("a1", STEP_S, ContactSchedule(), Target(0.5), "plain MuJoCo")
    state = np.concatenate([position[at][:, [0, 2]], velocity[at][:, [0, 2]]], axis=1)
    return PlainJump(Log(name, columns, info), (at - at[0]) * STEP_S, state)


def fall(held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of the mass before each step, (steps, 3) each, under upward forces (steps,), N."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qvel[0] = FORWARD_M_S
    position, velocity = np.empty((len(held), 3)), np.empty((len(held), 3))
    for step, force in enumerate(held):
        position[step], velocity[step] = data.qpos[:3], data.qvel[:3]
        data.xfrc_applied[1, 2] = force
        mujoco.mj_step(model, data)
    return position, velocity
