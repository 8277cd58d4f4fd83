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

from dataclasses import dataclass

import numpy as np

from leapgap.jumping.models.planar import PlanarRobot
from leapgap.jumping.planning.boxes import terrain
from leapgap.jumping.planning.layout import JOINT, JOINTS, PITCH, X, Z
from leapgap.jumping.planning.problem import Problem, start_feet
from leapgap.jumping.planning.solve import Solution
from leapgap.jumping.task import Target, jump_info
from leapgap.logs.log import Log
from leapgap.logs.schema import PAIR_FORCE_AXES
from leapgap.robot.topology import PAIRS

SAMPLES_PER_SECOND = 1000


@dataclass(frozen=True)
class Gains:
    """Gains of the joint PD that tracks a reference; as published 300 and 3 on every joint."""

    kp_nm_per_rad: float = 300.0
    kd_nms_per_rad: float = 3.0


def name_of(target: Target) -> str:
    """Name of a reference as published, height and distance in cm: h00_d60, h20_d60, h00_d-10, h00_d55.5."""

    def centimetres(metres: float) -> str:
        value = round(100 * metres, 6) + 0.0
        whole = f"{abs(int(value)):02d}"
        fraction = f"{abs(value) % 1:.6f}".rstrip("0").lstrip("0").rstrip(".")
        return ("-" if value < 0 else "") + whole + fraction

    return f"h{centimetres(target.z_m)}_d{centimetres(target.x_m)}"


def to_jump(solution: Solution, gains: Gains) -> Log:
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
        np.concatenate([[0.0], knots]),
        np.concatenate([stand, plan.q]),
        np.concatenate([0 * stand, slope]),
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
    robot: PlanarRobot, q: np.ndarray, v: np.ndarray, torque: np.ndarray, gains: Gains
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
