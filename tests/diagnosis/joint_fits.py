"""Fits to logs of the two-link arm that plain MuJoCo simulated with something hidden."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from tests.plain_simulation import Pd, by_motors, simulate

Change = Callable[[mujoco.MjModel], None]
MOTIONS = [Pd(20, 0.5, 0.3), Pd(30, 0.8, 0.5), Pd(12, 0.3, 0.8, 2.0), Pd(25, 0.6, 0.4, 3.0)]
STIFF = [Pd(150, 2.0, 0.3), Pd(200, 3.0, 0.5), Pd(120, 1.5, 0.8), Pd(180, 2.0, 0.4)]
NOMINAL = Candidate((), np.zeros(0), np.zeros((0, 0)), np.zeros((4, 0)))


def worn(model: mujoco.MjModel) -> None:
    """What is hidden at both joints of the arm."""
    model.dof_damping[:] += 0.25
    model.dof_frictionloss[:] = 0.3
    model.dof_armature[:] += 0.02
    mujoco.mj_setConst(model, mujoco.MjData(model))


def noisy_logs(path: Path, change: Change, motions=MOTIONS, rows=900, noise=2e-4, **more: Any) -> list[Log]:
    """A log of each motion, with sensor noise of ``noise`` rad and 25 times as many rad/s."""
    rng, found = np.random.default_rng(3), []
    for number, pd in enumerate(motions):
        log = simulate(path, by_motors, pd, rows=rows, change=change, **more).log
        sizes = {"joint_pos": noise, "joint_vel": 25 * noise}
        columns = {
            name: values + sizes.get(name.split("/")[0], 0.0) * rng.standard_normal(rows)
            for name, values in log.columns.items()
        }
        found.append(replace(log, name=f"motion_{number}", columns=columns))
    return found


def heldout_gap(logs: list[Log], robot: Robot) -> HeldOutGap:
    """The gap of the nominal robot over four folds, each a log."""
    judged = JudgedLogs.of(logs, robot)
    return HeldOutGap.of(judged, Replayer(robot, 1, 2), 4, 1, 100, np.random.default_rng(0))


def short_rollouts(gap: HeldOutGap, robot: Robot) -> ShortRollouts:
    """Pieces of 0.1 s of the logs of a gap, with the noise that the nominal robot leaves."""
    short = ShortRollouts.of(gap.judged.states, Replayer(robot, 1, 2), 0.1, 0.01, 16)
    return short.whiten_for(short.on_every_log(()))


def joint_fit(robot: Robot, change: Change) -> JointFit:
    """The joint fit to stiff motions of the arm with a hidden ``change``."""
    gap = heldout_gap(noisy_logs(robot.path, change, STIFF), robot)
    return JointFit(gap, short_rollouts(gap, robot), ())
