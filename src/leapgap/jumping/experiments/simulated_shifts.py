"""Jumps of the identified robot in simulation: what shifts of the goal do to the landing, and what kicks do.

Each kicked jump is compared with the same jump without the kick, so that nothing else counts: not the goal, not the
shifts on the way, not what the simulation has wrong in both. Commands are known beforehand, so whole jumps roll out
without a Python loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from leapgap.effects.base import Effect
from leapgap.errors import InputError
from leapgap.jumping.control.condensed_qp import ROUNDING_S
from leapgap.jumping.control.shifted_plan import GOAL_AXES, ShiftedPlan, ShiftGrid
from leapgap.jumping.control.tracking import Reference
from leapgap.jumping.experiments.goal_directed_jump import JumpPlanner
from leapgap.jumping.experiments.goal_shift_jump import Authority, KickedJumps, shifted_plan
from leapgap.jumping.experiments.trial import LEAVES_WITHIN_S, UPRIGHT_RAD
from leapgap.jumping.models.rigid_body import GRAVITY
from leapgap.jumping.planning.reference import to_jump
from leapgap.jumping.task import Target
from leapgap.logs.log import Log
from leapgap.logs.pair_force import WORLD_X_Z
from leapgap.robot.kinematics import feet_positions
from leapgap.robot.model import Robot
from leapgap.robot.motion import ANGULAR_VELOCITY_SLICE, POSITION_SLICE, Motion
from leapgap.robot.rotations import pitch_of
from leapgap.robot.topology import PAIRS
from leapgap.simulation.open_loop import Course, MotionPlan, PreparedRun, prepare
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, Starts
from leapgap.simulation.sensors import SensorNoise

TOUCHES_M = 0.002  # A foot this close to the ground touches it
PARTS_OF_A_PUSH = 6  # A push is simulated as so many kicks


@dataclass(frozen=True)
class ShiftDraws:
    """Ranges of random shifts: every ``hold_s`` one is drawn, and reached linearly."""

    largest: tuple[float, float, float] = (0.08, 0.06, 0.12)  # x, z, pitch; m, m, rad
    hold_s: float = 0.15

    def draw(self, updates: int, period_s: float, rng: np.random.Generator) -> np.ndarray:
        """Shifts from each update on, (updates, 3)."""
        each = max(1, round(self.hold_s / period_s))
        knots = rng.uniform(-1, 1, (updates // each + 2, GOAL_AXES)) * self.largest
        knots[0] = 0.0
        at = (np.arange(updates) + 1) / each
        return np.stack([np.interp(at, np.arange(len(knots)), column) for column in knots.T], axis=1)


@dataclass(frozen=True)
class SimulatedShiftsConfig:
    """How many jumps are simulated, and what is drawn for them."""

    goals: int = 18  # Number of goals that are planned; each is jumped to without shifts, and with random ones
    kicks: int = 40  # Number of kicks of each of these jumps, one at a time; every second one is a push
    x_m: tuple[float, float] = (0.35, 0.8)
    z_m: tuple[float, float] = (-0.04, 0.15)
    pitch_rad: tuple[float, float] = (-0.15, 0.15)  # Ranges of goals; z from the height of a robot on level ground
    block_m: tuple[float, float] = (0.0, 0.07)  # Of a block under the front feet in every second goal, as planned
    shifts: ShiftDraws = field(default_factory=ShiftDraws)
    share: tuple[float, float] = (0.2, 0.6)  # Random shifts of a jump are scaled by a share in this range
    kick: tuple[float, float, float] = (0.4, 0.2, 1.5)  # Largest sudden change of vx and vz, m/s, and pitch rate, rad/s
    push: tuple[float, float, float] = (0.5, 0.15, 0.0)  # The same of what a push changes in all
    push_s: tuple[float, float] = (0.05, 0.15)  # How long a push acts
    kick_between_s: tuple[float, float] = (0.1, 0.5)
    probed_x_m: tuple[float, ...] = (0.4, 0.55, 0.7)  # Distances of goals at which differences tell what shifts do
    probes: tuple[float, float, float] = (0.03, 0.03, 0.06)  # Shifts, both ways, for these differences; m, m, rad


@dataclass(frozen=True)
class Kick:
    """A sudden change of the trunk's motion."""

    row: int
    change: np.ndarray  # Of forward and vertical velocity, m/s, and of pitch rate, rad/s, (3,)


def draw_kick(config: SimulatedShiftsConfig, period_s: float, rng: np.random.Generator) -> list[Kick]:
    """One random kick; the period is that of the rows."""
    return [Kick(draw_row(config, period_s, rng), rng.uniform(-1, 1, 3) * config.kick)]


def draw_push(config: SimulatedShiftsConfig, period_s: float, rng: np.random.Generator) -> list[Kick]:
    """A random push, as equal kicks in the middles of the equal times into which it falls."""
    start, change = draw_row(config, period_s, rng), rng.uniform(-1, 1, 3) * config.push
    part = float(rng.uniform(*config.push_s)) / PARTS_OF_A_PUSH / period_s
    return [Kick(start + round((i + 0.5) * part), change / PARTS_OF_A_PUSH) for i in range(PARTS_OF_A_PUSH)]


def draw_row(config: SimulatedShiftsConfig, period_s: float, rng: np.random.Generator) -> int:
    """The row at which a random kick or push begins."""
    return round(float(rng.uniform(*config.kick_between_s)) / period_s)


@dataclass(frozen=True)
class SimulatedJump:
    """One jump to simulate."""

    start: PreparedRun
    plan: ShiftedPlan
    shift: np.ndarray  # Shift of the goal from each update on, (updates, 3)


@dataclass(frozen=True)
class ShiftSimulator:
    """Simulates shifted jumps of one robot with effects, from level ground or with the front feet on a block."""

    planner: JumpPlanner
    robot: Robot
    effects: tuple[Effect, ...]
    level: Log  # A plan from level ground, from whose first pose the robot starts
    grid: ShiftGrid
    average_rows: int  # Rows over which the deviation from the plan is averaged, as the controller does
    late_rows: int  # Delay of the base's state, in rows
    noise: SensorNoise

    def kicked(self, config: SimulatedShiftsConfig, rng: np.random.Generator) -> KickedJumps:
        """Plan goals, simulate jumps to them with and without kicks, and read what a controller could have measured.

        Jumps that fall are left out, as those of the robot itself are: how a fall ends says nothing about landings.
        """
        replayer = Replayer(self.robot, terrain_slots=1, threads=1)
        period = self.level.info.sample_period_s
        since, changes = [], []
        for jump in (one for number in range(config.goals) for one in self._draw(number, replayer, config, rng)):
            trial = self._rollout(jump)
            (calm,) = replayer.true_motions([trial])
            landing, deviation = self._landing(calm), self._deviations(jump, calm)
            if abs(landing[2]) > UPRIGHT_RAD:
                continue
            for number in range(config.kicks):
                kicks = (draw_push if number % 2 else draw_kick)(config, period, rng)
                motion = self._kicked(calm, kicks, trial, replayer)
                own = self._landing(motion)
                if abs(own[2]) <= UPRIGHT_RAD:
                    since.append(self._since(self._deviations(jump, motion) - deviation, kicks[0].row, rng))
                    changes.append(own - landing)
        if not changes:
            found, do = "no simulated jump that lands", "simulate more goals, or smaller kicks"
            raise InputError("land.method_settings", found, "one or more", do)
        return KickedJumps(np.array(since), np.array(changes))

    def authority(self, config: SimulatedShiftsConfig) -> Authority:
        """What a shift during each update does to the landing: differences of jumps shifted from that update on.

        They are off by what a shift to one side does differently from one to the other, and where the effect is no
        straight line between the goals.
        """
        replayer = Replayer(self.robot, terrain_slots=1, threads=1)
        (start,) = prepare([MotionPlan("level", self.level)], replayer, self.effects, Course())
        of_goals = []
        for x in config.probed_x_m:
            goal = np.array([x, 0.0, 0.0])
            plan = self._plan(goal, 0.0)
            if plan is not None:
                jump = SimulatedJump(start, plan, np.zeros((self.grid.updates, GOAL_AXES)))
                of_goals.append((x, self._differences(jump, replayer, config.probes)))
        if not of_goals:
            raise InputError("land.method_settings", "no plan to any of probed_x_m", "at least one", "name other ones")
        mean, one_sided = (np.array(part) for part in zip(*(found for _, found in of_goals), strict=True))
        error = np.concatenate([one_sided / np.sqrt(len(one_sided)), bends(mean)])
        return Authority(mean, error, np.array([x for x, _ in of_goals]))

    def _differences(
        self, jump: SimulatedJump, replayer: Replayer, probes: tuple[float, float, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """G of each update at one goal, and half of how much it differs to both sides, (updates, 3, 3) each."""
        held = np.zeros((2, self.grid.updates + 1, GOAL_AXES, GOAL_AXES))
        """Effects of shifts that are held from each update on, to both sides."""
        (unshifted,) = replayer.true_motions([self._rollout(jump)])
        landing = self._landing(unshifted)
        rows_each = round(self.grid.period_s / jump.plan.reference.period_s)
        for update in range(self.grid.updates):
            before = first_rows(unshifted, update * rows_each + 1)
            for axis, size in enumerate(probes):
                for side, step in enumerate((size, -size)):
                    shift = jump.shift.copy()
                    shift[update:, axis] = step
                    trial = self._rollout(replace(jump, shift=shift))
                    moved = continued(before, before.last_state, trial, replayer, len(trial.log))
                    held[side, update, :, axis] = (self._landing(moved) - landing) / step
        forward, back = held[:, :-1] - held[:, 1:]
        return (forward + back) / 2, (forward - back) / 2

    def _plan(self, goal: np.ndarray, stance_pitch: float) -> ShiftedPlan | None:
        solution = self.planner.plan(Target(round(float(goal[0]), 3)), goal, stance_pitch)
        if solution is None:
            return None
        reference = Reference.of(to_jump(solution), self.robot)
        return shifted_plan(self.planner, solution, reference, self.robot)

    def _draw(
        self, number: int, replayer: Replayer, config: SimulatedShiftsConfig, rng: np.random.Generator
    ) -> list[SimulatedJump]:
        """The jumps to one random goal; none where it has no plan."""
        goal = rng.uniform(*np.transpose([config.x_m, config.z_m, config.pitch_rad]))
        block_m = round(float(rng.uniform(*config.block_m)), 4) if number % 2 else 0.0
        (start,) = prepare([MotionPlan(f"goal_{number}", self.level, block_m)], replayer, self.effects, Course())
        plan = self._plan(goal, ground_pitch(start.start, self.robot))
        if plan is None:
            return []
        unshifted = np.zeros((self.grid.updates, GOAL_AXES))
        drawn = rng.uniform(*config.share) * config.shifts.draw(self.grid.updates, self.grid.period_s, rng)
        return [SimulatedJump(start, plan, shift) for shift in (unshifted, drawn)]

    def _kicked(self, calm: Motion, kicks: Sequence[Kick], trial: Rollout, replayer: Replayer) -> Motion:
        """The true motion of a trial with some kicks, one after the other."""
        motion = first_rows(calm, kicks[0].row + 1)
        ends = [*(kick.row + 1 for kick in kicks[1:]), len(trial.log)]
        for kick, end in zip(kicks, ends, strict=True):
            state = motion.last_state
            velocity = state[self.robot.model.nq :]
            velocity[[0, 2]] += kick.change[:2]
            velocity[ANGULAR_VELOCITY_SLICE][1] += kick.change[2]
            motion = continued(motion, state, trial, replayer, end)
        return motion

    def _rollout(self, jump: SimulatedJump) -> Rollout:
        return Rollout(commanded_log(jump, self.grid, self.robot), self.effects, first_state=jump.start.start)

    def _landing(self, motion: Motion) -> np.ndarray:
        """Pose (3,) at the end; where a foot touches earlier, the flight is continued as a free one."""
        schedule, period = self.grid.schedule, self.level.info.sample_period_s
        settled = round((schedule.take_off_s + LEAVES_WITHIN_S) / period)
        feet = feet_positions(self.robot, motion.qpos[settled:])[:, :, 2] - self.robot.foot_radius
        touched = np.flatnonzero((feet < TOUCHES_M).any(axis=1))
        row = settled + (max(touched[0] - 1, 0) if len(touched) else len(feet) - 1)
        left_s = (len(motion) - 1 - row) * period
        position, velocity = motion.base_position, motion.base_velocity
        x = position[row, 0] - position[0, 0] + left_s * velocity[row, 0]
        z = position[row, 2] + left_s * velocity[row, 2] - GRAVITY * left_s**2 / 2
        pitch = pitch_of(motion.base_quaternion[row]) + left_s * motion.base_angular_velocity[row, 1]
        return np.array([x, z - self.level["base_pos_z"][0], pitch])

    def _deviations(self, jump: SimulatedJump, motion: Motion) -> np.ndarray:
        """Deviation from the shifted plan at each update as a controller without noise measures it, (updates, 10)."""
        position, velocity = motion.base_position, motion.base_velocity
        state = np.column_stack(
            [
                position[:, 0] - position[0, 0],
                position[:, 2],
                pitch_of(motion.base_quaternion),
                velocity[:, 0],
                velocity[:, 2],
                motion.base_angular_velocity[:, 1],
            ]
        )
        period = jump.plan.reference.period_s
        rows = self._rows(period)
        windows = np.maximum(rows[:, None] - np.arange(self.average_rows), 0)
        shifts = shift_at(jump.shift, self.grid, period * np.arange(len(state)))[0]
        slopes, planned = jump.plan.slopes, jump.plan.reference
        trunk = planned.state[windows] + np.einsum("uri,iurj->urj", shifts[windows], slopes["state"][:, windows])
        feet = planned.foot[rows] + np.einsum("ui,iuj->uj", shifts[rows], slopes["foot"][:, rows])
        measured = state[np.maximum(windows - self.late_rows, 0)]
        return np.concatenate(
            [(measured - trunk).mean(axis=1), pair_feet(self.robot, motion.qpos[rows]) - feet], axis=1
        )

    def _rows(self, period_s: float) -> np.ndarray:
        """The row of each update, (updates,)."""
        rows: np.ndarray = np.round(np.arange(self.grid.updates) * self.grid.period_s / period_s).astype(int)
        return rows

    def _since(self, change: np.ndarray, row: int, rng: np.random.Generator) -> np.ndarray:
        """A change of deviations (updates, 10) by a kick as it is measured, once it shows: with the noise of both."""
        noise = self.noise
        spread = (
            [noise.base_pos_m] * 2 + [noise.base_angle_rad] + [noise.base_linvel_m_s] * 2 + [noise.base_angvel_rad_s]
        )
        found = change.copy()
        found[:, : len(spread)] += np.sqrt(2 / self.average_rows) * rng.standard_normal((len(found), 6)) * spread
        found[self._rows(self.level.info.sample_period_s) <= row + self.average_rows + self.late_rows] = np.nan
        return found


def bends(effects: np.ndarray) -> np.ndarray:
    """How far inner ones of some effects (g, T, 3, 3) in a row are off the line between their neighbours, as many."""
    inner = effects[1:-1] - (effects[:-2] + effects[2:]) / 2
    return inner / np.sqrt(max(len(inner), 1))


def first_rows(motion: Motion, rows: int) -> Motion:
    """The first rows of a motion."""
    return Motion(motion.qpos[:rows], motion.qvel[:rows])


def continued(before: Motion, state: np.ndarray, trial: Rollout, replayer: Replayer, rows: int) -> Motion:
    """A motion whose last row is replaced by ``state`` (nq + nv,), and what the commands of a trial make of it until
    it has so many rows."""
    row = len(before) - 1
    ((after,),) = replayer.replay_pieces([trial], [Starts([row], state[None])], rows - row)
    return Motion(np.concatenate([before.qpos[:-1], after.qpos]), np.concatenate([before.qvel[:-1], after.qvel]))


def ground_pitch(state: np.ndarray, robot: Robot) -> float:
    """Pitch of the ground under the feet of a true state (nq + nv,), rad, nose-down."""
    front_x, front_z, rear_x, rear_z = pair_feet(robot, state[None, : robot.model.nq])[0]
    return float(-np.arctan2(front_z - rear_z, front_x - rear_x))


def pair_feet(robot: Robot, qpos: np.ndarray) -> np.ndarray:
    """Foot − base, mean of each pair, front x z, rear x z, m, (rows, 4)."""
    feet = feet_positions(robot, qpos) - qpos[:, None, POSITION_SLICE]
    return np.concatenate([feet[:, robot.feet_at(pair)].mean(axis=1)[:, WORLD_X_Z] for pair in PAIRS], axis=1)


def shift_at(shift: np.ndarray, grid: ShiftGrid, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shift (rows, 3) and its rate at some times: each update's shift is reached linearly within its period."""
    ends = grid.period_s * np.arange(grid.updates + 1)
    values = np.concatenate([np.zeros((1, GOAL_AXES)), shift])
    now = np.stack([np.interp(times_s, ends, column) for column in values.T], axis=1)
    update = np.minimum((times_s + ROUNDING_S) // grid.period_s, grid.updates).astype(int)
    rates = np.concatenate([np.diff(values, axis=0), np.zeros((1, GOAL_AXES))]) / grid.period_s
    return now, rates[update]


def commanded_log(jump: SimulatedJump, grid: ShiftGrid, robot: Robot) -> Log:
    """Commands of the shifted plan in every row, on the terrain of the start."""
    plan, reference = jump.plan, jump.plan.reference
    rows = len(reference.state)
    time = reference.period_s * np.arange(rows)
    shift, rate = shift_at(jump.shift, grid, time)

    def moved(quantity: str) -> np.ndarray:
        values: np.ndarray = getattr(reference, quantity)
        return values + np.einsum("ri,irj->rj", shift, plan.slopes[quantity])

    commands = {
        "cmd_tau": moved("torque"),
        "cmd_pos": moved("joint_pos"),
        "cmd_vel": moved("joint_vel") + np.einsum("ri,irj->rj", rate, plan.slopes["joint_pos"]),
    }
    columns = {"time": time}
    for name, values in commands.items():
        columns |= {f"{name}/{joint}": values[:, i] for i, joint in enumerate(robot.joints)}
    for name, values in jump.start.commanded.columns.items():
        if name.startswith(("cmd_kp/", "cmd_kd/")):
            columns[name] = values[:rows]
    return replace(jump.start.commanded, columns=columns)
