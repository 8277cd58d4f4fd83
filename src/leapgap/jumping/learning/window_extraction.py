"""Cutting jump logs into windows: the state, the forces and the feet at the steps of a time grid.

A window slides by one step (paper, training): H jumps of N steps give D = H (N − K + 1) windows of K steps.

The steps begin at the rows that the schedule names, since a controller counts its own rows, and last as long as the log
claims.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.learning.windows import KINDS, TimeGrid, Windows, shapes_of
from leapgap.jumping.models.rigid_body import CURVATURE, AffineModel, PlannedSteps, advance
from leapgap.jumping.task import begin_of, schedule_of, target_of
from leapgap.logs.log import Log
from leapgap.logs.pair_force import per_axis, per_pair
from leapgap.logs.reading import read_folder
from leapgap.logs.schema import BASE_POSITION, BASE_QUATERNION
from leapgap.robot.kinematics import feet_in_world
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS

STATE_COLUMNS = ("base_pos_x", "base_pos_z", *BASE_QUATERNION, "base_linvel_x", "base_linvel_z", "base_angvel_y")


@dataclass
class ChunkSettings:
    """Section ``chunk`` of the configuration: folders, and the time grid of the windows."""

    logs: str
    contact_step_s: float
    flight_step_s: float
    steps: int
    force: str
    out: str | None = None

    @property
    def grid(self) -> TimeGrid:
        """Time grid of a window."""
        return TimeGrid(self.contact_step_s, self.flight_step_s, self.steps)


def cut_folder(settings: ChunkSettings, robot: Robot, progress: Callable[[str], None]) -> Windows:
    """Cut the jump logs of a folder into windows; ``progress`` is told what was read."""
    readings = read_folder(Path(settings.logs), robot)
    extracted = cut(readings.logs, settings.grid, robot, settings.force)
    for line in readings.lines():
        progress(line)
    return extracted


def cut(jumps: Sequence[Log], grid: TimeGrid, robot: Robot, force: str = "total") -> Windows:
    """Cut jump logs, which share one contact schedule, into windows; none gives valid windows without any.

    ``force``: which forces the windows carry, a key of ``FORCES``.
    """
    if force not in FORCES:
        raise InputError("chunk.force", force, f"one of {', '.join(FORCES)}", "correct conf/chunk")
    for jump in jumps[1:]:
        if schedule_of(jump) != schedule_of(jumps[0]):
            do = "keep jumps of different schedules in different folders"
            raise InputError(jump.name, str(schedule_of(jump)), f"{schedule_of(jumps[0])}, as in {jumps[0].name}", do)
    schedule = schedule_of(jumps[0]) if jumps else None
    pieces = [cut_jump(jump, grid, robot, FORCES[force]) for jump in jumps]
    shapes = {name: (0, *shape) for name, shape in shapes_of(grid.steps).items() if name != "jump"}
    pieces = pieces or [{name: np.zeros(shape, KINDS.get(name, float)) for name, shape in shapes.items()}]
    arrays = {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}
    numbers = np.concatenate([np.full(len(piece["start"]), i) for i, piece in enumerate(pieces)])
    return Windows(grid, schedule, robot.name, robot.sha256, tuple(jump.name for jump in jumps), jump=numbers, **arrays)


def cut_jump(jump: Log, grid: TimeGrid, robot: Robot, forces_of: Callable[[Log], np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of one jump's N − K + 1 windows, by their names in ``Windows``."""
    schedule = schedule_of(jump)
    if begin_of(jump) > 0:
        found, expected = f"a stand of {begin_of(jump):g} s before the jump", "a jump that begins with the first row"
        raise InputError(jump.name, found, expected, "cut the rows before it off")
    try:
        total, times = grid.jump_steps(schedule), grid.sample_times(schedule)
    except InputError as error:
        raise InputError(f"{jump.name}, {error.where}", error.found, error.expected, error.do) from None
    if grid.steps > total:
        says, wanted = f"windows of {grid.steps} steps", f"{total} steps or fewer: all that this jump's schedule has"
        raise InputError(jump.name, says, wanted, "shorten the window (chunk.steps), or make the steps shorter")
    return cut_at(jump, rows_at(jump, times), np.diff(times), grid, robot, forces_of)


def cut_at(
    jump: Log,
    rows: np.ndarray,
    lengths: np.ndarray,
    grid: TimeGrid,
    robot: Robot,
    forces_of: Callable[[Log], np.ndarray],
) -> dict[str, np.ndarray]:
    """The same from the rows of the samples (N + 1,) and the lengths of the steps (N,), s."""
    schedule = schedule_of(jump)
    total, contact, times = len(lengths), grid.contact_steps(schedule), grid.sample_times(schedule)
    state = states(jump)[rows]
    force = np.where(np.arange(total)[:, None] < contact, forces_of(jump)[rows[:-1]], 0.0)
    foot = feet(jump, robot, rows[:-1])
    start = np.arange(total - grid.steps + 1)
    step, sample = start[:, None] + np.arange(grid.steps), start[:, None] + np.arange(grid.steps + 1)
    window_state = state[sample]
    window_state[:, :, 0] -= state[start, 0][:, None]
    return {
        "start": start,
        "start_x": state[start, 0],
        "state": window_state,
        "force": force[step],
        "foot": foot[step],
        "time_s": times[sample],
        "step_s": lengths[step],
        "contact": step < contact,
    }


def rows_at(jump: Log, times_s: np.ndarray) -> np.ndarray:
    """The row of a log nearest to each time, none further than half a sample period; shape of ``times_s``."""
    clock, half = jump.time, jump.info.sample_period_s / 2 + 1e-6
    if times_s[-1] > clock[-1] + half:
        found, do = f"a log that ends at {clock[-1]:g} s", "log the whole jump, or correct the schedule in its metadata"
        raise InputError(jump.name, found, f"one that reaches {times_s[-1]:g} s, the end of its scheduled flight", do)
    right = np.clip(np.searchsorted(clock, times_s), 1, len(clock) - 1)
    rows = np.where(times_s - clock[right - 1] < clock[right] - times_s, right - 1, right)
    far = np.flatnonzero(np.abs(clock[rows] - times_s) > half)
    if len(far):
        says = f"no row within {half * 1e3:.3g} ms of {times_s[far[0]]:g} s"
        expected = f"a row every {jump.info.sample_period_s * 1e3:g} ms, the sample period of its metadata"
        raise InputError(f"{jump.name}, column time", says, expected, "repair the log, or correct its sample_period_s")
    return rows


def states(jump: Log) -> np.ndarray:
    """x z pitch and their rates at every row, in the world, (rows, 6)."""
    missing = [column for column in STATE_COLUMNS if column not in jump]
    if missing:
        found, expected = f"no base state (no {', '.join(missing)})", "position, orientation and velocity of the base"
        raise InputError(jump.name, found, expected, "leave this log out: a model of the base cannot learn without")
    columns = ("base_pos_x", "base_pos_z", "base_linvel_x", "base_linvel_z", "base_angvel_y")
    x, z, vx, vz, pitch_rate = jump.stack(columns).T
    return np.stack([x, z, jump.pitch, vx, vz, pitch_rate], axis=-1)


def total_forces(jump: Log) -> np.ndarray:
    """Ground forces on the robot at every row, front x z, rear x z, N, (rows, 4): u = u_mpc + u_pd.

    A source that filtered them itself supplies ``train_force``.
    """
    sources = {name for name in ("train_force", "mpc_force", "pd_force") if jump.has_pair_force(name)}
    if "train_force" in sources:
        return jump.pair_force("train_force")
    if {"mpc_force", "pd_force"} <= sources:
        return jump.pair_force("mpc_force") + jump.pair_force("pd_force")
    found = f"only {', '.join(sources)}" if sources else "no column of them"
    expected = "train_force, or mpc_force and pd_force, of both pairs"
    raise InputError(jump.name, f"no forces ({found})", expected, "log them, or leave this log out")


def planned_forces(jump: Log) -> np.ndarray:
    """u_mpc alone, (rows, 4): what an MPC decides on; a model of it learns what joint PD will add."""
    if not jump.has_pair_force("mpc_force"):
        do = "log them, leave this log out, or set chunk.force=total"
        raise InputError(jump.name, "no planned forces (no mpc_force)", "mpc_force of both pairs", do)
    return jump.pair_force("mpc_force")


FORCES: dict[str, Callable[[Log], np.ndarray]] = {"total": total_forces, "planned": planned_forces}
"""Which force u of a log a model is trained on: all that acts, or what the MPC asks for."""


def feet(jump: Log, robot: Robot, rows: np.ndarray) -> np.ndarray:
    """Foot − base, mean of each pair, front x z, rear x z, world axes, m, at some rows, (len(rows), 4)."""
    position = jump.stack(BASE_POSITION)[rows]
    joints = jump.per_joint("joint_pos", robot.joints)[rows]
    at = feet_in_world(robot, position, jump.stack(BASE_QUATERNION)[rows], joints) - position[:, None]
    count = per_axis([len(robot.feet_of_pair(pair)) for pair in PAIRS])
    return per_pair(robot, at) / count


BALLISTIC_S = 0.2  # Before the planned landing: feet may touch, so nothing is learned and the deviation flies freely
SMOOTHED_ROWS = 3  # Before and after each sample, of which the mean is taken against the noise of the sensors


@dataclass(frozen=True)
class DeviatingJump:
    """One jump of n steps."""

    name: str
    steps: PlannedSteps
    error: np.ndarray  # Measured − planned state at the ends of the steps, the first at the start, (n + 1, 6), m, rad
    force: np.ndarray  # Mean over each step of the force that the MPC decided − that of the plan, (n, 4), N
    weight: float = 1.0  # How much it counts in a fit
    kicked: int | None = None  # Step in which something sudden moved it, of which nothing is learned; None: none
    simulated: bool = False  # Whether it is of the identified robot, and no jump of the robot itself

    @property
    def learned(self) -> np.ndarray:
        """Whether each step is one to learn from, (n,): feet may touch down in the last of them."""
        ends = self.steps.time_s < self.steps.end_s[-1] - BALLISTIC_S - 1e-6
        return ends & (np.arange(len(self.steps)) != self.kicked)

    @property
    def step_s(self) -> np.ndarray:
        """Length of each step, (n,)."""
        return self.steps.end_s - self.steps.time_s

    @property
    def acceleration(self) -> np.ndarray:
        """Gain of the deviation's velocities per second of each step, (n, 3)."""
        return np.diff(self.error[:, 3:], axis=0) / self.step_s[:, None]


def planned_steps(plan: Log, grid: TimeGrid, robot: Robot) -> PlannedSteps:
    """The steps of a whole plan."""
    schedule = schedule_of(plan)
    times = grid.sample_times(schedule)
    begin, stance_rad = times[:-1], float(plan.pitch[0])
    foot = feet(plan, robot, rows_at(plan, begin))
    return PlannedSteps(begin, times[1:], foot, schedule.in_contact(begin), target_of(plan), stance_rad)


def deviating_jump(
    jump: Log,
    plan: Log,
    grid: TimeGrid,
    robot: Robot,
    weight: float = 1.0,
    kicked_s: float | None = None,
    simulated: bool = False,
) -> DeviatingJump:
    """A jump that begins with the first row of its log, along its plan; kicked at ``kicked_s`` since its start."""
    times = grid.sample_times(schedule_of(plan))
    kicked = None if kicked_s is None else int(np.searchsorted(times, kicked_s)) - 1
    error = deviation(jump, plan, times)
    stands = per_axis(schedule_of(plan).in_contact(plan.time))
    force = mean_over_steps(jump, planned_forces(jump), times) - mean_over_steps(
        plan, planned_forces(plan) * stands, times
    )
    return DeviatingJump(jump.name, planned_steps(plan, grid, robot), error, force, weight, kicked, simulated)


def deviation(jump: Log, plan: Log, times_s: np.ndarray) -> np.ndarray:
    """Measured − planned state at some times, x from the first row of each log, mean over ``SMOOTHED_ROWS``, (n, 6)."""
    rows = min(len(jump), len(plan))
    off = states(jump)[:rows] - states(plan)[:rows]
    off[:, 0] -= off[0, 0]
    total = np.concatenate([np.zeros((1, off.shape[1])), np.cumsum(off, axis=0)])
    at = rows_at(jump, np.minimum(times_s, jump.time[rows - 1]))
    begin, end = np.maximum(at - SMOOTHED_ROWS, 0), np.minimum(at + SMOOTHED_ROWS + 1, rows)
    return (total[end] - total[begin]) / (end - begin)[:, None]


def mean_over_steps(jump: Log, values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Means of values (rows, m) over the rows of each step between times (n + 1,), (n, m); zero beyond the log."""
    rows = rows_at(jump, np.minimum(times_s, jump.time[-1]))
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])[rows]
    return np.diff(total, axis=0) / np.maximum(np.diff(rows), 1)[:, None]


def rolled_out(jump: DeviatingJump, affine: AffineModel, first: int = 0) -> np.ndarray:
    """Deviations at the ends of the steps from step ``first`` on, by a model along the plan, (n − first + 1, 6)."""
    error = [jump.error[first]]
    for k in range(first, len(jump.steps)):
        now = affine.at(slice(k, k + 1)).seen_from(error[-1][None])
        error.append(advance(error[-1], now.acceleration(jump.force[k : k + 1])[0], jump.step_s[k], CURVATURE))
    return np.array(error)
