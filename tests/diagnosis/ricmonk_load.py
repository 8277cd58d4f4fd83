"""What the torques of RicMonk say of 200 g that it carries, by linear regression alone: nothing of the engine is used.

All inertial numbers of the three links, dry friction, damping and rotors of the joints and the zero of the first one
are fitted to what was commanded on the logs without a load. A mass at the hip is then fitted to each log by itself.
Run as ``python -m tests.diagnosis.ricmonk_load ricmonk.urdf UNLOADED UNLOADED LOADED`` with folders of imported logs.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np
from scipy.signal import savgol_filter

from leapgap.logs.log import Log, read_logs
from leapgap.robot.model import Robot

STEP_S, WINDOW, ENDS = 0.006, 15, 10
ADDED_KG = 0.01
PLACES_M = ((0.0, 0.0), (0.15, 0.0), (0.3, 0.0), (0.15, 0.1))
"""Of point masses on each link, in the plane of motion: they span its mass, first moments and inertia."""
HIP = -4
"""Column of a mass at the hip: the first place on the last link."""
FRICTION_RAD_S = 0.05
PRIOR = np.array([0.5] * 6 + [0.05] * 2 + [0.3] + [0.5] * 12)
"""Standard deviations: N·m and N·m·s/rad of friction and damping, kg·m² of rotors, rad of the zero, kg of masses."""


def torques_needed(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques by inverse dynamics, (rows, joints)."""
    data, found = mujoco.MjData(model), np.empty_like(q)
    for row in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[row], v[row], a[row]
        mujoco.mj_inverse(model, data)
        found[row] = data.qfrc_inverse
    return found


def regression(log: Log, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Commanded less needed torque (rows, joints), and what each number adds to that (rows, joints, numbers)."""
    time = np.arange(log.time[0], log.time[-1], STEP_S)

    def at_steps(name: str) -> np.ndarray:
        return np.stack([np.interp(time, log.time, own) for own in log.per_joint(name, robot.joints).T], axis=1)

    position, velocity = at_steps("joint_pos"), at_steps("joint_vel")
    q, v = (savgol_filter(position, WINDOW, 3, deriv=k, delta=STEP_S, axis=0)[ENDS:-ENDS] for k in (0, 1))
    a = savgol_filter(velocity, WINDOW, 3, deriv=1, delta=STEP_S, axis=0)[ENDS:-ENDS]
    model = robot.spec().compile()
    needed = torques_needed(model, q, v, a)
    columns = [own * np.eye(3)[j] for own in (np.tanh(v / FRICTION_RAD_S), v) for j in range(3)]
    columns += [a * np.eye(3)[j] for j in (1, 2)]
    columns.append((torques_needed(model, q + np.array([1e-4, 0, 0]), v, a) - needed) / 1e-4)
    for body in range(1, model.nbody):
        mass, centre, inertia = model.body_mass[body], model.body_ipos[body].copy(), model.body_inertia[body].copy()
        for along, across in PLACES_M:
            place = np.array([centre[0], along, across])
            model.body_mass[body] = mass + ADDED_KG
            model.body_ipos[body] = (mass * centre + ADDED_KG * place) / (mass + ADDED_KG)
            model.body_inertia[body] = inertia + mass * ADDED_KG / (mass + ADDED_KG) * ((place - centre) ** 2).sum()
            columns.append((torques_needed(model, q, v, a) - needed) / ADDED_KG)
            model.body_mass[body], model.body_ipos[body], model.body_inertia[body] = mass, centre, inertia
    return at_steps("cmd_tau")[ENDS:-ENDS] - needed, np.stack(columns, axis=2)


def main() -> None:
    """Print errors of the torques, and the mass at the hip of each log."""
    robot, *folders = sys.argv[1:]
    sets = [[regression(log, Robot.load(robot)) for log in read_logs(Path(folder))] for folder in folders]
    unloaded = [one for of in sets[:-1] for one in of]
    errors = np.concatenate([error for error, _ in unloaded])
    columns = np.concatenate([of for _, of in unloaded])
    rows = columns.reshape(-1, len(PRIOR))
    noise2 = 0.3**2
    told = np.linalg.solve(rows.T @ rows / noise2 + np.diag(PRIOR**-2), rows.T @ errors.ravel() / noise2)
    for name, left in (("nominal", errors), ("fitted", errors - columns @ told)):
        print(f"{name}: rms error of torques {np.sqrt((left**2).mean(axis=0)).round(2)} N·m")
    for folder, own in zip(folders, sets, strict=True):
        masses = []
        for error, of in own:
            hip = of[:, :, HIP].ravel()
            masses.append(hip @ (error - of @ told).ravel() / (hip @ hip))
        print(f"{folder}: {np.round(masses, 3)} kg at the hip")


if __name__ == "__main__":
    main()
