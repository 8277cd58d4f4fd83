"""What the MPC of the ground forces predicts at each of its updates, beside the reference that it follows.

The predictions are computed from the logged states: the same problem, model and solver as in the controller, which
logs only the first force of each horizon.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr

from leapgap.jumping.control.leg_kinematics import LegKinematics
from leapgap.jumping.control.mpc import ForcePlan, ForcePlanner
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.models.affine_model import PredictionModel, Situation
from leapgap.jumping.models.rigid_body import advance
from leapgap.jumping.planning.reference import name_of
from leapgap.jumping.task import schedule_of, target_of
from leapgap.logs.log import Log, read_log
from leapgap.logs.pair_force import per_axis
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.reports.plots import Curve, log_plot
from leapgap.reports.scene import WORLD
from leapgap.reports.shown_robot import Colour, Recorder
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate

HORIZON_COLOUR: Colour = (255, 90, 200)
REFERENCE_COLOUR: Colour = (240, 240, 240)
NEEDED = (*BASE_POSITION, *BASE_QUATERNION, *BASE_VELOCITY, *BASE_ANGULAR_VELOCITY)


@dataclass(frozen=True)
class PredictedHorizon:
    """One update of the MPC: where it expects the base to go."""

    time_s: np.ndarray
    """Times of the steps since the start of the jump, the first is the update, (n + 1,)."""
    state: np.ndarray
    """x z pitch and rates in the frame of the start, m, rad, s, (n + 1, 6)."""


@dataclass(frozen=True)
class MpcHorizons:
    """All updates of a jump, with the reference, in the frame of the jump's start."""

    frame: StartFrame
    reference: np.ndarray
    """States of the reference, (rows, 6)."""
    updates: tuple[PredictedHorizon, ...]

    def in_world(self, states: np.ndarray) -> np.ndarray:
        """Positions of the base in the world of planar states (n, 6), m, (n, 3)."""
        start = np.array([self.frame.x_m, self.frame.y_m, self.frame.level_m])
        return start + states[:, :1] * self.frame.forward + states[:, 1:2] * np.array([0.0, 0.0, 1.0])

    def log(self, to: Recorder, key: str) -> None:
        """Log the reference's path, each update's predicted path from its time on, and where each expects to land."""
        entity = f"{WORLD}/{key}/mpc"
        strip = self.in_world(self.reference).astype(np.float32)
        to.static(f"{entity}/reference", rr.LineStrips3D([strip], radii=0.003, colors=REFERENCE_COLOUR))
        to.static(f"{entity}/predicted", rr.LineStrips3D.from_fields(colors=[HORIZON_COLOUR], radii=[0.005]))
        times = np.array([one.time_s[0] for one in self.updates])
        strips = [self.in_world(one.state).astype(np.float32) for one in self.updates]
        to.over_time(f"{entity}/predicted", times, rr.LineStrips3D.columns(strips=strips))
        end = np.array([one.state[-1] for one in self.updates])
        planned = np.tile(self.reference[-1], (len(end), 1))
        for name, column in (("x", 0), ("z", 1), ("pitch", 2)):
            curves = [
                Curve("predicted by the MPC", HORIZON_COLOUR, end[:, column]),
                Curve("reference at its end", REFERENCE_COLOUR, planned[:, column]),
            ]
            log_plot(to, f"mpc/{name}", times, curves)


def mpc_horizons(
    log: Log, planned: Log, robot: Robot, model: PredictionModel, config: MpcConfig | None = None
) -> MpcHorizons | None:
    """Predictions at every update of a jump that followed a planned one; None where the log lacks the state."""
    chosen = config or MpcConfig()
    joints = [f"{kind}/{joint}" for kind in ("joint_pos", "joint_vel") for joint in robot.joints]
    if not {*NEEDED, *joints} <= set(log.columns):
        return None
    reference, legs = Reference.of(planned, robot), LegKinematics(robot)
    planner = ForcePlanner(reference, model, chosen)
    frame = StartFrame.of(estimate(log, 0, robot))
    updates = []
    for time_s in np.arange(0.0, reference.schedule.take_off_s - 1e-6, chosen.period_s):
        row = int(np.searchsorted(log.time, time_s - 1e-9))
        if row >= len(log):
            break
        seen = estimate(log, row, robot)
        state, foot = frame.state(seen), frame.foot(seen, legs)
        plan = planner.plan(float(time_s), state, foot)
        updates.append(PredictedHorizon(plan.horizon.time_s, predict(plan, state, foot, reference, model)))
    return MpcHorizons(frame, reference.state, tuple(updates))


def estimate(log: Log, row: int, robot: Robot) -> StateEstimate:
    """The logged state of a row; contacts are not used here."""
    return StateEstimate(
        float(log.time[row]),
        log.stack(BASE_POSITION)[row],
        log.stack(BASE_QUATERNION)[row],
        log.stack(BASE_VELOCITY)[row],
        log.stack(BASE_ANGULAR_VELOCITY)[row],
        log.per_joint("joint_pos", robot.joints)[row],
        log.per_joint("joint_vel", robot.joints)[row],
        np.zeros(len(robot.feet), dtype=bool),
    )


def predict(
    plan: ForcePlan, state: np.ndarray, foot: np.ndarray, reference: Reference, model: PredictionModel
) -> np.ndarray:
    """States of the horizon under the planned forces, (n + 1, 6), by the model as the MPC's problem has it.

    At the first step the model is that of the measured state, later that of the reference.
    """
    steps, found = plan.horizon, [state]
    rows = reference.rows(steps.time_s)
    for k in range(len(steps)):
        at = (state, foot) if k == 0 else (reference.state[rows[k]], reference.foot[rows[k]])
        start = state if k == 0 else reference.state[rows[0]]
        here = Situation(at[0][None], at[1][None], steps.time_s[k : k + 1], start[None])
        push = plan.force[k] * per_axis(steps.share[k])
        acceleration = model.affine(here, steps.contact[k : k + 1]).acceleration(push[None])[0]
        found.append(advance(found[-1], acceleration, steps.step_s[k], model.curvature))
    return np.array(found)


def planned_for(log: Log, references: Path) -> Log | None:
    """The reference in a folder that has the target and the schedule of a jump; None where there is none."""
    if "target" not in log.info.extra or "schedule" not in log.info.extra:
        return None
    path = references / f"{name_of(target_of(log))}.parquet"
    if not path.is_file():
        return None
    found = read_log(path)
    return found if schedule_of(found) == schedule_of(log) else None


def in_words(horizons: MpcHorizons) -> str:
    """One line for the notes."""
    return (
        f"Pink: the way of the base that the nominal MPC predicts at each of its {len(horizons.updates)} updates, "
        "computed from the logged state; white: the reference."
    )
