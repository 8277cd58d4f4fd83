"""What a state, a force and an effect do to the state at the end of each interval."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap.diagnosis.channels import displaced, tangent_difference
from leapgap.diagnosis.engine.intervals import Intervals
from leapgap.diagnosis.hypotheses import Hypothesis, places
from leapgap.diagnosis.short_rollouts import ROUGH
from leapgap.effects.base import Effect
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.rollout import joint_commands

POSITION_STEP, VELOCITY_STEP = 2e-4, 1e-2
"""Displacements by which transitions are differenced: m and rad, m/s and rad/s, about the noise of good sensors."""
LEAST_TORQUE = 1e-3
"""Smallest unit of force, N or N·m."""
SHARE = 0.1
"""A unit of the force without a name: this share of the robot's weight, or of the torque that a joint's motor gave."""


def rough_steps(intervals: Intervals) -> Intervals:
    """The intervals by long steps of the simulation; those of a held robot keep theirs, which are short already."""
    replayer = intervals.replayer
    if not intervals.robot.has_free_base:
        return intervals
    return replace(intervals, replayer=replayer.with_steps(ROUGH * replayer.largest_step_s))


@dataclass(frozen=True)
class Linearisation:
    """Derivatives of the state at the end of each interval, one array a log."""

    transitions: tuple[np.ndarray, ...]
    """By the state at its beginning, (intervals, 2 nv, 2 nv)."""
    forces: tuple[np.ndarray, ...]
    """By a constant force of one unit at each degree of freedom, (intervals, 2 nv, nv)."""
    units: np.ndarray
    """Unit of the force at each degree of freedom, N or N·m, (nv,)."""
    gains: np.ndarray
    """By which states, force and zeros of joint sensors follow what is measured, (chunks, longest, N, channels)."""


@dataclass(frozen=True)
class Displacements:
    """Displaced starts and forces, whose replays are differenced at one state after another."""

    units: np.ndarray
    """Of the force at each degree of freedom, N or N·m, (nv,)."""

    @property
    def steps(self) -> np.ndarray:
        """Displacements of the state, (2 nv,)."""
        nv = len(self.units)
        return np.concatenate([np.full(nv, POSITION_STEP), np.full(nv, VELOCITY_STEP)])

    def starts(self, states: Motion, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        """Starts and forces of each state: itself, displaced in each entry, and with each force.

        (states × (1 + 3 nv), nq + nv) and (states × (1 + 3 nv), nv), state by state.
        """
        count, nv = len(states), len(self.units)
        moved = [states]
        for entry, step in enumerate(self.steps):
            by = np.zeros((count, 2 * nv))
            by[:, entry] = step
            moved.append(displaced(states, by, robot))
        moved += [states] * nv
        stacked = np.stack([np.concatenate([one.qpos, one.qvel], axis=1) for one in moved], axis=1)
        forces = np.concatenate([np.zeros((2 * nv + 1, nv)), np.diag(self.units)])
        return stacked.reshape(-1, stacked.shape[2]), np.tile(forces, (count, 1))

    def derivatives(self, reached: Motion, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the state reached from each by its start and by force, from replays of ``starts``.

        (states, 2 nv, 2 nv) and (states, 2 nv, nv).
        """
        nv = len(self.units)
        width = 1 + 3 * nv
        base = reached[np.repeat(np.arange(0, len(reached), width), width)]
        changes = tangent_difference(reached, base, robot).reshape(-1, width, 2 * nv)[:, 1:].transpose(0, 2, 1)
        return changes[:, :, : 2 * nv] / self.steps, changes[:, :, 2 * nv :]


def force_units(intervals: Intervals) -> np.ndarray:
    """Unit of the force without a name at each degree of freedom, N or N·m, (nv,).

    A tenth of the weight at the base, of the weight times the robot's own size for its moments, and of the root mean
    square torque of the motors for joints, by the log.
    """
    robot, model = intervals.robot, intervals.robot.model
    units = np.zeros(model.nv)
    asked = np.concatenate([asked_torque(own.states, robot) for own in intervals.courses])
    torque = np.sqrt((asked**2).mean(axis=0))
    units[robot.joint_dofs] = np.maximum(torque, 0.1 * torque.max())
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
    values: tuple[np.ndarray, ...]
    """(intervals, 2 nv, columns) of each log."""
    members: Mapping[tuple[str, str], tuple[str, ...]]
    """(effect, location) → its single places."""

    @staticmethod
    def of(
        intervals: Intervals,
        linearisation: Linearisation,
        hypotheses: Sequence[Hypothesis],
        known: "Columns | None" = None,
        acting: Sequence[str] = (),
    ) -> "Columns":
        """Columns of all effects of some hypotheses at every single place, by replays of moderate departures.

        They act beside the effects that act already, by long steps of the simulation, whose error cancels. Of effects
        ``acting`` the columns that are ``known`` stay, since none acts twice.
        An effect that acts as a torque along each joint by itself is replayed once, at all places, and what it does is
        shared out among the joints by the responses to their torques.
        """
        robot, intervals = intervals.robot, rough_steps(intervals)
        kinds = {h.name: h for h in hypotheses}
        members = {(name, at): of for name, h in kinds.items() for at, of in places(h.kind, robot).items()}
        keys: list[ColumnKey] = []
        sets: list[tuple[Effect, float]] = []
        shared: list[tuple[int, tuple[str, ...], int]] = []
        for name, h in kinds.items():
            single = members[name, "all"]
            together = h.kind.along_joints and len(single) > 1
            for k in range(len(h.parameters)):
                if name in acting:
                    keys += [ColumnKey(name, k, place) for place in single]
                    continue
                if together:
                    shared.append((len(keys), single, len(sets)))
                    sets.append((departed(replace(h, location="all"), k), 1.0))
                    keys += [ColumnKey(name, k, place) for place in single]
                    continue
                for place in single:
                    there = replace(h, location=place)
                    sets.append((departed(there, k), there.moderate[k]))
                    keys.append(ColumnKey(name, k, place))
        values = [np.zeros((own.intervals, 2 * robot.model.nv, len(keys))) for own in intervals.courses]
        changes = intervals.changes(
            [[(*own, effect) for own in intervals.acting] for effect, _ in sets], linearisation.transitions
        )
        at, position = {first: (single, index) for first, single, index in shared}, 0
        index = 0
        while position < len(keys):
            if keys[position].effect in acting:
                assert known is not None
                column = known.keys.index(keys[position])
                for own, before in zip(values, known.values, strict=True):
                    own[:, :, position] = before[:, :, column]
                position += 1
                continue
            if position in at:
                single, of_set = at[position]
                h = kinds[keys[position].effect]
                dofs = [int(robot.joint_dofs[robot.joints.index(joint)]) for joint in single]
                size = replace(h, location="all").moderate[keys[position].number]
                for log, own in enumerate(values):
                    response = linearisation.forces[log][:, :, dofs]
                    torque = np.linalg.solve(
                        np.einsum("kij,kil->kjl", response, response) + 1e-12 * np.eye(len(dofs)),
                        np.einsum("kij,ki->kj", response, changes[of_set][log])[:, :, None],
                    )[:, :, 0]
                    own[:, :, position : position + len(single)] = response * torque[:, None] / size
                position += len(single)
            else:
                for log, own in enumerate(values):
                    own[:, :, position] = changes[index][log] / sets[index][1]
                position += 1
            index += 1
        return Columns(tuple(keys), tuple(values), members)

    def at(self, hypothesis: Hypothesis, number: int) -> list[int]:
        """Indices of the columns whose sum is the derivative by a number of a hypothesis."""
        joined = self.members[hypothesis.name, hypothesis.location]
        return [
            i
            for i, key in enumerate(self.keys)
            if (key.effect, key.number) == (hypothesis.name, number) and key.place in joined
        ]


def departed(hypothesis: Hypothesis, number: int) -> Effect:
    """The effect with one number a moderate departure from nominal."""
    numbers = hypothesis.nominal
    numbers[number] += hypothesis.moderate[number]
    return hypothesis.on("", numbers)
