"""A plan as a jump log: the planner's five links become the robot's trunk and twelve joints, at 1 kHz.

The planner's knot k belongs to time (k + 1) dt, so that the feet stand as long as the contact schedule says
and the jump lands at its end; until the first knot the robot stands still. Between the knots

* positions are cubic Hermite curves through the knots whose slope at knot k is (v_k + v_{k+1}) / 2, because
  the discretisation's v_{k+1} is the mean velocity from k to k + 1; velocities are their derivatives;
* torques and forces of knot k are held from dt/2 before to dt/2 after it, because they turn v_k, the mean
  velocity before the knot, into v_{k+1}, the mean velocity behind it (those of the first knot from the start
  on). Newton's law then carries the centre of mass to within 1 mm of the reference at the take-off of a 60 cm
  jump; held from knot to knot, half a step late, to within 7 mm.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leapgap.errors import InputError
from leapgap.jumping.models.planar import PlanarRobot, planar_robot
from leapgap.jumping.planning.dynamics import JOINT, JOINTS, PITCH, X, Z
from leapgap.jumping.planning.problem import Grid, Limits, Problem, Weights, start_feet, terrain
from leapgap.jumping.planning.solve import Solution, solve_all
from leapgap.jumping.task import ContactSchedule, JointGains, Target, jump_info, schedule_of
from leapgap.logs.log import Log, read_log, write_log
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.model import Robot
from leapgap.robot.topology import PAIRS
from leapgap.runtime.atomic_io import write_json, write_metrics
from leapgap.runtime.output_folder import whole_folder

SAMPLES_PER_SECOND = 1000
PUBLISHED_GAINS = JointGains()  # 300 and 3 on every joint


def name_of(target: Target) -> str:
    """Name of a reference as published, height and distance in cm: h00_d60, h20_d60, h00_d-10, h00_d55.5."""

    def centimetres(metres: float) -> str:
        value = round(100 * metres, 6) + 0.0
        whole = f"{abs(int(value)):02d}"
        fraction = f"{abs(value) % 1:.6f}".rstrip("0").lstrip("0").rstrip(".")
        return ("-" if value < 0 else "") + whole + fraction

    return f"h{centimetres(target.z_m)}_d{centimetres(target.x_m)}"


def to_jump(solution: Solution, gains: JointGains = PUBLISHED_GAINS) -> Log:
    """The reference of a plan: motion, forces and commands at each millisecond up to the landing."""
    problem = solution.problem
    grid = problem.grid
    rows = round(grid.schedule.landing_s * SAMPLES_PER_SECOND) + 1
    time = np.arange(rows) / SAMPLES_PER_SECOND
    q, v = motion(solution, time)
    torque, force = effort(solution, time)
    columns = {"time": time} | base_columns(problem, q, v)
    columns |= joint_columns(problem.robot, q, v, torque, gains)
    columns |= {f"mpc_force/{axis}": positive_zero(-force[:, i]) for i, axis in enumerate(PAIR_FORCE_AXES)}
    stands = grid.schedule.in_contact(time).astype(float)
    columns |= {f"contact/{leg.foot}": stands[:, PAIRS.index(leg.pair)] for leg in problem.robot.joints}
    info = jump_info(
        robot=problem.robot.name,
        sample_period_s=1 / SAMPLES_PER_SECOND,
        schedule=grid.schedule,
        target=problem.target,
        source="planned",
        terrain=terrain(problem.robot, problem.target),
    )
    return Log(name_of(problem.target), columns, info)


def motion(solution: Solution, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planner's q and its derivative at the given times, each (rows, 7)."""
    from scipy.interpolate import CubicHermiteSpline  # most processes read this file and plan nothing

    knots, plan = solution.problem.grid.knot_times, solution.trajectory
    slope = np.zeros_like(plan.v)
    slope[1:-1] = (plan.v[1:-1] + plan.v[2:]) / 2
    slope[-1] = plan.v[-1] + (plan.v[-1] - plan.v[-2]) / 2
    stand = plan.q[:1]
    curve = CubicHermiteSpline(
        np.concatenate([[0.0], knots]), np.concatenate([stand, plan.q]), np.concatenate([0 * stand, slope])
    )
    return curve(time), curve(time, 1)


def effort(solution: Solution, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Planner's pair torques and forces on the ground at the given times, each (rows, 4)."""
    grid, plan = solution.problem.grid, solution.trajectory
    since_hold = (time - grid.knot_times[0]) / grid.step_s + 0.5
    knot = np.clip(np.floor(since_hold + 1e-6).astype(int), 0, grid.steps - 1)
    return plan.torque[knot], plan.force[knot]


def base_columns(problem: Problem, q: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    """Columns of the trunk in the world; at the start the spheres of the feet stand on the floor z = 0."""
    still = np.zeros(len(q))
    height = problem.robot.foot_radius - start_feet(problem.robot, problem.stance_pitch_rad)[1][1]
    return {
        "base_pos_x": positive_zero(q[:, X]),
        "base_pos_y": still,
        "base_pos_z": q[:, Z] + height,
        "base_quat_w": np.cos(q[:, PITCH] / 2),
        "base_quat_x": still,
        "base_quat_y": positive_zero(np.sin(q[:, PITCH] / 2)),
        "base_quat_z": still,
        "base_linvel_x": positive_zero(v[:, X]),
        "base_linvel_y": still,
        "base_linvel_z": positive_zero(v[:, Z]),
        "base_angvel_x": still,
        "base_angvel_y": positive_zero(v[:, PITCH]),
        "base_angvel_z": still,
    }


def joint_columns(
    robot: PlanarRobot, q: np.ndarray, v: np.ndarray, torque: np.ndarray, gains: JointGains
) -> dict[str, np.ndarray]:
    """Columns of the joints in the robot's convention: half of a pair's torque for each leg, abduction at zero."""
    still = np.zeros(len(q))
    columns: dict[str, np.ndarray] = {}
    for leg in robot.joints:
        moves = dict.fromkeys(leg.abduction, (still, still, still))
        for group, joint, sign, offset in zip(("thigh", "calf"), leg.pitch, leg.sign, leg.offset, strict=True):
            j = JOINTS.index(f"{leg.pair}_{group}")
            moves[joint] = (sign * q[:, JOINT][:, j] + offset, sign * v[:, JOINT][:, j], sign * torque[:, j] / 2)
        for joint, (position, velocity, feed_forward) in moves.items():
            columns |= {
                f"joint_pos/{joint}": positive_zero(position),
                f"joint_vel/{joint}": positive_zero(velocity),
                f"cmd_tau/{joint}": positive_zero(feed_forward),
                f"cmd_pos/{joint}": positive_zero(position),
                f"cmd_vel/{joint}": positive_zero(velocity),
                f"cmd_kp/{joint}": still + gains.kp_nm_per_rad,
                f"cmd_kd/{joint}": still + gains.kd_nms_per_rad,
            }
    return columns


def positive_zero(values: np.ndarray) -> np.ndarray:
    """The same values with −0 replaced by 0, which is easier to read in a file."""
    return values + 0.0


PUBLISHED_SCHEDULE = ContactSchedule()
SAME_LENGTH, SAME_MASS = 0.05, 0.1  # Largest relative differences of lengths and mass between models of one robot


def select_planar_robot(planar: str | None, robot: Robot) -> PlanarRobot:
    """The planar robot to plan a jump of ``robot`` with; ``InputError`` for a robot that has none.

    ``published``: that of the published references, for the robot that they are of and no other. ``own``: the planar
    form of ``robot``. None: the published one where ``robot`` is of it, else its own.
    """
    own, published = planar_robot(robot), PlanarRobot()
    if planar == "own":
        return own
    if planar not in ("published", None):
        raise InputError("planar", planar, "published, own or null", "choose one")
    if is_same_robot(own, published):
        return published
    if planar is None:
        return own
    found = f"published, whose plans are of the {published.name} with {published.total_mass:.1f} kg"
    raise InputError("planar", found, f"own: {robot.path} is another robot, {own.total_mass:.1f} kg", "choose own")


def is_same_robot(one: PlanarRobot, other: PlanarRobot) -> bool:
    """Whether joints are the same, and lengths and mass differ by no more than those of two models of one robot."""
    if set(one.joints) != set(other.joints):
        return False
    links = [[link.length for leg in robot.legs for link in (leg.thigh, leg.calf)] for robot in (one, other)]
    lengths = np.array([[one.wheelbase, *links[0]], [other.wheelbase, *links[1]]])
    same_mass = np.isclose(one.total_mass, other.total_mass, rtol=SAME_MASS)
    return bool(np.allclose(lengths[0], lengths[1], rtol=SAME_LENGTH) and same_mass)


def reference_to(
    target: Target, folder: Path, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE
) -> Log:
    """The reference to a target: its file in ``folder`` if that has this robot and schedule, else a new plan."""
    path = folder / f"{name_of(target)}.parquet"
    if path.is_file():
        found = read_log(path)
        if schedule_of(found) == schedule and found.info.robot == planar.name:
            return found
    return plan_reference(target, planar, schedule)


def plan_reference(target: Target, planar: PlanarRobot, schedule: ContactSchedule = PUBLISHED_SCHEDULE) -> Log:
    """Plan the reference to a target for a planar robot."""
    (solution,) = solve_all([Problem(target, Grid(schedule), planar)])
    return to_jump(solution)


INDEX, BESIDE = "references.json", "beside"


@dataclass(frozen=True)
class OptimizeSettings:
    """Section ``optimize`` of the configuration."""

    robot: str | None
    planar: str | None
    out: str | None
    metrics: str | None
    timing: str | None  # File of the solution times; ``beside``: beside the references
    targets: Any
    schedule: ContactSchedule = field(default_factory=ContactSchedule)
    weights: Weights = field(default_factory=Weights)
    limits: Limits = field(default_factory=Limits)
    gains: JointGains = PUBLISHED_GAINS

    def problems(self, targets: Iterable[Target], planar: PlanarRobot) -> list[Problem]:
        """The problem of each target."""
        grid = Grid(self.schedule)
        return [Problem(target, grid, planar, self.weights, self.limits) for target in targets]


def read_targets(pairs: Any, where: str) -> list[Target]:
    """Targets from a list of [x_m, z_m]; anything else is an ``InputError``."""
    if not isinstance(pairs, Sequence) or isinstance(pairs, str) or not pairs:
        raise InputError(where, repr(pairs), "a list of [x_m, z_m]", "write it like [[0.55,0.0],[0.5,0.1]]")
    targets = []
    for i, pair in enumerate(pairs):
        is_pair = isinstance(pair, Sequence) and not isinstance(pair, str) and len(pair) == 2
        if not (is_pair and all(is_number(value) for value in pair)):
            expected = "two finite numbers [x_m, z_m]"
            raise InputError(f"{where}[{i}]", repr(pair), expected, "give distance and height in metres")
        targets.append(Target(float(pair[0]), float(pair[1])))
    return targets


def is_number(value: Any) -> bool:
    """Whether a value is one finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def plan_all(problems: Sequence[Problem]) -> list[Solution]:
    """Solve all problems, and print what each solution cost."""
    solutions = []
    for found in solve_all(problems):
        solutions.append(found)
        name, seconds = name_of(found.problem.target), f"{found.seconds:.2f} s"
        print(f"{name}: cost {found.cost:.1f}, {found.iterations} iterations, {seconds}", flush=True)
    return solutions


def write_all(solutions: Sequence[Solution], settings: OptimizeSettings, out: Path, by: str) -> dict[str, float]:
    """Write references into a folder, and metrics and times where files are named; the cost of each reference.

    ``by``: the command that writes.
    """
    with whole_folder(out, by) as folder:
        write_references(solutions, folder, settings.gains)
        if settings.timing == BESIDE:
            write_json(folder / "timing.json", timing(solutions))
    if settings.timing not in (None, BESIDE):
        write_json(Path(settings.timing), timing(solutions))
    if settings.metrics is not None:
        write_metrics(Path(settings.metrics), metrics(solutions))
    print(f"{len(solutions)} references in {out}")
    return {f"cost/{name_of(one.problem.target)}": float(one.cost) for one in solutions}


def write_references(solutions: Iterable[Solution], folder: Path, gains: JointGains) -> None:
    """A jump log for each solution, and ``references.json``, their list in order; no file holds a time stamp."""
    index = []
    for solution in solutions:
        jump = to_jump(solution, gains)
        file = f"{jump.name}.parquet"
        write_log(jump, folder / file)
        result = {name: getattr(solution, name) for name in ("cost", "max_violation", "status")}
        index.append({**asdict(solution.problem.target), **result, "file": file})
    write_json(folder / INDEX, index)


def metrics(solutions: Iterable[Solution]) -> dict[str, dict[str, float] | float]:
    """Cost of each reference, by its name, and the greatest constraint violation of all."""
    solutions = list(solutions)
    return {
        "cost": {name_of(solution.problem.target): solution.cost for solution in solutions},
        "max_violation": max((solution.max_violation for solution in solutions), default=0.0),
    }


def timing(solutions: Iterable[Solution]) -> dict[str, dict[str, float]]:
    """Seconds and iterations of each reference, by its name; without the time to build the programme."""
    by_name = {name_of(solution.problem.target): solution for solution in solutions}
    return {part: {name: getattr(one, part) for name, one in by_name.items()} for part in ("seconds", "iterations")}
