"""A plain version of the MPC, as one would write it first: torch, matrices multiplied out, OSQP."""

import numpy as np
import osqp
import torch
from scipy import sparse

from leapgap.jumping.control.condensed_qp import Horizon, horizon
from leapgap.jumping.control.leg_kinematics import LegKinematics, StartFrame
from leapgap.jumping.control.mpc import MpcConfig
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.models.rigid_body import GRAVITY, Situation, columns
from leapgap.logs.pair_force import FORCE_X, FORCE_Z, per_axis
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate
from tests.benchmarks.tick.random_networks import INPUTS, LIKE_CONTROL, Layers, Weights
from tests.conftest import A1_BODY


class Plain:
    """The plain version of one jump: torch, matrices multiplied out, OSQP."""

    def __init__(self, reference: Reference, robot: Robot, weights: Weights, config: MpcConfig) -> None:
        self.reference, self.config, self.legs = reference, config, LegKinematics(robot)
        self.h1, self.h2, self.g1 = (self._torch(net) for net in (weights.h1, weights.h2, weights.g1))
        self.body = A1_BODY
        self.frame: StartFrame | None = None
        self.solvers: dict[int, osqp.OSQP] = {}
        self.force = np.zeros((0, 4))

    @staticmethod
    def _torch(net: Layers) -> torch.nn.Module:
        parts: list[torch.nn.Module] = []
        for weight, bias in net:
            linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
            linear.weight.data, linear.bias.data = torch.from_numpy(weight.copy()), torch.from_numpy(bias.copy())
            parts += [linear, torch.nn.Tanh()]
        return torch.nn.Sequential(*parts[:-1]).eval()

    def command(self, estimate: StateEstimate) -> np.ndarray:
        """Joint torques of an update."""
        self.frame = self.frame or StartFrame.of(estimate)
        state, foot = self.frame.state(estimate), self.frame.foot(estimate, self.legs)
        steps = horizon(self.config.grid, self.reference.schedule, estimate.time_s)
        rows = self.reference.rows(steps.time_s)
        target = self.reference.state[rows[1:]]
        feet = np.concatenate([foot[None], self.reference.foot[rows[1:-1]]])
        states = np.concatenate([state[None], self.reference.state[rows[1:-1]]])
        bias, by_force = self._networks(states, feet, self.reference.state[rows[0]], steps.contact)
        free, gain = self._multiplied_out(state, bias, by_force, steps)
        self.force = self._solve(free, gain, target, self.reference.mean_force(steps.time_s), steps)
        pair_force = self.frame.in_world(self.force[0])
        return self.legs.torque(estimate.base_quaternion, estimate.joint_pos, pair_force)

    def _networks(
        self, states: np.ndarray, feet: np.ndarray, start: np.ndarray, contact: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        starts = np.concatenate([states[:1], np.tile(start, (len(states) - 1, 1))])
        situation = Situation(states, feet, np.zeros(len(states)), starts)
        x = torch.from_numpy(np.stack(columns(INPUTS, situation), axis=-1).astype(np.float32))
        with torch.no_grad():
            h1, h2, g1 = (net(x).numpy() for net in (self.h1, self.h2, self.g1))
        bias = np.where(contact[:, None], h1, h2).astype(float)
        bias[:, 1] -= GRAVITY
        by_force = self.body.force_rows(feet) + g1.reshape(-1, 3, 4) * LIKE_CONTROL
        return bias, by_force * contact[:, None, None]

    @staticmethod
    def _multiplied_out(
        state: np.ndarray, bias: np.ndarray, by_force: np.ndarray, steps: Horizon
    ) -> tuple[np.ndarray, np.ndarray]:
        """Free states (n, 6) and gain (n, 6, 4 n) of all forces, step by step."""
        n = len(steps)
        free, gain = np.zeros((n, 6)), np.zeros((n, 6, 4 * n))
        x, g = state, np.zeros((6, 4 * n))
        for k, dt in enumerate(steps.step_s):
            a = np.eye(6)
            a[:3, 3:] = dt * np.eye(3)
            x, g = a @ x, a @ g
            x[3:] += dt * bias[k]
            g[3:, 4 * k : 4 * k + 4] += dt * by_force[k]
            free[k], gain[k] = x, g
        return free, gain

    def _solve(
        self, free: np.ndarray, gain: np.ndarray, target: np.ndarray, force: np.ndarray, steps: Horizon
    ) -> np.ndarray:
        n, config = len(steps), self.config
        q = np.tile(config.weights.diagonal, n)
        flat = gain.reshape(6 * n, 4 * n)
        hessian = 2 * (flat.T @ (q[:, None] * flat) + config.force_weight * np.eye(4 * n))
        gradient = 2 * flat.T @ (q * (free - target).ravel()) - 2 * config.force_weight * force.ravel()
        pushing = per_axis(steps.share > 0)
        upper = np.concatenate([(config.limits.largest_n * pushing).ravel(), np.zeros(4 * n)])
        lower = np.concatenate([(-config.limits.largest_n * pushing).ravel(), np.full(4 * n, -1e30)])
        index = np.arange(4 * n).reshape(n, 4)
        lower[index[:, FORCE_Z]] = 0.0
        triangle = np.triu_indices(4 * n)
        if n not in self.solvers:
            cone = np.zeros((4 * n, 4 * n))
            x, z = index[:, FORCE_X].ravel(), index[:, FORCE_Z].ravel()
            up, down = np.arange(0, 4 * n, 2), np.arange(1, 4 * n, 2)
            cone[up, x], cone[down, x] = 1.0, -1.0
            cone[up, z] = cone[down, z] = -config.limits.friction
            dense = sparse.csc_matrix((np.ones(len(triangle[0])), triangle), shape=(4 * n, 4 * n))
            dense.data = hessian.T[np.tril_indices(4 * n)]
            self.solvers[n] = osqp.OSQP()
            rows = sparse.csc_matrix(np.concatenate([np.eye(4 * n), cone]))
            self.solvers[n].setup(dense, gradient, rows, lower, upper, verbose=False, adaptive_rho_interval=25)
        else:  # the upper triangle column by column is the lower one row by row
            self.solvers[n].update(Px=hessian.T[np.tril_indices(4 * n)], q=gradient, l=lower, u=upper)
        return self.solvers[n].solve(raise_error=False).x.reshape(n, 4)
