"""Identifies effects in the robot's joints from its own jumps, so that plans can account for them.

The logs' commands are replayed in the nominal robot with effects, and the parameters of the effects are fitted to the
measured motion. Unlike a diagnosis, the effects to fit are fixed beforehand.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leapgap import effects
from leapgap.effects.base import Effect
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.rotations import pitch_of
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout


@dataclass(frozen=True)
class FitParameter:
    """One parameter of an effect to fit, and the size of a typical change of it, in the parameter's unit."""

    effect: str
    parameter: str
    scale: float
    starts: tuple[float, ...] = (0.3,)  # Values, in units of ``scale``, where a fit starts: its end may depend on it


JOINT_PARAMETERS = (
    FitParameter("joint_damping", "damping", 0.5),
    FitParameter("joint_friction", "torque_nm", 0.5),
    FitParameter("armature", "inertia", 0.02),
    FitParameter("command_delay", "delay_s", 0.003),
)
CONTACT_PARAMETERS = (*JOINT_PARAMETERS, FitParameter("foot_compliance", "time_constant_s", 0.005, starts=(4.0, 5.6)))
"""With the softness of the feet. Plans cannot account for it, but a simulation can. Hard and soft feet are separate
minima, so the fit starts from both."""
BASE_SCALE, JOINT_SCALE = (0.05, 0.05, 0.1), 0.1
"""Errors of x, z and pitch of the base (m, m, rad) and of a joint (rad) that count alike in the fit."""
COMPARISON_STEP_S = 0.02  # Simulated and measured motions are compared at this interval


def identify_effects_config(
    logs: Sequence[Log], robot: Robot, known: tuple[Effect, ...], fitted: Sequence[FitParameter] = JOINT_PARAMETERS
) -> dict[str, Any]:
    """``identify_effects`` in the form of a configuration, which a JSON file can hold."""
    return {"effects": effects.to_config(identify_effects(logs, robot, known, fitted))}


def identify_effects(
    logs: Sequence[Log], robot: Robot, known: tuple[Effect, ...] = (), fitted: Sequence[FitParameter] = JOINT_PARAMETERS
) -> tuple[Effect, ...]:
    """The effects of ``fitted``, with the parameters whose replays come nearest to the measured motion.

    The effects ``known`` act as well and are not fitted; an example is the limit in the motors' data sheet.
    """
    from scipy.optimize import least_squares  # most processes read this file and fit nothing

    replayer = Replayer(robot, max((len(log.info.terrain) for log in logs), default=0) or 1)
    kinds = effects.known()
    ranges = [next(p for p in kinds[u.effect].parameters(robot) if p.name == u.parameter) for u in fitted]
    scale = np.array([u.scale for u in fitted])
    rows = [min(log.rows_before_gain_change, round(1.1 / log.info.sample_period_s)) for log in logs]

    def effects_with(sizes: np.ndarray) -> tuple[Effect, ...]:
        values = zip(fitted, sizes * scale, strict=True)
        entries: list[Mapping[str, Any]] = [{"name": u.effect, u.parameter: float(value)} for u, value in values]
        return effects.from_config(entries)

    def residuals(sizes: np.ndarray) -> np.ndarray:
        acting = (*known, *effects_with(sizes))
        motions = [replayer.motions([Rollout(log, acting)], count)[0] for log, count in zip(logs, rows, strict=True)]
        return np.concatenate([difference(m.qpos, log, robot) for m, log in zip(motions, logs, strict=True)])

    # Only additions to the model are fitted: no parameter goes below its nominal value.
    bounds = np.array([[max(p.lower, p.nominal) for p in ranges], [p.upper for p in ranges]]) / scale
    starts = [np.clip(np.array(start), *bounds) for start in itertools.product(*(u.starts for u in fitted))]
    fits = [
        least_squares(residuals, start, bounds=bounds, loss="soft_l1", diff_step=0.05, max_nfev=15) for start in starts
    ]
    return effects_with(np.clip(min(fits, key=lambda fit: float(fit.cost)).x, *bounds))


def difference(qpos: np.ndarray, log: Log, robot: Robot) -> np.ndarray:
    """Simulated minus measured x, z, pitch and joints every ``COMPARISON_STEP_S``, divided by their scales, (n,)."""
    at = slice(0, len(qpos), log.info.rows(COMPARISON_STEP_S))
    pitch = pitch_of(qpos[at, 3:7]) - log.pitch[: len(qpos)][at]
    base = qpos[at, 0] - log["base_pos_x"][: len(qpos)][at], qpos[at, 2] - log["base_pos_z"][: len(qpos)][at]
    joints = (qpos[at][:, robot.joint_qpos] - log.per_joint("joint_pos", robot.joints)[: len(qpos)][at]) / JOINT_SCALE
    x_scale, z_scale, pitch_scale = BASE_SCALE
    return np.concatenate([base[0] / x_scale, base[1] / z_scale, pitch / pitch_scale, joints.ravel()])
