"""Recordings that compare methods at one task: the first solid, the others as ghosts, with their fallbacks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from leapgap.jumping.control.leg_kinematics import LegKinematics, StartFrame
from leapgap.jumping.control.mpc import ForcePlan, ForcePlanner, MpcConfig
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.models.affine_model import PredictionModel, Situation
from leapgap.jumping.models.rigid_body import RigidBodyModel, advance, planner_body
from leapgap.jumping.planning.reference import name_of
from leapgap.jumping.task import begin_of, schedule_of, target_of
from leapgap.logs.cutting import rows_between
from leapgap.logs.log import Log, read_log
from leapgap.logs.metadata import ROUNDING_S
from leapgap.logs.pair_force import per_axis
from leapgap.logs.schema import BASE_ANGULAR_VELOCITY, BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY
from leapgap.reports.log_recording import Further, plot, record_jump
from leapgap.reports.plots import Curve, log_plot
from leapgap.reports.scene import WORLD
from leapgap.reports.shown_robot import Colour, Recorder, ShownRobot
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import read_json
from leapgap.simulation.controller import StateEstimate

HORIZON_COLOUR: Colour = (255, 90, 200)
REFERENCE_COLOUR: Colour = (240, 240, 240)
NEEDED = (*BASE_POSITION, *BASE_QUATERNION, *BASE_VELOCITY, *BASE_ANGULAR_VELOCITY)


@dataclass(frozen=True)
class PredictedHorizon:
    """One update of the MPC: where it expects the base to go."""

    time_s: np.ndarray  # Times of the steps since the start of the jump, the first is the update, (n + 1,)
    state: np.ndarray  # x z pitch and rates in the frame of the start, m, rad, s, (n + 1, 6)


@dataclass(frozen=True)
class MpcHorizons:
    """All updates of a jump, with the reference, in the frame of the jump's start."""

    frame: StartFrame
    reference: np.ndarray  # States of the reference, (rows, 6)
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
    base = (BASE_POSITION, BASE_QUATERNION, BASE_VELOCITY, BASE_ANGULAR_VELOCITY)
    position, quaternion, velocity, turning = (log.stack(columns)[row] for columns in base)
    joint_pos, joint_vel = (log.per_joint(name, robot.joints)[row] for name in ("joint_pos", "joint_vel"))
    time_s, contact = float(log.time[row]), np.zeros(len(robot.feet), dtype=bool)
    return StateEstimate(time_s, position, quaternion, velocity, turning, joint_pos, joint_vel, contact)


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


PREDICTING = "nominal_variable"  # Method whose predictions are shown
ENDS = (("x", "m"), ("z", "m"), ("pitch", "rad"))


def comparison_logs(runs: Path, methods: Sequence[str]) -> dict[str, list[Path]]:
    """Logs of these methods' first runs by task, as stage ``land`` keeps them, in the order of the methods."""
    found: dict[str, list[Path]] = {}
    for method in methods:
        for path in sorted((runs / method).glob("*_0.parquet")):
            found.setdefault(path.stem.removesuffix("_0"), []).append(path)
    return dict(sorted(found.items()))


def record_comparison(
    path: Path, task: str, logs: Sequence[Path], robot: Robot, references: Path | None = None
) -> None:
    """Write the methods' runs of a task as one recording; the figures of each log are in a JSON file beside it.

    All runs are shown from where their first jump begins, since some methods stand before it. With a folder of
    ``references``, what the nominal MPC predicts at each update is shown beside its run.
    """
    runs: dict[str, tuple[Log, Mapping[str, Any]]] = {}
    for one in logs:
        log, kept = read_log(one), read_json(one.with_suffix(".json"))
        if begin_s := begin_of(log):
            row = int(np.searchsorted(log.time, begin_s - ROUNDING_S))
            substituted = [[time_s - begin_s, reason] for time_s, reason in kept["substituted"]]
            log, kept = rows_between(log, row, len(log), log.name), {**kept, "substituted": substituted}
        runs[one.parent.name] = log, kept
    says = []
    for method, (_, kept) in runs.items():
        landed = [f"{one['error_cm']:+.1f} cm{'' if one['success'] else ' (failed)'}" for one in kept["landings"]]
        fallbacks = ", ".join(f"{count} × {reason}" for reason, count in kept["fallbacks"].items())
        where = f"{', '.join(landed) or 'no jump'} (positive is short)"
        says.append(f"**{method}**: {where}; substitutes: {fallbacks or 'none'}")
    (first, (main, _)), *others = runs.items()
    horizons = {
        name: found
        for name, (log, _) in runs.items()
        if name == PREDICTING and references and (found := horizons_of(log, references, robot)) is not None
    }
    record_jump(
        path,
        main,
        robot,
        {name: log for name, (log, _) in others},
        title=f"landing {task}",
        label=first,
        says="  \n".join([*says, *map(in_words, horizons.values())]),
        further=[horizon_tab(name, one) for name, one in horizons.items()],
        substitutes={name: kept["substituted"] for name, (_, kept) in runs.items() if kept["substituted"]},
    )


def horizons_of(log: Log, references: Path, robot: Robot) -> MpcHorizons | None:
    """Predictions of the nominal MPC in a run; None where its reference is not in the folder."""
    planned = planned_for(log, references)
    if planned is None:
        return None
    body = planner_body(robot, planned.per_joint("cmd_pos", robot.joints)[0], None)
    return mpc_horizons(log, planned, robot, RigidBodyModel(body))


def horizon_tab(method: str, horizons: MpcHorizons) -> Further:
    """A tab with where each update expects to land, and the predicted ways in the scene."""
    views = [plot(f"mpc/{name}", f"{name} at the end of the horizon [{unit}]", True) for name, unit in ENDS]
    tab = rrb.Grid(*views, grid_columns=1, name=f"Horizon of {method}")

    def log(to: Recorder, actors: Sequence[ShownRobot]) -> None:
        (key,) = [actor.key for actor in actors if actor.label == method]
        horizons.log(to, key)

    return Further(tab, log)
