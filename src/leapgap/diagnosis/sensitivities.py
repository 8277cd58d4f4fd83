"""Sensitivities of the whitened errors to effects: one column for each parameter and single place.

Columns are secants from the nominal robot to an effect of moderate size; those of a pair, a joint group or all joints
are sums of the single ones. Some also serve as nuisances: parameters that the model has only within a tolerance.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from leapgap import effects
from leapgap.diagnosis.hypotheses import Hypothesis, places, usable
from leapgap.diagnosis.robust_least_squares import Products
from leapgap.diagnosis.short_rollouts import FINE, ROUGH, ShortRollouts
from leapgap.effects.base import Effect
from leapgap.robot.model import Robot


@dataclass(frozen=True)
class ColumnKey:
    """Key of a column: an effect's parameter at a single place."""

    effect: str
    number: int
    place: str


Acting = Sequence[tuple[Hypothesis, np.ndarray]]
"""Hypotheses with their numbers."""


@dataclass(frozen=True)
class Departures:
    """Changes of the whitened errors by hypotheses."""

    evidence: ShortRollouts
    around: Acting
    start: np.ndarray
    """Whitened errors without further hypotheses, (pieces, values)."""

    @staticmethod
    def of(evidence: ShortRollouts, around: Acting) -> "Departures":
        """Departures from a robot with the hypotheses ``around``."""
        (start,) = evidence.residuals([on_logs(evidence, *around)])
        return Departures(evidence, around, concatenate_logs(start))

    def __call__(self, further: Sequence[Acting]) -> list[np.ndarray]:
        """Whitened changes of sets of further hypotheses, (pieces, values) each."""
        found = self.evidence.residuals([on_logs(self.evidence, *self.around, *one) for one in further])
        return [concatenate_logs(of) - self.start for of in found]


@dataclass(frozen=True)
class Sensitivities:
    """Columns of all effects and nuisances, in pieces of all logs in order."""

    evidence: ShortRollouts
    departures: Departures
    """Departures by long steps of the simulation; twice as fast, and the error of the step cancels in differences."""
    nominal: np.ndarray
    """Whitened errors of the nominal robot, (pieces, values)."""
    keys: tuple[ColumnKey, ...]
    columns: np.ndarray
    """Derivatives by each key's parameter, (pieces, values, keys)."""
    nuisances: np.ndarray
    """Changes by one standard deviation of each nuisance, (pieces, values, nuisances)."""
    members: Mapping[tuple[str, str], tuple[str, ...]]
    """Single places of each (effect, location)."""

    @staticmethod
    def of(
        evidence: ShortRollouts,
        hypotheses: Sequence[Hypothesis],
        tolerances: Mapping[str, float],
        around: Acting = (),
    ) -> "Sensitivities":
        """Roll out every effect of the hypotheses, and every effect with a tolerance, once at every single place.

        All of them act on top of ``around``, whose effects are not tried again. Tolerances are shares of the model's
        own numbers at each place (``Settings.tolerances``).
        """
        robot, kinds = evidence.state.robot, effects.registry(h.kind for h in hypotheses)
        present = {h.name for h, _ in around}
        names = {h.name: h for h in hypotheses if h.name not in present}
        for name in tolerances:
            effect = name.partition(".")[0]
            acts = effect not in present or keeps_tolerance(kinds[effect], robot)
            if effect not in names and acts and usable(kinds[effect], robot):
                names[effect] = Hypothesis(kinds[effect], robot)
        members = {(name, at): of for name, h in names.items() for at, of in places(h.kind, robot).items()}
        keys = tuple(
            ColumnKey(name, k, place)
            for name, h in names.items()
            for k in range(len(h.parameters))
            for place in members[name, "all"]
        )
        evidence = evidence.whiten_for(on_logs(evidence, *around))
        exact = Departures.of(evidence, around)
        rough = Departures.of(evidence.with_steps(ROUGH * evidence.replayer.largest_step_s), around)
        origin, free = exact.start, {name.partition(".")[0] for name in tolerances}
        columns = np.zeros((*origin.shape, len(keys)))
        for departures, chosen in (
            (exact, [i for i, key in enumerate(keys) if key.effect in free]),
            (rough, [i for i, key in enumerate(keys) if key.effect not in free]),
        ):
            changes = departures([[moderate_departure(names[keys[i].effect], keys[i])] for i in chosen])
            for i, change in zip(chosen, changes, strict=True):
                columns[:, :, i] = change / at_place(names[keys[i].effect], keys[i]).moderate[keys[i].number]
        fine = evidence.with_steps(FINE * evidence.replayer.largest_step_s)
        (stepped,) = fine.residuals([on_logs(evidence, *around)])
        acts_on_step = any(
            h.kind.change_step is not Effect.change_step for h in (*names.values(), *(h for h, _ in around))
        )
        nuisances = [] if acts_on_step else [concatenate_logs(stepped) - origin]
        for name, share in tolerances.items():
            effect, _, parameter = name.partition(".")
            if effect not in names:
                continue
            which = [p.name for p in names[effect].effect_parameters].index(parameter)
            nuisances += [
                tolerance(kinds[effect], robot, key.place, parameter, share) * columns[:, :, i]
                for i, key in enumerate(keys)
                if (key.effect, key.number) == (effect, which)
            ]
        nominal = origin if not around else concatenate_logs(evidence.residuals([evidence.on_every_log(())])[0])
        stacked = np.stack(nuisances, axis=2) if nuisances else np.zeros((*origin.shape, 0))
        return Sensitivities(evidence, rough, nominal, keys, columns, stacked, members)

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects that have columns and do not act already."""
        return frozenset(key.effect for key in self.keys) - {h.name for h, _ in self.departures.around}

    def with_nuisances(self, columns: np.ndarray) -> Products:
        """Inner products of columns (pieces, values, columns) and the nuisances."""
        return Products.of(np.concatenate([columns, self.nuisances], axis=2))

    def with_hypotheses(self, columns: np.ndarray, hypotheses: Sequence[Hypothesis]) -> Iterator[Products]:
        """Inner products of columns, the columns of one hypothesis, and the nuisances; one for each hypothesis."""
        first, number = columns.shape[2], len(self.keys)
        whole = Products.of(np.concatenate([columns, self.columns, self.nuisances], axis=2))
        every = np.arange(whole.gram.shape[1])
        fixed = np.concatenate([every[:first], every[first + number :]])
        outer = whole.gram[:, fixed[:, None], fixed]
        for h in hypotheses:
            summed = [[first + i for i in self.at(h, k)] for k in range(len(h.parameters))]
            cross = np.stack([whole.gram[:, rows].sum(axis=1) for rows in summed], axis=1)
            inner = np.stack([cross[:, :, rows].sum(axis=2) for rows in summed], axis=2)
            top = np.concatenate([outer, cross[:, :, fixed].transpose(0, 2, 1)], axis=2)
            bottom = np.concatenate([cross[:, :, fixed], inner], axis=2)
            order = np.concatenate([every[:first], len(fixed) + np.arange(len(summed)), np.arange(first, len(fixed))])
            gram = np.concatenate([top, bottom], axis=1)[:, order[:, None], order]
            yield Products(gram, whole.values)

    def at(self, hypothesis: Hypothesis, number: int) -> list[int]:
        """Indices of the columns whose sum is the derivative by a number of a hypothesis."""
        places = self.members[hypothesis.name, hypothesis.location]
        return [
            i
            for i, key in enumerate(self.keys)
            if (key.effect, key.number) == (hypothesis.name, number) and key.place in places
        ]


def keeps_tolerance(kind: type[Effect], robot: Robot) -> bool:
    """Whether what each place is off by stays in question where an effect of that kind acts.

    One number for all joints leaves what each of them is off by. It does so where none of the effect's numbers stands
    in place of the model's, and on held robots alone: in short pieces of jumps it would hide what acts slowly.
    """
    return not robot.has_free_base and all(own.nominal is not None for own in kind.declarations().values())


def tolerance(kind: type[Effect], robot: Robot, place: str, parameter: str, share: float) -> float:
    """Standard deviation of an effect's parameter at a place, in its unit: a share of the model's own value there."""
    (scale,) = (p.scale for p in kind.parameters(robot, place) if p.name == parameter)
    return share * scale


def at_place(hypothesis: Hypothesis, key: ColumnKey) -> Hypothesis:
    """The hypothesis at the single place of a key, whose nominal numbers may differ from those of all places."""
    return replace(hypothesis, location=key.place)


def moderate_departure(hypothesis: Hypothesis, key: ColumnKey) -> tuple[Hypothesis, np.ndarray]:
    """The hypothesis at the place of a key, with one number at moderate size."""
    there = at_place(hypothesis, key)
    numbers = there.nominal
    numbers[key.number] += there.moderate[key.number]
    return there, numbers


def on_logs(evidence: ShortRollouts, *acting: tuple[Hypothesis, np.ndarray]) -> list[tuple[Effect, ...]]:
    """Effects of hypotheses with their numbers, one tuple for each log."""
    return [tuple(h.on(p.log.name, numbers) for h, numbers in acting) for p in evidence.pieces]


def concatenate_logs(of_logs: Sequence[np.ndarray]) -> np.ndarray:
    """Concatenate the pieces of all logs, (pieces, values)."""
    return np.concatenate(of_logs)
