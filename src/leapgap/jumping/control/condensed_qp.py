"""The MPC's condensed QP in the contact forces, with everything but its first step prepared ahead of time.

The prediction is ζ⁺ = ζ + Δt a, q⁺ = q + Δt ζ + c Δt² a with a = b + C x + B u, and b, C and B given at each step
(paper, residual and MPC; there c = 0 and C = 0). The states after the first step are x₁ and, from there, affine in x₁
and the later forces U.

b_j, C_j and B_j for j ≥ 1 are taken at the reference, so the cost of the whole rest of the horizon is one quadratic
function of (x₁, U). It is a constant of the jump, the ``PreparedQp``. Online, only x₁ = free + E u₀ is substituted into
it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from leapgap.jumping.control.qp import Qp
from leapgap.jumping.learning.windows import TimeGrid
from leapgap.jumping.models.rigid_body import POSITION, VELOCITY, AffineModel, advance
from leapgap.jumping.task import ContactSchedule
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, FORCES, per_axis

ROUNDING_S = 1e-6  # Times closer than this count as equal, as in ``ContactSchedule.in_contact``


@dataclass(frozen=True)
class Horizon:
    """The n ≤ K steps of one prediction."""

    time_s: np.ndarray  # Start of each step and end of the last one, since the start of the jump, (n + 1,)
    share: np.ndarray  # Part of each step during which the front and the rear pair are planned to push, 0…1, (n, 2)

    def __len__(self) -> int:
        return len(self.share)

    @property
    def step_s(self) -> np.ndarray:
        """Length of each step, (n,)."""
        return np.diff(self.time_s)

    @property
    def contact(self) -> np.ndarray:
        """Whether each step begins before take-off, bool, (n,)."""
        return np.asarray(self.share.any(axis=1))


def nodes(grid: TimeGrid, schedule: ContactSchedule) -> np.ndarray:
    """Ends of the steps of a whole jump, s, increasing; phases need not be whole numbers of steps."""
    take_off, flight = schedule.take_off_s, schedule.flight_s
    in_contact = int(np.floor(take_off / grid.contact_step_s - ROUNDING_S))
    in_flight = max(1, round(flight / grid.flight_step_s))
    before = take_off - grid.contact_step_s * np.arange(in_contact, 0, -1)
    after = take_off + grid.flight_step_s * np.arange(in_flight)
    return np.concatenate([before, after, [schedule.landing_s]])


def horizon(grid: TimeGrid, schedule: ContactSchedule, time_s: float) -> Horizon:
    """The horizon from a moment of the jump, s since its start; from the landing on it has no step."""
    ends = nodes(grid, schedule)
    first = int(np.searchsorted(ends, time_s + ROUNDING_S))
    if first < len(ends):
        contact = time_s < schedule.take_off_s - ROUNDING_S
        whole = grid.contact_step_s if contact else grid.flight_step_s
        phase_ends = np.isclose(ends[first], [schedule.take_off_s, schedule.landing_s], rtol=0, atol=ROUNDING_S).any()
        if ends[first] - time_s < whole / 2 - ROUNDING_S and not phase_ends:
            first += 1
    times = np.concatenate([[time_s], ends[first : first + grid.steps]])
    begin, length = times[:-1, None], np.diff(times)[:, None]
    share = np.clip((np.array([schedule.double_contact_s, schedule.take_off_s]) - begin) / length, 0.0, 1.0)
    share[share * length < ROUNDING_S] = 0.0
    share[(1 - share) * length < ROUNDING_S] = 1.0
    return Horizon(times, share)


STATES = 6


@dataclass(frozen=True)
class ForceLimits:
    """Limits of the ground force on a pair of feet: |F_x| ≤ μ F_z and F_min ≤ F_z ≤ F_max, N."""

    friction: float = 0.6
    largest_n: float = 350.0
    smallest_n: float = 0.0
    from_plan_n: float | None = None  # Largest departure of each force from the planned one; None: any

    def __post_init__(self) -> None:
        if not (0 < self.friction < np.inf and 0 <= self.smallest_n < self.largest_n < np.inf):
            raise ValueError(f"{self}: friction above 0 and 0 <= smallest_n < largest_n")
        if self.from_plan_n is not None and not 0 < self.from_plan_n < np.inf:
            raise ValueError(f"{self}: from_plan_n finite and above 0, or none")

    def within(self, force: np.ndarray) -> np.ndarray:
        """Forces (…, 4), N, of both pairs, each axis moved to its nearest value within bounds and cone."""
        found = force.copy()
        found[..., FORCE_Z] = np.clip(force[..., FORCE_Z], self.smallest_n, self.largest_n)
        widest = self.friction * found[..., FORCE_Z]
        found[..., FORCE_X] = np.clip(force[..., FORCE_X], -widest, widest)
        return found


@dataclass(frozen=True)
class PreparedQp:
    """Cost after the first step, ½ zᵀ P z + pᵀ z of z = (x₁, U), and which forces are the variables of the QP."""

    horizon: Horizon
    quadratic: np.ndarray  # P, (6 + m, 6 + m)
    linear: np.ndarray  # p, (6 + m,)
    pushing: np.ndarray  # Which forces (front x z, rear x z) are variables at each step, bool, (n, 4); others are zero
    first: np.ndarray  # Indices of the forces that are variables in the first step, (m₀,)
    first_push_s: np.ndarray  # Time for which each of them pushes in the first step, s, (m₀,)
    curvature: float  # c
    force_weight: float
    first_force: np.ndarray  # Reference of the first step's variables, (m₀,), N
    lower: np.ndarray
    upper: np.ndarray
    rows: np.ndarray
    row_upper: np.ndarray  # Bounds and cone of all variables, as in ``Qp``; ``lower`` and ``upper`` bound variables

    def qp(self, state: np.ndarray, first: AffineModel) -> Qp:
        """The QP from a state (6,); ``first`` is the model at the first step, an ``AffineModel`` of one moment."""
        free = advance(state, first.bias[0], self.step_s, self.curvature)
        gained = first.by_force[0][:, self.first] * self.first_push_s
        enters = np.concatenate([self.curvature * self.step_s * gained, gained])  # of x₁, (6, m₀)
        of_states, m0 = self.quadratic[:STATES], len(self.first)
        of_rest = enters.T @ of_states
        hessian = self._hessian.copy()
        hessian[:m0, :m0] += of_rest[:, :STATES] @ enters
        hessian[:m0, m0:] = of_rest[:, STATES:]
        hessian[m0:, :m0] = of_rest[:, STATES:].T
        slope = free @ of_states + self.linear
        of_first = slope[:STATES] @ enters - 2 * self.force_weight * self.first_force
        gradient = np.concatenate([of_first, slope[STATES:]])
        return Qp(hessian, gradient, self.lower, self.upper, self.rows, self.row_upper)

    @cached_property
    def _hessian(self) -> np.ndarray:
        """The part of the Hessian that does not depend on the first step."""
        m0 = len(self.first)
        hessian = np.zeros((m0 + len(self.linear) - STATES,) * 2)
        hessian[:m0, :m0] = 2 * self.force_weight * np.eye(m0)
        hessian[m0:, m0:] = self.quadratic[STATES:, STATES:]
        return hessian

    @cached_property
    def step_s(self) -> float:
        """Length of the first step, s."""
        return float(self.horizon.step_s[0])

    def forces(self, x: np.ndarray) -> np.ndarray:
        """Forces of every step from the QP's variables ``x``: front x z, rear x z, N, (n, 4)."""
        forces = np.zeros(self.pushing.shape)
        forces[self.pushing] = x
        return forces


def prepare_qp(
    horizon: Horizon,
    later: AffineModel,
    target: np.ndarray,
    force: np.ndarray,
    state_weight: np.ndarray,
    force_weight: float,
    limits: ForceLimits,
    curvature: float = 0.0,
) -> PreparedQp:
    """Prepare Σ_{k=1..n} ‖x_k − target_k‖²_Q + w Σ_{k=0..n−1} ‖u_k − force_k‖² for any first state.

    ``later`` is the model at the steps 1…n − 1; ``target`` (n, 6) the target states at the ends of the
    steps; ``force`` (n, 4) in N; ``state_weight`` the diagonal of Q, (6,) or of each step (n, 6); at least one step.
    """
    pushing = per_axis(horizon.share > 0)
    shared = later.by_force * per_axis(horizon.share[1:])[:, None, :]  # a force acts for its share of the step
    later = AffineModel(later.bias, shared, later.by_state)
    by_state, by_force, drift = after_first_step(horizon, later, curvature)
    by_force = by_force[:, :, pushing[1:]]
    z = np.concatenate([by_state, by_force], axis=2).reshape(len(horizon) * STATES, -1)
    weight = np.broadcast_to(state_weight, target.shape).reshape(-1, 1)
    quadratic = 2 * z.T @ (weight * z)
    linear = 2 * z.T @ (weight[:, 0] * (drift - target).ravel())
    of_forces = np.arange(STATES, len(linear))
    quadratic[of_forces, of_forces] += 2 * force_weight
    linear[STATES:] -= 2 * force_weight * force[1:][pushing[1:]]
    first = np.flatnonzero(pushing[0])
    push_s = horizon.step_s[0] * per_axis(horizon.share[0])[first]
    limited = constraints(pushing, limits, force)
    return PreparedQp(
        horizon, quadratic, linear, pushing, first, push_s, curvature, force_weight, force[0][first], *limited
    )


def after_first_step(
    horizon: Horizon, later: AffineModel, curvature: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States at the ends of the steps as by_state x₁ + by_force U + drift: (n, 6, 6), (n, 6, n − 1, 4), (n, 6)."""
    n = len(horizon)
    by_state, drift = np.zeros((n, STATES, STATES)), np.zeros((n, STATES))
    by_force = np.zeros((n, STATES, n - 1, FORCES))
    by_state[0] = np.eye(STATES)
    for j, step_s in enumerate(horizon.step_s[1:]):  # from the end of step j to that of step j + 1
        enters = np.concatenate([curvature * step_s**2 * np.eye(3), step_s * np.eye(3)])  # of an acceleration, (6, 3)
        moves = np.eye(STATES)
        moves[POSITION, VELOCITY] += step_s * np.eye(3)
        if later.by_state is not None:
            moves += enters @ later.by_state[j]
        by_state[j + 1] = moves @ by_state[j]
        by_force[j + 1] = np.tensordot(moves, by_force[j], axes=1)
        by_force[j + 1, :, j] = enters @ later.by_force[j]
        drift[j + 1] = moves @ drift[j] + enters @ later.bias[j]
    return by_state, by_force, drift


def constraints(
    pushing: np.ndarray, limits: ForceLimits, planned: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Bounds and friction cone of the forces that are variables: lower, upper, rows, row_upper.

    ``planned`` (n, 4), N: where a plan lies outside of bounds and cone, the nearest force within is meant.
    """
    count = int(pushing.sum())
    lower, upper = np.full(count, -np.inf), np.full(count, np.inf)
    is_z = np.zeros_like(pushing)
    is_z[:, FORCE_Z] = pushing[:, FORCE_Z]
    z = np.flatnonzero(is_z[pushing])
    x = z - 1  # F_x of the same pair stands just before it
    lower[z], upper[z] = limits.smallest_n, limits.largest_n
    if limits.from_plan_n is not None:
        middle = limits.within(planned)[pushing]
        lower = np.maximum(lower, middle - limits.from_plan_n)
        upper = np.minimum(upper, middle + limits.from_plan_n)
    rows = np.zeros((2 * len(z), count))
    up, down = np.arange(0, len(rows), 2), np.arange(1, len(rows), 2)
    rows[up, x], rows[down, x] = 1.0, -1.0
    rows[up, z] = rows[down, z] = -limits.friction
    return lower, upper, rows, np.zeros(len(rows))


assert FORCE_X.start == FORCE_Z.start - 1, "the friction cone above relies on x before z"
