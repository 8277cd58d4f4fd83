"""References and estimates made for tests, where the truth is known."""

import numpy as np

from leapgap.jumping.control.goal_shift_mpc import CalmMotion
from leapgap.jumping.control.qp import Qp, QpSolution
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.models.rigid_body import (
    PITCH,
    PITCH_RATE,
    VX,
    VZ,
    AffineModel,
    PredictionModel,
    RigidBody,
    Situation,
    X,
    Z,
    advance,
)
from leapgap.jumping.task import ContactSchedule
from leapgap.simulation.controller import StateEstimate
from tests.jumping.rigid_motion import step

CROUCH = np.tile([0.0, 1.2566371, -2.3561945], 4)
FEET = np.array([0.18, -0.17, -0.18, -0.17])


def rigid_reference(body: RigidBody, step_s: float = 0.025, schedule: ContactSchedule | None = None) -> Reference:
    """A jump that the rigid body makes exactly under planned forces held for each step: its own roll-out, 1 kHz rows.

    Between the steps the state is interpolated; the feet's offsets are those of standing feet.
    """
    schedule = schedule or ContactSchedule()
    times = np.arange(round(schedule.take_off_s / step_s)) * step_s
    stands = np.repeat(schedule.in_contact(times), 2, axis=1)
    force = np.where(stands[:, [0]], [[5.0, 60.0, 5.0, 90.0]], [[0.0, 0.0, 40.0, 130.0]]) * stands
    state, foot = [np.array([0, 0.2, 0, 0, 0, 0.0])], []
    for u in force:
        moved = state[-1]
        foot.append(FEET - np.tile([moved[X], moved[Z] - 0.2], 2))
        state.append(step(body, moved, foot[-1], u, step_s))
    flight = [state[-1]]
    for _ in range(round(schedule.flight_s / 0.1)):
        flight.append(advance(flight[-1], np.array([0, -9.81, 0.0]), 0.1))
    knots = np.concatenate([times, schedule.take_off_s + 0.1 * np.arange(len(flight))])
    rows = np.arange(round(schedule.landing_s * 1000) + 1) / 1000
    states = np.array(state[:-1] + flight)
    held = np.minimum(np.searchsorted(times, rows + 1e-9, side="right") - 1, len(force) - 1)
    pushing = (rows < schedule.take_off_s - 1e-9)[:, None]
    joints = np.tile(CROUCH, (len(rows), 1))
    return Reference(
        name="made",
        schedule=schedule,
        period_s=0.001,
        state=np.stack([np.interp(rows, knots, column) for column in states.T], axis=1),
        force=force[held] * pushing,
        foot=np.array(foot)[held],
        joint_pos=joints,
        joint_vel=0 * joints,
        torque=0 * joints,
    )


def estimate(
    time_s: float, state: np.ndarray, joint_pos: np.ndarray = CROUCH, yaw: float = 0.0, touching: bool = True
) -> StateEstimate:
    """What sensors without error tell of a planar state (6,), the robot heading along ``yaw``."""
    half, c, s = state[PITCH] / 2, np.cos(yaw), np.sin(yaw)
    about_z, about_y = np.array([np.cos(yaw / 2), np.sin(yaw / 2)]), np.array([np.cos(half), np.sin(half)])
    quaternion = np.array(
        [about_z[0] * about_y[0], -about_z[1] * about_y[1], about_z[0] * about_y[1], about_z[1] * about_y[0]]
    )
    return StateEstimate(
        time_s=time_s,
        base_position=np.array([c * state[X], s * state[X], state[Z]]),
        base_quaternion=quaternion,
        base_velocity=np.array([c * state[VX], s * state[VX], state[VZ]]),
        base_angular_velocity=np.array([0.0, state[PITCH_RATE], 0.0]),
        joint_pos=joint_pos,
        joint_vel=0 * joint_pos,
        foot_contact=np.full(4, touching),
    )


class Counting(PredictionModel):
    """Another model that counts how often it is asked and about how many moments."""

    def __init__(self, inner: PredictionModel) -> None:
        self.inner = inner
        self.asked: list[int] = []

    def affine(self, situation: Situation, contact: np.ndarray) -> AffineModel:
        self.asked.append(len(contact))
        return self.inner.affine(situation, contact)


def unchanging(updates: int, share: float) -> CalmMotion:
    """Deviations stay what they are, to a share of what is typical of each."""
    stays = np.vstack([np.zeros(10), np.eye(10)])
    spread = share * np.array([0.01, 0.01, 0.04, 0.1, 0.1, 0.4, *[0.01] * 4])
    return CalmMotion(np.tile(stays, (updates, 1, 1)), np.tile(np.diag(spread**-2.0), (updates, 1, 1)))


def cost(qp: Qp, x: np.ndarray) -> float:
    """½ xᵀ H x + fᵀ x."""
    return float(x @ (0.5 * (qp.hessian @ x) + qp.gradient))


def duality_gap(solution: QpSolution) -> float:
    """|primal − dual cost|: xᵀ H x + fᵀ x + upperᵀ (dual)⁺ − lowerᵀ (dual)⁻."""
    qp, dual = solution.problem, solution.dual
    upper = np.concatenate([qp.upper, qp.row_upper])
    lower = np.concatenate([qp.lower, np.full(len(qp.row_upper), -np.inf)])
    held = np.where(dual > 0, upper, np.where(dual < 0, lower, 0.0))
    support = float(np.sum(held[dual != 0] * dual[dual != 0]))
    return abs(float(solution.x @ (qp.hessian @ solution.x) + qp.gradient @ solution.x) + support)
