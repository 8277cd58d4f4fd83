"""Points of the search: a robot with some effects at some numbers, replayed, with columns that lead on from there."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from leapgap import effects
from leapgap.diagnosis.channels import tangent_difference
from leapgap.diagnosis.engine.evidence import BLOCK_S, Blocks, Evidence, Whitened
from leapgap.diagnosis.engine.intervals import Effects, Intervals
from leapgap.diagnosis.engine.responses import Columns, Linearisation, late_feedback, rough_steps, shared
from leapgap.diagnosis.engine.whitening import Chunks, Filter, filters_of, follow, linearise
from leapgap.diagnosis.hypotheses import Hypothesis, places, tolerance, usable
from leapgap.diagnosis.simulation_settings import SimulationSettings
from leapgap.effects.base import Effect, overrides
from leapgap.logs.state import States
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout, joint_commands

INTERVAL_S = 0.01  # Length of an interval; one row, where that is longer
GLANCED = 250  # About how many intervals tell what is worth a closer look
LEAST_IN_BLOCK = 5  # Number of intervals of a block at least
DIFFERENCE = 0.1  # Numbers of effects that act are differenced by this share of a moderate departure
ABSENT = 1e-9  # Prior standard deviation of the numbers of an effect that is taken out of a set
PRIOR, OF_RANGE = 3.0, 0.25
"""Standard deviation of a number's prior in moderate departures, and at least as a share of the way to its limits."""
SMALL = {
    "contact_damping.scale": 0.05,
    "encoder_bias.bias_rad": 5e-4,
    "foot_compliance.time_constant_s": 0.002,
    "ground_height.height_m": 5e-4,
    "leg_geometry.hip_x_m": 5e-4,
    "leg_geometry.lower_m": 5e-4,
    "leg_geometry.upper_m": 5e-4,
    "link_com.outward_m": 1e-3,
    "link_inertia.scale": 0.02,
    "position_gain.scale": 0.01,
    "sample_period.scale": 5e-4,
    "torque_gain.scale": 0.005,
    "velocity_gain.scale": 0.03,
}
"""Standard deviations of further numbers, in their units: no robot is built, and no contact simulated, more exactly."""
OTHER_CONTACTS = (
    SimulationSettings(slack=1.2),
    SimulationSettings(width=1.2),
    SimulationSettings(friction_impedance=0.5),
    SimulationSettings(other_cone=True),
)
LATE = ("command_delay", "state_latency")
QUARTER = 0.25  # Share of a row by which it is not known when commands act and states are measured

DRIVE = ("change_commands", "change_drive", "torque_by_velocity", "put_controls")
"""Methods of effects by which torques follow from commands."""

Acting = tuple[tuple[Hypothesis, np.ndarray], ...]  # Effects with their numbers


@dataclass(frozen=True)
class Basis:
    """What is linearised about one robot."""

    about: Acting  # The effects about which everything is linearised, with their numbers
    hypotheses: Sequence[Hypothesis]  # Effects that are looked for
    linearisation: Linearisation
    filters: tuple[Filter, ...]  # One for each level of the force without a name
    columns: Columns
    whitened: Whitened
    """All columns, and behind them those of late logs and of finer steps, in single precision: they are many."""
    nuisances: np.ndarray  # Indices of those that are off a little in every robot and simulation, (nuisances,)
    deviation: np.ndarray  # Standard deviation of each nuisance, (nuisances,)
    blocks: Blocks

    @cached_property
    def of_nuisances(self) -> Whitened:
        """Columns of the nuisances at each level, (chunks, longest, channels, nuisances)."""
        return [own[..., self.nuisances].astype(float) for own in self.whitened]

    @cached_property
    def products(self) -> np.ndarray:
        """Their inner products in each block, (levels, blocks, nuisances, nuisances)."""
        return self.blocks.products(self.of_nuisances, self.of_nuisances)

    def part(self, chunks: Chunks, chosen: np.ndarray) -> "Basis":
        """The same of some of the ``chunks``, bool (chunks,)."""
        of, longest = self.linearisation, int(chunks.length[chosen].max())
        masks = [np.repeat(*pair) for pair in zip(chunks.by_log(chosen), chunks.by_log(chunks.length), strict=True)]
        transitions, forces, missed = (
            tuple(own[mask] for own, mask in zip(of_logs, masks, strict=True) if mask.any())
            for of_logs in (of.transitions, of.forces, of.missed)
        )
        return replace(
            self,
            linearisation=Linearisation(transitions, forces, missed, of.units, of.gains[chosen, :longest]),
            filters=tuple(own.part(chosen, longest) for own in self.filters),
            columns=replace(self.columns, values=()),
            whitened=[own[chosen, :longest] for own in self.whitened],
            blocks=self.blocks.part(chosen)[0],
        )

    def of_hypothesis(self, h: Hypothesis) -> Whitened:
        """Columns of the numbers of a hypothesis."""
        at = [self.columns.at(h, k) for k in range(len(h.parameters))]
        return [np.stack([own[..., own_at].sum(axis=3, dtype=float) for own_at in at], axis=3) for own in self.whitened]

    def of_hypotheses(self, hypotheses: Sequence[Hypothesis]) -> Whitened:
        """Columns of the numbers of one hypothesis or more."""
        parts = [self.of_hypothesis(h) for h in hypotheses]
        return [np.concatenate(of_level, axis=3) for of_level in zip(*parts, strict=True)]


@dataclass(frozen=True)
class Point:
    """A robot with some effects."""

    acting: Acting
    intervals: Intervals
    basis: Basis
    own: Whitened  # Errors, and behind them columns of the numbers of the acting effects
    evidence: Evidence  # Of errors, nuisances and numbers

    @staticmethod
    def of(acting: Acting, intervals: Intervals, basis: Basis, errors: Whitened, slopes: Whitened) -> "Point":
        """The point with whitened errors, and columns of the numbers of its effects."""
        own = [np.concatenate(pair, axis=3) for pair in zip(errors, slopes, strict=True)]
        evidence = Evidence.of(basis.blocks, with_nuisances(own, basis), basis.products)
        return Point(acting, intervals, basis, own, evidence)

    def part(self, chunks: Chunks, chosen: np.ndarray) -> "Point":
        """The same by some of the ``chunks``, bool (chunks,), with the levels of their blocks."""
        basis = self.basis.part(chunks, chosen)
        own = [of[chosen, : chunks.length[chosen].max()] for of in self.own]
        parts = ([of[..., :1] for of in own], [of[..., 1:] for of in own])
        point = Point.of(self.acting, self.intervals.part(chunks.by_log(chosen)), basis, *parts)
        levels = self.evidence.levels[self.basis.blocks.part(chosen)[1]]
        return replace(point, evidence=replace(point.evidence, levels=levels))

    @property
    def whitened(self) -> Whitened:
        """Errors, nuisances, numbers of the acting effects; made from its parts each time, since points are many."""
        return with_nuisances(self.own, self.basis)

    @property
    def nuisances(self) -> int:
        """Number of nuisances, whose columns stand before those of effects."""
        return len(self.basis.deviation)

    def priors(
        self, further: Sequence[Hypothesis] = (), without: Sequence[int] = (), drawn: Sequence[float] = ()
    ) -> tuple[np.ndarray, np.ndarray]:
        """Prior deviations and means of nuisances, of departures of the acting numbers from here, of further numbers.

        Members ``without`` are taken back to nominal; deviations of members are times ``drawn``, if that is given.
        """
        deviation, centre = [*self.basis.deviation], [0.0] * self.nuisances
        for m, (h, numbers) in enumerate(self.acting):
            deviation += [ABSENT] * len(numbers) if m in without else [*(prior_of(h) * (drawn[m] if drawn else 1.0))]
            centre += [*(h.nominal - numbers)]
        for h in further:
            deviation += [*prior_of(h)]
            centre += [0.0] * len(h.parameters)
        return np.array(deviation), np.array(centre)

    def evidence_with(self, further: Sequence[Hypothesis], whitened: Whitened | None = None) -> Evidence:
        """Evidence with the columns of further effects, by this linearisation; ``whitened`` where they are made."""
        if not further:
            return self.evidence
        return self.evidence.extended(whitened or self.whitened, self.basis.of_hypotheses(further))


@dataclass(frozen=True)
class Bench:
    """All that is common to the points of a search."""

    hypotheses: Sequence[Hypothesis]
    tolerances: Mapping[str, float]
    states: Sequence[States]
    replayer: Replayer

    @property
    def robot(self) -> Robot:
        """The robot as its model has it."""
        return self.replayer.robot

    @cached_property
    def intervals(self) -> Intervals:
        """The logs in intervals, by the nominal robot from smoothed states."""
        return Intervals.of(self.states, self.replayer, INTERVAL_S)

    @cached_property
    def chunks(self) -> Chunks:
        """The intervals of all logs side by side."""
        return Chunks.of(self.intervals)

    @cached_property
    def some(self) -> np.ndarray:
        """Chunks that tell what is worth a closer look, spread evenly, bool (chunks,)."""
        count = len(self.chunks.log)
        kept = max(1, round(count * min(1.0, GLANCED / self.chunks.length.sum())))
        return np.isin(np.arange(count), np.linspace(0, count - 1, kept).round())

    @cached_property
    def otherwise(self) -> tuple[SimulationSettings, ...]:
        """Settings of a robot with feet that may be others: no log tells how a controller computes its joint PD."""
        if not self.robot.stands:
            return ()
        gains = [joint_commands(own.log, self.robot, "cmd_kd").max(axis=0) for own in self.states]
        other = otherwise_integrated(self.robot, np.max(gains, axis=0), self.replayer.largest_step_s)
        return OTHER_CONTACTS if other is None else (*OTHER_CONTACTS, other)

    @cached_property
    def kinds(self) -> dict[str, Hypothesis]:
        """A hypothesis of every effect that has columns: those that are looked for, and those with a tolerance."""
        known = effects.known()
        found = {h.name: h for h in reversed(self.hypotheses)}
        for name in sorted({key.partition(".")[0] for key in self.tolerances} - set(found)):
            if usable(known[name], self.robot):
                found[name] = Hypothesis(known[name], self.robot)
        return found

    @cached_property
    def of_feet(self) -> list[str]:
        """Effects whose columns are told by references that follow the logs."""
        return [name for name, h in self.kinds.items() if self.robot.stands and meets_ground(h.kind)]

    def nominal(self, simulation: tuple[SimulationSettings, ...] = ()) -> Point:
        """The nominal robot by some simulation."""
        return self.linearised(self.intervals.simulated_by(simulation), (), None)

    def linearised(self, intervals: Intervals, acting: Acting, before: Basis | None) -> Point:
        """The point of a robot with some effects, with everything linearised about it.

        ``before`` tells what effects with a memory do, and columns of the acting effects.
        """
        width = 2 * self.robot.model.nv
        none = [np.zeros((own.intervals, width, width)) for own in intervals.courses]
        transitions = none if before is None else before.linearisation.transitions
        offsets = intervals.remembered(transitions)
        intervals, linearisation = linearise(intervals, self.chunks, offsets)
        filters = tuple(filters_of(intervals, linearisation, self.chunks))
        known, present = None if before is None else before.columns, [h.name for h, _ in acting]
        columns = Columns.of(intervals, linearisation, list(self.kinds.values()), known, present, self.of_feet)
        others = self.other_simulations(intervals, linearisation)
        parts = zip(columns.values, self.late(columns), others, strict=True)
        stacked = self.chunks.stack([np.concatenate(of_log, axis=2) for of_log in parts])
        per_block = max(LEAST_IN_BLOCK, round(BLOCK_S / self.intervals.interval_s))
        basis = Basis(
            acting,
            self.hypotheses,
            linearisation,
            filters,
            columns,
            [-own.whiten(stacked).astype(np.float32) for own in filters],
            *self.nuisances(columns),
            Blocks.of([own.log_determinant for own in filters], self.chunks.valid, self.chunks.log, per_block),
        )
        return self.moved(intervals, self.with_feet_moved(basis, intervals, acting), acting)

    def nuisances(self, columns: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Indices of columns of what is off a little in every robot and simulation, and their standard deviations.

        The step of the simulation is off, where it is no hypothesis.
        """
        found: dict[int, float] = {}
        for name, share in {**self.tolerances, **SMALL}.items():
            effect, _, parameter = name.partition(".")
            for i, key in enumerate(columns.keys):
                if key.effect != effect or self.kinds[effect].parameters[key.number].name != parameter:
                    continue
                kind = self.kinds[effect].kind
                size = share if name in SMALL else tolerance(kind, self.robot, key.place, parameter, share)
                if size > 0:
                    found[i] = float(size)
        quarter, present = QUARTER * self.states[0].log.info.sample_period_s, {key.effect for key in columns.keys}
        step = 0.0 if any(overrides(h.kind, "change_step") for h in self.hypotheses) else 1.0
        half_step = [0.5 * self.replayer.own_step_s] if self.robot.stands else []
        others = [step, *half_step, *[1.0] * len(self.otherwise)]
        further = [quarter for name in LATE if name in present] + others
        found |= {len(columns.keys) + k: size for k, size in enumerate(further) if size > 0}
        return np.array([*found]), np.array([*found.values()])

    def late(self, columns: Columns) -> list[np.ndarray]:
        """What a late log changes, per second, commands and states apart, (intervals, 2 nv, up to two) a log."""
        at = [[i for i, key in enumerate(columns.keys) if key.effect == name] for name in LATE]
        return [
            np.stack([own[:, :, of].sum(axis=2) for of in at if of], axis=2) if any(at) else own[:, :, :0]
            for own in columns.values
        ]

    def other_simulations(self, intervals: Intervals, linearisation: Linearisation) -> list[np.ndarray]:
        """What finer steps, a late joint PD and other settings change: nuisances, (intervals, 2 nv, some) a log.

        An explicit simulation holds the torques of its PD for a step, which is as if this answered states half a step
        late: damping of kp times half a step that no robot has.
        """
        none = [np.zeros_like(own.close) for own in intervals.courses]
        pairs = zip(intervals.by_short_steps.with_close(none).predicted, intervals.predicted, strict=True)
        found = [[tangent_difference(a, b, self.robot)] for a, b in pairs]
        if self.robot.stands:
            sets = [[(*own, other) for own in intervals.acting] for other in self.otherwise]
            others = intervals.changes(sets, linearisation.transitions)
            for change in (late_feedback(intervals, linearisation), *others):
                for own, of_log in zip(found, change, strict=True):
                    own.append(of_log)
        return [np.stack(own, axis=2) for own in found]

    def errors(self, intervals: Intervals, basis: Basis) -> list[np.ndarray]:
        """Whitened errors at each level, (chunks, longest, channels, 1)."""
        chunks = Chunks.of(intervals)
        steps = chunks.stack(intervals.defects(basis.linearisation.transitions))[..., None]
        measured = chunks.stack(intervals.innovations())[..., None]
        return [own.whiten(steps, measured) for own in basis.filters]

    def followed(self, intervals: Intervals, basis: Basis, acting: Acting) -> Intervals:
        """The intervals of a robot with other effects, with references that follow the logs."""
        here = replace(intervals, acting=tuple(on_logs(intervals, acting)))
        offsets = here.remembered(basis.linearisation.transitions)
        return follow(here, Chunks.of(here), offsets, basis.linearisation).result

    def far(self, near: Point, looked: Sequence[str]) -> Iterator[tuple[list[tuple[Hypothesis, np.ndarray]], Whitened]]:
        """What further effects in the drives do far from nominal beside those of a point: numbers, and a column each.

        Such an effect does not grow with its number (a lag, a limit), but what it does to the torques is known at any.
        One after another they are replayed at all joints at once, by long steps, and shared out by the responses to
        torques. Several feet on the ground do not tell these apart: there the effects are replayed at some places.
        """
        present, forces = {h.name for h, _ in near.acting}, near.basis.linearisation.forces
        rough, chunks = rough_steps(near.intervals), Chunks.of(near.intervals)
        logs = [own.states.log.name for own in near.intervals.courses]
        of_logs = list(zip(on_logs(near.intervals, near.acting), logs, strict=True))
        for name, of_kind in self.kinds.items():
            if name in present or not in_drive(of_kind.kind) or len(of_kind.parameters) > 1:
                continue
            apart = of_kind.kind.along_joints and not self.robot.stands
            at = places(of_kind.kind, self.robot)
            replayed = [replace(of_kind, location=place) for place in (("all",) if apart else looked) if place in at]
            sets = [(h, numbers) for h in replayed for numbers in h.ladder]
            found: list[tuple[Hypothesis, np.ndarray]] = []
            columns: list[list[np.ndarray]] = []
            changes = rough.changes(
                [[(*own, h.on(log, numbers)) for own, log in of_logs] for h, numbers in sets],
                near.basis.linearisation.transitions,
            )
            for (h, numbers), change in zip(sets, changes, strict=True):
                if not apart:
                    found.append((h, numbers))
                    columns.append(change)
                    continue
                parts = [shared(own, of[:, :, self.robot.joint_dofs]) for own, of in zip(change, forces, strict=True)]
                for place, joints in at.items():
                    which = [self.robot.joints.index(joint) for joint in joints]
                    found.append((replace(h, location=place), numbers))
                    columns.append([own[:, :, which].sum(axis=2) for own in parts] if place != "all" else change)
            if not found:
                continue
            stacked = chunks.stack([np.stack([own[log] for own in columns], axis=2) for log in range(len(logs))])
            yield found, [-own.whiten(stacked) for own in near.basis.filters]

    def glances(self, near: Point, sets: Sequence[Acting], levels: np.ndarray | None = None) -> list[float]:
        """Evidence of robots with some effects at just these numbers, nats, without columns of their effects.

        They are followed side by side; each block at its best level, or, exactly, at ``levels`` if these are given.
        """
        if not sets:
            return []
        errors, basis = self.errors_of(near.intervals, near.basis, sets, levels is not None), near.basis
        cross = basis.blocks.products(errors, basis.of_nuisances)
        priors = basis.deviation, np.zeros(len(basis.deviation))

        def of_set(k: int) -> float:
            own = [of[..., k : k + 1] for of in errors]
            found = Evidence.of_error(basis.blocks, own, cross[:, :, k], basis.products)
            found = found.at_best_levels(*priors) if levels is None else replace(found, levels=levels)
            return found.posterior(*priors).evidence

        return near.intervals.each(range(len(sets)), of_set)

    def by_columns(self, near: Point, acting: Acting) -> Point:
        """The point of a robot with other effects or numbers, with the columns of its effects as they are near by."""
        here, basis = self.followed(near.intervals, near.basis, acting), near.basis
        return Point.of(acting, here, basis, self.errors(here, basis), basis.of_hypotheses([h for h, _ in acting]))

    def moved(self, intervals: Intervals, basis: Basis, acting: Acting) -> Point:
        """The point of a robot with other effects or numbers, with the columns of its effects made anew."""
        here = self.followed(intervals, basis, acting) if acting else intervals
        errors = self.errors(here, basis)
        if not acting:
            return Point.of((), here, basis, errors, [own[..., :0] for own in errors])
        sets: list[Acting] = []
        sizes = []
        for m, (h, numbers) in enumerate(acting):
            for k, size in enumerate(small_steps(h, numbers)):
                changed = numbers.copy()
                changed[k] += size
                sets.append((*acting[:m], (h, changed), *acting[m + 1 :]))
                sizes.append(size)
        if self.robot.stands:
            return Point.of(acting, here, basis, errors, self.by_following(here, basis, errors, sets, sizes))
        changes = here.changes([on_logs(here, own) for own in sets], basis.linearisation.transitions)
        slopes = [
            np.stack([change[log] / size for change, size in zip(changes, sizes, strict=True)], axis=2)
            for log in range(len(here.courses))
        ]
        stacked = Chunks.of(here).stack(slopes)
        return Point.of(acting, here, basis, errors, [-of.whiten(stacked) for of in basis.filters])

    def by_following(
        self, here: Intervals, basis: Basis, errors: Whitened, sets: Sequence[Acting], sizes: Sequence[float]
    ) -> Whitened:
        """Columns of sets in place of those that act, which depart in one number by a size each.

        By references that follow the logs anew: contacts of feet are far from linear in where these are.
        """
        return [(own - other) / sizes for own, other in zip(errors, self.errors_of(here, basis, sets), strict=True)]

    def errors_of(self, near: Intervals, basis: Basis, sets: Sequence[Acting], exactly: bool = True) -> Whitened:
        """Whitened errors of robots with other effects, one column each, by references that follow the logs.

        Those with models of equal structure are followed side by side, as if each had logs of its own; ``exactly`` as
        in ``missed_by``.
        """
        chunks = Chunks.of(near)
        alike: dict[Hashable, list[int]] = {}
        for k, own in enumerate(sets):
            structure = (Rollout(near.courses[0].states.log, effects).structure for effects in on_logs(near, own))
            alike.setdefault(tuple(structure), []).append(k)
        steps, measured = (
            np.zeros((len(chunks.log), chunks.longest, channels, len(sets)))
            for channels in (2 * self.robot.model.nv, len(near.channels.state_entries))
        )
        for at in alike.values():
            steps[..., at], measured[..., at] = self.missed_by(near, basis, [sets[k] for k in at], exactly)
        return [own.whiten(steps, measured) for own in basis.filters]

    def missed_by(
        self, near: Intervals, basis: Basis, sets: Sequence[Acting], exactly: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """What steps miss, and what is measured of the references, of each set, (chunks, longest, …, sets).

        ``exactly``: by replays without the force, beside those that follow the logs; else by these alone, less what the
        force does by its linearisation, which is enough to compare sets at a glance.
        """
        of, count = basis.linearisation, len(sets)
        acting = tuple(effects for own in sets for effects in on_logs(near, own))
        many = replace(near, courses=near.courses * count, acting=acting, residual=None)
        side = Linearisation(
            of.transitions * count, of.forces * count, of.missed * count, of.units, np.tile(of.gains, (count, 1, 1, 1))
        )
        chunks = Chunks.of(many)
        followed = follow(many, chunks, many.remembered(side.transitions), side)
        many = followed.result
        missed = many.defects(side.transitions) if exactly else followed.missed(side)
        steps, measured = (
            np.moveaxis(np.array(np.split(chunks.stack(own), count)), 0, -1) for own in (missed, many.innovations())
        )
        return steps, measured

    def with_feet_moved(self, basis: Basis, here: Intervals, acting: Acting) -> Basis:
        """The basis with columns of what moves feet, or the ground under them, by references that follow the logs."""
        at, sets, sizes = [], [], []
        for i, key in enumerate(basis.columns.keys):
            if key.effect not in self.of_feet:
                continue
            by_place = self.by_place(basis, acting, key.effect)
            h = replace(self.kinds[key.effect], location=key.place)
            numbers = by_place.pop(h, h.nominal)
            size = small_steps(h, numbers)[key.number]
            changed = numbers.copy()
            changed[key.number] += size
            at.append(i)
            sets.append((*(one for one in acting if one[0].name != key.effect), *by_place.items(), (h, changed)))
            sizes.append(size)
        if not at:
            return basis
        columns = self.by_following(here, basis, self.errors(here, basis), sets, sizes)
        whitened = [own.copy() for own in basis.whitened]
        for own, new in zip(whitened, columns, strict=True):
            own[..., at] = new
        return replace(basis, whitened=whitened)

    def by_place(self, basis: Basis, acting: Acting, effect: str) -> dict[Hypothesis, np.ndarray]:
        """An acting effect at every single place, with its numbers."""
        members = basis.columns.members
        return {
            replace(h, location=place): numbers
            for h, numbers in acting
            if h.name == effect
            for place in members[h.name, h.location]
        }


def on_logs(intervals: Intervals, acting: Acting) -> list[Effects]:
    """The simulation and the effects of a set on each log, as they are on the ground of the model."""
    logs = [own.states.log.name for own in intervals.courses]
    return [
        (*intervals.simulation, *(one for h, numbers in acting for one in h.on(log, numbers).on_model_ground()))
        for log in logs
    ]


def otherwise_integrated(robot: Robot, kd: np.ndarray, step_s: float) -> SimulationSettings | None:
    """The integrator by which a joint PD is computed once a step if the model's is implicit, and the other way round.

    None where the damping ``kd`` (joints,) is none, or such a step would take more than a joint's speed from it.
    """
    euler = int(mujoco.mjtIntegrator.mjINT_EULER)
    if robot.model.opt.integrator == euler:
        return SimulationSettings(integrator=int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)) if kd.any() else None
    is_stable = (kd * step_s < robot.model.dof_M0[robot.joint_dofs]).all()
    return SimulationSettings(integrator=euler) if kd.any() and is_stable else None


def meets_ground(kind: type[Effect]) -> bool:
    """Whether an effect moves feet against the ground, or changes their contact with it.

    A joint PD answers a wrong zero: what both do cancels but for the contacts.
    """
    is_answered = overrides(kind, "change_measured") and overrides(kind, "change_commands")
    return is_answered or kind.places == "feet" or kind.name in ("ground_slope", "leg_geometry")


def in_drive(kind: type[Effect]) -> bool:
    """Whether an effect acts between the commands and the torques of the motors, on nothing that is measured."""
    return not overrides(kind, "change_measured") and any(overrides(kind, method) for method in DRIVE)


def with_nuisances(own: Whitened, basis: Basis) -> Whitened:
    """Errors, nuisances and further columns, from errors and further columns."""
    pairs = zip(own, basis.of_nuisances, strict=True)
    return [np.concatenate([of[..., :1], nuisances, of[..., 1:]], axis=3) for of, nuisances in pairs]


def prior_of(h: Hypothesis) -> np.ndarray:
    """Standard deviations of the numbers of a hypothesis about nominal, before any log, (numbers,)."""
    lower, upper = h.bounds
    return np.asarray(
        np.maximum(PRIOR * np.abs(h.moderate), OF_RANGE * np.maximum(upper - h.nominal, h.nominal - lower))
    )


def small_steps(h: Hypothesis, numbers: np.ndarray) -> list[float]:
    """Departures by which numbers are differenced, within their ranges; of a factor at most a share of itself."""
    lower, upper = h.bounds
    most = [abs(n) if p.logarithmic else np.inf for p, n in zip(h.parameters, numbers, strict=True)]
    found = DIFFERENCE * np.clip(h.moderate, -np.array(most), most)
    inside = (lower <= numbers + found) & (numbers + found <= upper)
    return [float(size) for size in np.where(inside, found, -found)]
