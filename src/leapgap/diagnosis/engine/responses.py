"""What a state, a force and an effect do to the state at the end of each interval."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from leapgap.diagnosis.channels import displaced, tangent_difference
from leapgap.diagnosis.engine.intervals import Course, Intervals, Shares
from leapgap.diagnosis.hypotheses import Hypothesis, places
from leapgap.diagnosis.short_rollouts import ROUGH
from leapgap.effects.base import Commands, Effect, ForceContext, overrides
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.rollout import joint_commands

SPREAD = np.sqrt(3.0)  # Standard deviations by which states are displaced: that at which normal errors are met best
MANY_STEPS = 16  # Number of steps of the simulation in an interval that may be twice as long for derivatives
LEAST_TORQUE = 1e-3  # Smallest unit of force, N or N·m
LITTLE = 0.05
"""Share of a moderate departure by which contacts are changed for derivatives: feet move by less than a millimetre."""
SHARE = 0.1
"""A unit of the force without a name: this share of the robot's weight, or of the torque that a joint's motor gave."""


def rough_steps(intervals: Intervals) -> Intervals:
    """The intervals by long steps of the simulation; those of a held robot keep theirs where there are few in each."""
    replayer = intervals.replayer
    if not intervals.robot.has_free_base and intervals.interval_s < MANY_STEPS * replayer.largest_step_s:
        return intervals
    return replace(intervals, replayer=replayer.with_steps(ROUGH * replayer.largest_step_s))


@dataclass(frozen=True)
class Linearisation:
    """Derivatives of the state at the end of each interval, one array a log."""

    transitions: tuple[np.ndarray, ...]  # By the state at its beginning, (intervals, 2 nv, 2 nv)
    forces: tuple[np.ndarray, ...]  # By a constant force of one unit at each degree of freedom, (intervals, 2 nv, nv)
    missed: tuple[np.ndarray, ...]  # Covariance of what they miss, (intervals, 2 nv, 2 nv)
    units: np.ndarray  # Unit of the force at each degree of freedom, N or N·m, (nv,)
    gains: np.ndarray
    """By which states and force follow what is measured, (chunks, longest, 3 nv, channels)."""


@dataclass(frozen=True)
class Displacements:
    """Starts and forces displaced to both sides, whose replays are differenced at one state after another.

    They are as far off as the state and the force are known, in as many directions as these have entries, so that
    derivatives hold over all that is likely. What they miss there is an error of known covariance (the filter of
    divided differences of Nørgaard, Poulsen and Ravn, 2000).
    """

    roots: np.ndarray
    """Root of the covariance of state and force (units) of each state, (states, 3 nv, 3 nv); its columns displace."""
    units: np.ndarray  # Of the force at each degree of freedom, N or N·m, (nv,)

    def starts(self, states: Motion, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        """Starts and forces of each state: itself, and displaced along each direction.

        (states × (1 + 6 nv), nq + nv) and (states × (1 + 6 nv), nv), state by state.
        """
        n, by = 2 * len(self.units), SPREAD * self.roots.transpose(0, 2, 1)
        by = np.concatenate([np.zeros_like(by[:, :1]), by, -by], axis=1)
        moved = displaced(states[np.repeat(np.arange(len(states)), by.shape[1])], by[:, :, :n].reshape(-1, n), robot)
        forces = (by[:, :, n:] * self.units).reshape(-1, len(self.units))
        return np.concatenate([moved.qpos, moved.qvel], axis=1), forces

    def derivatives(self, reached: Motion, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of the state reached from each by its start and by force, from replays of ``starts``.

        (states, 2 nv, 2 nv), (states, 2 nv, nv), and the covariance of what they miss, (states, 2 nv, 2 nv).
        """
        n, count = 2 * len(self.units), self.roots.shape[2]
        width = 1 + 2 * count
        base = reached[np.repeat(np.arange(0, len(reached), width), width)]
        changes = tangent_difference(reached, base, robot).reshape(-1, width, n)[:, 1:]
        there, back = changes[:, :count], changes[:, count:]
        slopes = np.linalg.solve(self.roots.transpose(0, 2, 1), (there - back) / (2 * SPREAD)).transpose(0, 2, 1)
        bent = (there + back) * np.sqrt(SPREAD**2 - 1) / (2 * SPREAD**2)
        return slopes[:, :, :n], slopes[:, :, n:], bent.transpose(0, 2, 1) @ bent


def force_units(intervals: Intervals) -> np.ndarray:
    """Unit of the force without a name at each degree of freedom, N or N·m, (nv,).

    A tenth of the weight at the base, of the weight times the robot's own size for its moments, and of the root mean
    square torque of the motors for joints, by the log.
    """
    robot, model = intervals.robot, intervals.robot.model
    units = np.zeros(model.nv)
    asked = np.concatenate([asked_torque(own.states, robot) for own in intervals.courses])
    torque = np.sqrt((asked**2).mean(axis=0))
    units[robot.joint_dofs] = np.maximum(torque, 0.1 * torque.max(initial=0.0))
    if robot.has_free_base:
        weight = robot.total_mass * float(np.linalg.norm(model.opt.gravity))
        size = float(np.sqrt(model.body_inertia[1].max() / model.body_mass[1]))
        units[:3], units[3:6] = weight, weight * size
    return np.maximum(SHARE * units, LEAST_TORQUE)


def asked_torque(states: States, robot: Robot) -> np.ndarray:
    """Torque that the joint PD asks of the motors in every row of a log, within their limits, (rows, joints)."""
    torque, kp, position, kd, velocity = (
        joint_commands(states.log, robot, name) for name in ("cmd_tau", "cmd_kp", "cmd_pos", "cmd_kd", "cmd_vel")
    )
    moved = states.motion
    asked = torque + kp * (position - moved.qpos[:, robot.joint_qpos])
    asked += kd * (velocity - moved.qvel[:, robot.joint_dofs])
    return np.asarray(np.clip(asked, -robot.torque_limits, robot.torque_limits))


@dataclass(frozen=True)
class ColumnKey:
    """Which number of which effect at which single place a column is the derivative by."""

    effect: str
    number: int
    place: str


@dataclass(frozen=True)
class Columns:
    """Derivatives of the reported state at the end of each interval by every number of every effect."""

    keys: tuple[ColumnKey, ...]
    values: tuple[np.ndarray, ...]  # (intervals, 2 nv, columns) of each log
    members: Mapping[tuple[str, str], tuple[str, ...]]  # (effect, location) → its single places

    @staticmethod
    def of(
        intervals: Intervals,
        linearisation: Linearisation,
        hypotheses: Sequence[Hypothesis],
        known: "Columns | None" = None,
        acting: Sequence[str] = (),
        elsewhere: Sequence[str] = (),
    ) -> "Columns":
        """Columns of all effects of some hypotheses at every single place, beside the effects that act already.

        - Of effects ``acting`` the columns that are ``known`` stay, since none acts twice. Those that are told
          ``elsewhere`` are zero.
        - An effect that acts as a torque along each joint by itself is replayed once, at all places; what it does is
          shared out among the joints by the responses to their torques.
        - One whose force is known in closed form does what the responses make of that force. (What sensors of a held
          robot report wrongly cancels against its joint PD but for little: it is replayed.)
        - All others are replayed at moderate departures, by long steps of the simulation, whose error cancels.
        """
        robot, intervals = intervals.robot, rough_steps(intervals)
        kinds = {h.name: h for h in hypotheses}
        members = {(name, at): of for name, h in kinds.items() for at, of in places(h.kind, robot).items()}
        context, ends = force_context(intervals), np.cumsum([own.intervals for own in intervals.courses])
        by_row = row_contexts(intervals) if robot.stands else []
        keys: list[ColumnKey] = []
        found: list[Sequence[np.ndarray]] = []
        replayed: list[tuple[list[int], Hypothesis, int]] = []
        """Which columns a replay tells, and of which number of what."""
        for name, h in kinds.items():
            single, numbers = members[name, "all"], range(len(h.parameters))
            new, first = [ColumnKey(name, k, place) for k in numbers for place in single], len(keys)
            keys += new
            if name in elsewhere:
                found += [[np.zeros((own.intervals, 2 * robot.model.nv)) for own in intervals.courses] for _ in new]
                continue
            if name in acting:
                assert known is not None
                found += [[own[:, :, known.keys.index(key)] for own in known.values] for key in new]
                continue
            by_replay = not robot.stands and (h.kind.along_joints or overrides(h.kind, "change_measured"))
            motion = by_row if h.kind.along_joints else [(context, None)]
            forces = None if by_replay else closed_form(h.kind, single, motion)
            if forces is not None:
                for key, force in zip(new, forces, strict=True):
                    there, of_logs = replace(h, location=key.place), np.split(force, ends[:-1])
                    found.append(
                        [
                            of_force(linearisation, log, own)
                            + misreported(intervals, linearisation, log, there, key.number)
                            for log, own in enumerate(of_logs)
                        ]
                    )
                continue
            found += [[] for _ in new]
            for k in numbers:
                at = [first + k * len(single) + i for i in range(len(single))]
                if h.kind.along_joints and len(single) > 1:
                    replayed.append((at, replace(h, location="all"), k))
                    continue
                replayed += [([i], replace(h, location=place), k) for i, place in zip(at, single, strict=True)]
        names = [own.states.log.name for own in intervals.courses]
        sets = [
            [(*own, *departed(h, k, log)) for own, log in zip(intervals.acting, names, strict=True)]
            for _, h, k in replayed
        ]
        changes = intervals.changes(sets, linearisation.transitions)
        for (at, h, k), change in zip(replayed, changes, strict=True):
            slopes = [own / departure(h, k) for own in change]
            if len(at) == 1:
                found[at[0]] = slopes
                continue
            dofs = [int(robot.joint_dofs[robot.joints.index(keys[i].place)]) for i in at]
            parts = [shared(own, of[:, :, dofs]) for own, of in zip(slopes, linearisation.forces, strict=True)]
            for i, column in enumerate(at):
                found[column] = [own[:, :, i] for own in parts]
        values = [
            np.stack([of[log].reshape(own.intervals, -1) for of in found], axis=2)
            for log, own in enumerate(intervals.courses)
        ]
        return Columns(tuple(keys), tuple(values), members)

    def at(self, hypothesis: Hypothesis, number: int) -> list[int]:
        """Indices of the columns whose sum is the derivative by a number of a hypothesis."""
        at = self._places[hypothesis.name, number]
        return [at[place] for place in self.members[hypothesis.name, hypothesis.location]]

    @cached_property
    def _places(self) -> dict[tuple[str, int], dict[str, int]]:
        """(effect, number) → single place → index of its column."""
        found: dict[tuple[str, int], dict[str, int]] = {}
        for i, key in enumerate(self.keys):
            found.setdefault((key.effect, key.number), {})[key.place] = i
        return found


def departed(hypothesis: Hypothesis, number: int, log: str = "") -> tuple[Effect, ...]:
    """The effect with one number off nominal, on a log, as it is on the ground of the model."""
    numbers = hypothesis.nominal
    numbers[number] += departure(hypothesis, number)
    return hypothesis.on(log, numbers).on_model_ground()


def departure(hypothesis: Hypothesis, number: int) -> float:
    """A moderate departure from nominal; a small one of what changes the contacts of feet, far from linear in it."""
    kind = hypothesis.kind
    changed = any(overrides(kind, method) for method in ("change_model", "change_spec"))
    return float(hypothesis.moderate[number] * (LITTLE if changed and hypothesis.robot.stands else 1.0))


def shared(change: np.ndarray, responses: np.ndarray) -> np.ndarray:
    """Change (intervals, 2 nv) by torques along some joints as parts (intervals, 2 nv, joints), one a joint.

    ``responses`` (intervals, 2 nv, joints) are those to a unit torque at each.
    """
    square = np.einsum("kij,kil->kjl", responses, responses) + 1e-12 * np.eye(responses.shape[2])
    torque = np.linalg.solve(square, np.einsum("kij,ki->kj", responses, change)[:, :, None])
    return np.asarray(responses * torque[:, None, :, 0])


def force_context(intervals: Intervals) -> ForceContext:
    """The motion of all replays in the middle of each interval, log by log, with the mean commands."""
    courses = intervals.courses
    begin = joined([own.reference[own.begins] for own in courses])
    change = tangent_difference(joined(intervals.predicted), begin, intervals.robot)
    commands = []
    for own in courses:
        rows, shares = own.rows_within(np.arange(own.intervals))
        commands.append([shares.means(of[rows]) for of in commands_of(own, intervals.robot)])
    length = np.concatenate([own.lengths_s for own in courses])
    motion = displaced(begin, 0.5 * change, intervals.robot)
    return context_of(intervals.robot, motion, change, list(map(np.concatenate, zip(*commands, strict=True))), length)


def row_contexts(intervals: Intervals) -> list[tuple[ForceContext, Shares]]:
    """The same of every row, segment by segment, with the shares of rows in their intervals.

    Torques of motors follow commands that change from row to row.
    """
    found = []
    for log, own in enumerate(intervals.courses):
        for first, count in zip(np.cumsum([0, *own.segments]), own.segments, strict=False):
            at = np.arange(first, first + count)
            begin = own.reference[own.begins[at]]
            change = tangent_difference(intervals.predicted[log][at], begin, intervals.robot)
            rows, shares = own.rows_within(at)
            moved, length = change[shares.each], own.lengths_s[at][shares.each]
            motion = displaced(begin[shares.each], shares.middles[:, None] * moved, intervals.robot)
            commands = [of[rows] for of in commands_of(own, intervals.robot)]
            found.append((context_of(intervals.robot, motion, moved, commands, length, shares), shares))
    return found


def commands_of(course: Course, robot: Robot) -> list[np.ndarray]:
    """Commands and gains of the joint PD in every row of a log, in the order of ``context_of``, (rows, joints) each."""
    names = ("cmd_tau", "cmd_pos", "cmd_vel", "cmd_kp", "cmd_kd")
    return [joint_commands(course.states.log, robot, name) for name in names]


def context_of(
    robot: Robot,
    motion: Motion,
    change: np.ndarray,
    commands: Sequence[np.ndarray],
    length_s: np.ndarray,
    shares: Shares | None = None,
) -> ForceContext:
    """A motion with what is commanded in each step.

    ``change`` (steps, 2 nv) is what the interval of each adds to the state in its length, s, (steps,). Steps are whole
    intervals, or rows with ``shares`` in them.
    """
    tau, position, velocity, kp, kd = commands
    parts = 1.0 if shares is None else float(np.median(shares.counts))
    moved = motion.qpos, motion.qvel, change[:, robot.model.nv :] / length_s[:, None]
    step_s = float(np.median(length_s)) / parts
    return ForceContext(robot, robot.without_shapes, *moved, Commands(tau, position, velocity), kp, kd, step_s)


def joined(motions: Sequence[Motion]) -> Motion:
    """Motions one after the other."""
    return Motion(np.concatenate([one.qpos for one in motions]), np.concatenate([one.qvel for one in motions]))


def closed_form(
    kind: type[Effect], single: Sequence[str], motion: Sequence[tuple[ForceContext, Shares | None]]
) -> np.ndarray | None:
    """Force per unit of each number at each place, (numbers × places, intervals, nv); None where it is not known.

    Parts of the motion whose steps are rows come with the shares of these in intervals.
    """
    found = []
    for at, shares in motion:
        forces = [own for place in single if (own := kind.force(at, place)) is not None]
        if len(forces) < len(single):
            return None
        stacked = np.stack(forces, axis=1)
        of_intervals = stacked if shares is None else shares.means(stacked)
        found.append(of_intervals.reshape(-1, *of_intervals.shape[2:]))
    return np.concatenate(found, axis=1)


def late_feedback(intervals: Intervals, linearisation: Linearisation) -> list[np.ndarray]:
    """What the joint PD changes if the states that it answers are late, per second, (intervals, 2 nv) a log."""
    torques = [
        shares.means(at.at_motors("all", at.within * (at.kp * at.velocity + at.kd * at.acceleration))[0])
        for at, shares in row_contexts(intervals)
    ]
    ends = np.cumsum([own.intervals for own in intervals.courses])
    of_logs = np.split(np.concatenate(torques), ends[:-1])
    return [of_force(linearisation, log, own) for log, own in enumerate(of_logs)]


def of_force(linearisation: Linearisation, log: int, force: np.ndarray) -> np.ndarray:
    """What a force (intervals, nv), N and N·m, changes by the end of each interval, (intervals, 2 nv)."""
    return np.einsum("kij,kj->ki", linearisation.forces[log], force / linearisation.units)


def misreported(
    intervals: Intervals, linearisation: Linearisation, log: int, hypothesis: Hypothesis, number: int
) -> np.ndarray | float:
    """What one number of an effect changes in the sensors, and so at the true start, per unit, (intervals, 2 nv)."""
    if not overrides(hypothesis.kind, "change_measured"):
        return 0.0
    begins, late = intervals.courses[log].begins, intervals.misreported(log, departed(hypothesis, number))
    kept = np.einsum("kij,kj->ki", linearisation.transitions[log], late[begins])
    return np.asarray((late[begins + 1] - kept) / departure(hypothesis, number))
