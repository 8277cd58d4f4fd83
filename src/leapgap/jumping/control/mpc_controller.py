"""The paper's controller of a jump: variable-frequency MPC for the ground forces, joint PD at every tick."""

import math
import time
from collections.abc import Callable
from itertools import product

import numpy as np

from leapgap.jumping.control.gains import PhaseGains
from leapgap.jumping.control.horizon import ROUNDING_S
from leapgap.jumping.control.mpc import ForcePlan, ForcePlanner
from leapgap.jumping.control.mpc_config import MpcConfig
from leapgap.jumping.control.reference import Reference
from leapgap.jumping.control.start_frame import StartFrame
from leapgap.jumping.control.tracking import JumpController
from leapgap.jumping.models.affine_model import PredictionModel
from leapgap.jumping.models.deviation_model import DeviationModel
from leapgap.logs.pair_force import per_axis
from leapgap.robot.model import Robot
from leapgap.simulation.controller import StateEstimate

POSE_NOT_FINITE = "pose not finite"
PUSHING = {pairs: per_axis(np.array(pairs)) for pairs in product((False, True), repeat=2)}
"""Which of the four forces push, by the contact of the front and the rear pair."""


class JumpMpc(JumpController):
    """Plans at the MPC's period from the measured state, holds the first force, maps it to torques at every tick.

    Gravity, momentum and pitch are planned as a planar body along the heading of the start; ``model`` is the nominal
    ``RigidBodyModel``, a learned one, or one of the deviation from the plan. ``plan_now`` is the latest plan.
    """

    def __init__(
        self,
        reference: Reference,
        robot: Robot,
        gains: PhaseGains,
        model: PredictionModel | DeviationModel,
        config: MpcConfig,
        level_m: float | None = 0.0,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        super().__init__(reference, robot, gains, level_m)
        self.config = config
        if config.compiled:  # numba is imported only where it is used
            from leapgap.jumping.control.compiled_planner import CompiledPlanner
            from leapgap.jumping.control.leg_chains import CompiledLegs

            self.planner: ForcePlanner = CompiledPlanner(reference, model, config, clock)
            self.legs = CompiledLegs(robot)
        else:
            self.planner = ForcePlanner(reference, model, config, clock)
        self.fallbacks = self.planner.fallbacks
        self.plan_now: ForcePlan | None = None
        self._updates = 0
        self._pose: tuple[np.ndarray, np.ndarray] | None = None

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """τ = −Jᵀ u of the first planned force, while the schedule has feet on the ground."""
        contact = self.reference.schedule.pairs_in_contact(time_s)
        if not any(contact):
            return self.zero_feed_forward()
        force = self._decided(time_s, estimate, frame) * PUSHING[contact]
        return self.legs.planar_torque(*self._measured_pose(time_s, estimate), force, frame), force

    def _decided(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> np.ndarray:
        """Force of the latest plan, (4,), N; an update first, where one is due."""
        if time_s > self._updates * self.config.period_s - ROUNDING_S:
            self._update(time_s, estimate, frame)
        assert self.plan_now is not None
        return self.plan_now.force[0]

    def _update(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> None:
        """Plan again; the next update is due at the next whole period."""
        self._updates = int((time_s + ROUNDING_S) / self.config.period_s) + 1
        self.plan_now = self.planner.plan(time_s, *self.legs.planar(estimate, frame))
        if self.plan_now.fallback is not None:
            self.substituted.append((time_s, self.plan_now.fallback))

    def _measured_pose(self, time_s: float, estimate: StateEstimate) -> tuple[np.ndarray, np.ndarray]:
        """Quaternion (4,) and joints (joints,), measured; where not finite, the last finite ones or the reference's."""
        pose = (estimate.base_quaternion, estimate.joint_pos)
        if math.isfinite(pose[0] @ pose[0] + pose[1] @ pose[1]):  # of limited size, by the border
            self._pose = pose
            return pose
        self.fallbacks[POSE_NOT_FINITE] += 1
        self.substituted.append((time_s, POSE_NOT_FINITE))
        if self._pose is not None:
            return self._pose
        return np.array([1.0, 0.0, 0.0, 0.0]), self.reference.joint_pos[self.reference.row(time_s)]


class DepartingMpc(JumpMpc):
    """The plan's own torques, which move the legs too and overcome what its joints are known to resist; the MPC adds
    what its forces depart from the plan's by."""

    def feed_forward(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> tuple[np.ndarray, np.ndarray]:
        """Torques (joints,), N·m, and pair forces (4,), N."""
        torque, force = self.planned(time_s)
        contact = self.reference.schedule.pairs_in_contact(time_s)
        if not any(contact):
            return torque, force
        decided = self._decided(time_s, estimate, frame)
        departs = (self.config.limits.within(force + decided - self._mean) - force) * PUSHING[contact]
        pose = self._measured_pose(time_s, estimate)
        return torque + self.legs.planar_torque(*pose, departs, frame), force + departs

    def _update(self, time_s: float, estimate: StateEstimate, frame: StartFrame) -> None:
        super()._update(time_s, estimate, frame)
        assert self.plan_now is not None
        self._mean = self.reference.mean_force(self.plan_now.horizon.time_s[:2])[0]
        """Of the plan over the first step, (4,), N."""
