"""What the robot's joints lack in the nominal model, from its own jumps: so that plans can reckon with it.

The logs' commands are replayed in the nominal robot with effects, and the effects' sizes fitted to the measured motion:
the corrected robot of a diagnosis, with its hypotheses named beforehand.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of
from leapgap.simulation.replay import Replayer, Rollout


@dataclass(frozen=True)
class Unknown:
    """One parameter of an effect to find, and a change of it that matters."""

    effect: str
    parameter: str
    scale: float


JOINTS = (
    Unknown("joint_damping", "damping", 0.5),
    Unknown("joint_friction", "torque_nm", 0.5),
    Unknown("armature", "inertia", 0.02),
    Unknown("command_delay", "delay_s", 0.003),
)
BASE_SCALE, JOINT_SCALE = (0.05, 0.05, 0.1), 0.1
"""m, m, rad; rad: errors that count alike."""
EVERY_S = 0.02
"""Motions are compared so often."""


def identified_config(logs: Sequence[Log], robot: Robot, known: tuple[Effect, ...]) -> dict[str, Any]:
    """``identified`` as configuration, which a JSON file can hold."""
    return {"effects": effects.to_config(identified(logs, robot, known))}


def identified(
    logs: Sequence[Log], robot: Robot, known: tuple[Effect, ...] = (), unknown: Sequence[Unknown] = JOINTS
) -> tuple[Effect, ...]:
    """The effects, at the sizes with which replays of the logs come nearest to what was measured.

    ``known`` act too and are not fitted: what the motors' data sheet says.
    """
    replayer = Replayer(robot, max((len(log.info.terrain) for log in logs), default=0) or 1)
    kinds = effects.known()
    ranges = [next(p for p in kinds[u.effect].parameters(robot) if p.name == u.parameter) for u in unknown]
    scale = np.array([u.scale for u in unknown])
    rows = [min(log.rows_before_gain_change, round(1.1 / log.info.sample_period_s)) for log in logs]

    def acting(sizes: np.ndarray) -> tuple[Effect, ...]:
        values = zip(unknown, sizes * scale, strict=True)
        entries: list[Mapping[str, Any]] = [{"name": u.effect, u.parameter: float(value)} for u, value in values]
        return effects.from_config(entries)

    def missed(sizes: np.ndarray) -> np.ndarray:
        found = (*known, *acting(sizes))
        motions = [replayer.motions([Rollout(log, found)], count)[0] for log, count in zip(logs, rows, strict=True)]
        return np.concatenate([difference(m.qpos, log, robot) for m, log in zip(motions, logs, strict=True)])

    # What the joints lack is looked for, not what the model has too much of.
    bounds = np.array([[max(p.lower, p.nominal) for p in ranges], [p.upper for p in ranges]]) / scale
    start = np.clip(np.full(len(unknown), 0.3), *bounds)
    fit = least_squares(missed, start, bounds=bounds, loss="soft_l1", diff_step=0.05, max_nfev=15)
    return acting(np.clip(fit.x, *bounds))


def difference(qpos: np.ndarray, log: Log, robot: Robot) -> np.ndarray:
    """Simulated less measured x, z, pitch and joints at some rows, in what counts alike."""
    at = slice(0, len(qpos), log.info.rows(EVERY_S))
    pitch = pitch_of(qpos[at, 3:7]) - log.pitch[: len(qpos)][at]
    base = qpos[at, 0] - log["base_pos_x"][: len(qpos)][at], qpos[at, 2] - log["base_pos_z"][: len(qpos)][at]
    joints = (qpos[at][:, robot.joint_qpos] - log.per_joint("joint_pos", robot.joints)[: len(qpos)][at]) / JOINT_SCALE
    x_scale, z_scale, pitch_scale = BASE_SCALE
    return np.concatenate([base[0] / x_scale, base[1] / z_scale, pitch / pitch_scale, joints.ravel()])
