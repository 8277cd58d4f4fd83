"""Whether a robot with nothing wrong explains logs: the one that is simulated by other steps, integrator or contacts.

Two simulations of one robot never agree: a step, an integrator, a friction cone or the impedance of a contact moves
a jump at the edge of slipping by more than many causes do. Where causes leave doubt, the logs are replayed by the
nominal robot with other settings of the simulation. If one of them closes the gap of whole logs down to noise, and logs
of just that robot would look as odd in short replays as the given ones do, nothing is wrong with the robot.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import mujoco
import numpy as np

from leapgap.diagnosis.candidates import Candidate, SearchResult
from leapgap.diagnosis.channels import displaced
from leapgap.diagnosis.decision import Conclusion, Judgement, OtherSimulationExplains, explained_share
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.gap import HeldOutGap
from leapgap.diagnosis.robust_least_squares import Products
from leapgap.diagnosis.sensitivities import concatenate_logs
from leapgap.diagnosis.short_rollouts import Pieces, ShortRollouts, smooth_starts
from leapgap.diagnosis.simulation_settings import SimulationSettings
from leapgap.effects.base import Effect
from leapgap.effects.contacts import FootCompliance
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion

INTEGRATOR, CONE = mujoco.mjtIntegrator, mujoco.mjtCone
MOST_CHANGES = 3
"""Largest number of settings of contacts that are changed together."""
LESS = 0.9
"""A further change of a setting has to bring the gap below this share of it."""
HOPEFUL = 2
"""Number of changes that are tried beside short steps where none by itself brings the gap down."""
TRIED = 4
"""Number of other simulations whose logs are made up and compared, those of the fewest changes."""
DRAWS = 2
"""Number of times that their sensor noise is drawn."""
HARDLY = 0.2
"""Causes that explain a smaller share of what noise leaves are no reason against another simulation."""
TIMES = 3.0
"""A cause is no better than another simulation while it gains at most so many times as much in that one's logs."""


@dataclass(frozen=True)
class Change:
    """One change of the simulation's settings, in words."""

    words: str
    settings: Mapping[str, Any]


SHORT_STEPS = "a quarter of the time step"
INTEGRATORS = (Change("Euler's integrator", {"integrator": int(INTEGRATOR.mjINT_EULER)}),)
"""Tried by steps of the usual length, at which integrators differ most."""
FINE_INTEGRATORS = (Change("the discrete integrator", {"integrator": int(INTEGRATOR.mjINT_DISCRETE)}),)
"""Tried by short steps: in the limit of which it still differs from the others."""
OTHER_CONE = Change("the other friction cone", {"other_cone": True})
CONTACTS = (
    OTHER_CONE,
    Change("a tenth of the friction's impedance", {"friction_impedance": 0.1}),
    Change("a harder impedance of contacts", {"slack": 0.4, "width": 0.5}),
    Change("a softer impedance of contacts", {"slack": 1.5, "width": 2.0}),
    Change("contacts that act in 0.4 of the time", {"contact_time": 0.4}),
)


@dataclass(frozen=True)
class OtherSimulation:
    """Another simulation of the nominal robot."""

    changes: tuple[Change, ...] = ()
    by_short_steps: bool = False
    gap: float = np.inf
    """Headline gap of whole logs in replays by it."""
    squares: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Their sums of squares, (logs,)."""
    settings: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Its settings in the form in which replays take them."""
        return (SimulationSettings(**self.settings),) if self.changes else ()

    @property
    def words(self) -> list[str]:
        """What it has else than the given one, one change after the other."""
        return [*([SHORT_STEPS] if self.by_short_steps else []), *(change.words for change in self.changes)]

    def further(self, change: Change) -> "OtherSimulation":
        """The same with one change more; its gap is not known yet."""
        return OtherSimulation(
            (*self.changes, change), self.by_short_steps, settings={**self.settings, **change.settings}
        )

    def allows(self, change: Change) -> bool:
        """Whether a change is of settings that are not changed yet."""
        return not set(change.settings) & set(self.settings)


def runs(robot: Robot, change: Change) -> bool:
    """Whether MuJoCo simulates a robot with a change; no integrator is for every model."""
    model = copy.copy(robot.model)
    SimulationSettings(**change.settings).change_model(model, robot)
    try:
        mujoco.mj_step(model, mujoco.MjData(model))
    except mujoco.FatalError:
        return False
    return True


def judge_other_simulations(
    judgement: Judgement,
    heldout_gap: HeldOutGap,
    thresholds: DecisionThresholds,
    least_gain: float,
    seed: int,
    progress: Callable[[str], None],
) -> Judgement:
    """The judgement, or that nothing is wrong (``none``) where another simulation of the robot explains the logs.

    ``least_gain`` is what a cause gains in logs without any gap.
    """
    if not is_in_doubt(judgement, heldout_gap, thresholds):
        return judgement
    others = OtherSimulations(judgement.result, heldout_gap, thresholds, least_gain, np.random.default_rng(seed))
    found = others.find()
    if found is None:
        return judgement
    progress(f"nothing wrong: by {' and '.join(found.words)} the gap is {found.gap:.3f}")
    explains = OtherSimulationExplains(tuple(found.words), found.gap, found.squares)
    return replace(judgement, conclusion=Conclusion("none", (), other_simulation=explains))


def is_in_doubt(judgement: Judgement, heldout_gap: HeldOutGap, thresholds: DecisionThresholds) -> bool:
    """Whether another simulation may explain the logs as well as the judgement does.

    Not where causes close as much of a clear gap as suffices, nor where a check of the logs or the compliance of feet
    alone, which is a setting of contacts itself, is the cause.
    """
    selected, found = judgement.result.selected, judgement.conclusion
    if found.verdict == "none" or heldout_gap.claimed is not None or judgement.result.short is None:
        return False
    if any(hypothesis.per_log is not None for hypothesis in selected.hypotheses):
        return False
    if {hypothesis.kind for hypothesis in selected.hypotheses} == {FootCompliance}:
        return False
    is_clear = heldout_gap.gap(heldout_gap.nominal) > thresholds.none_gap * heldout_gap.gap(heldout_gap.floor)
    closes = heldout_gap.closure_value(*heldout_gap.squares([judgement.selected])) if found.steps else 0.0
    return not (is_clear and closes >= thresholds.enough_closure)


@dataclass(frozen=True)
class OtherSimulations:
    """The search for another simulation of the nominal robot that explains the logs."""

    result: SearchResult
    heldout_gap: HeldOutGap
    thresholds: DecisionThresholds
    least_gain: float
    rng: np.random.Generator

    def find(self) -> OtherSimulation | None:
        """The one of the fewest changes that explains the logs, of the smallest gap; None where none does."""
        most = self.thresholds.none_gap * self.heldout_gap.gap(self.heldout_gap.floor)
        within = sorted(
            (one for one in self.candidates() if one.gap <= most), key=lambda one: (len(one.words), one.gap)
        )
        return next((one for one in within[:TRIED] if self.explains_pieces(one)), None)

    def candidates(self) -> list[OtherSimulation]:
        """Other simulations with their gaps: by steps, integrator and cone, and by contacts changed one by one."""
        usual, own = OtherSimulation(), self.heldout_gap
        robot, fine = own.judged.robot, own.by_short_steps
        short = OtherSimulation(by_short_steps=True, gap=fine.gap(fine.nominal), squares=fine.nominal)
        beside = [*(one for one in FINE_INTEGRATORS if runs(robot, one)), *((OTHER_CONE,) if robot.feet else ())]
        by_short = [short.further(change) for change in beside]
        found = [short, *self.with_gaps(by_short, fine)]
        best = replace(usual, gap=own.gap(own.nominal))
        changes = [*(one for one in INTEGRATORS if runs(robot, one)), *(CONTACTS if robot.feet else ())]
        for _ in range(MOST_CHANGES):
            tried = self.with_gaps([best.further(change) for change in changes if best.allows(change)], own)
            tried.sort(key=lambda one: one.gap)
            if not tried or tried[0].gap > LESS * best.gap:
                break
            best = tried[0]
            found.append(best)
        if best.changes:
            return [*found, *self.with_gaps([replace(best, by_short_steps=True)], fine)]
        least = min(found, key=lambda one: one.gap)
        hopeful = [change for one in tried[:HOPEFUL] for change in one.changes if least.allows(change)]
        return [*found, *self.with_gaps([least.further(change) for change in hopeful], fine)]

    def with_gaps(self, tried: Sequence[OtherSimulation], heldout_gap: HeldOutGap) -> list[OtherSimulation]:
        """The same with the gap that each has in whole logs, by the steps of ``heldout_gap``."""
        logs = len(heldout_gap.judged.logs)
        squares = heldout_gap.squares_with([[one.effects] * logs for one in tried])
        return [replace(one, gap=heldout_gap.gap(of), squares=of) for one, of in zip(tried, squares, strict=True)]

    def explains_pieces(self, other: OtherSimulation) -> bool:
        """Whether logs of the other simulation look as odd in short replays as the given logs.

        As much of χ² is left, and the selected causes, which it has not, explain hardly anything or gain about as much.
        Motions that start anew cannot stand for logs: beside them only logs are explained that leave nothing in short
        replays.
        """
        nominal, selected = self.result.nominal, self.result.selected
        chi2 = float(np.median(nominal.chi2))
        if not selected.hypotheses and chi2 <= self.thresholds.none_below:
            return True
        if self.heldout_gap.horizon_s is not None:
            return False
        motions = self.motions(other)
        left, gains = zip(*(self.in_made_up_logs(motions) for _ in range(DRAWS)), strict=True)
        if chi2 > self.thresholds.none_below * max(1.0, float(np.mean(left))):
            return False
        if explained_share(self.result, self.thresholds) < HARDLY:
            return True
        gain = float((nominal.heldout - selected.heldout).sum())
        return gain <= self.least_gain + TIMES * max(0.0, float(np.mean(gains)))

    def in_made_up_logs(self, motions: Sequence[Motion]) -> tuple[float, float]:
        """Median of χ² over its expectation that the nominal robot leaves in made-up logs, and what the causes gain."""
        short, selected = self.result.short, self.result.selected
        assert short is not None
        noisy = (self.measured(own, motion, short) for own, motion in zip(short.pieces, motions, strict=True))
        made_up = replace(short, pieces=tuple(noisy))
        sets: list[Candidate] = [self.result.nominal, *([selected] if selected.hypotheses else [])]
        of_sets = made_up.residuals([[one.effects_on(own.log.name, None) for own in short.pieces] for one in sets])
        chi2, losses = zip(*(self.after_tolerances(concatenate_logs(of)) for of in of_sets), strict=True)
        return float(np.median(chi2[0])), losses[0] - losses[-1]

    def after_tolerances(self, errors: np.ndarray) -> tuple[np.ndarray, float]:
        """χ² of pieces over its expectation, (pieces,), and loss, of whitened errors (pieces, values)."""
        products = Products.of(np.concatenate([errors[:, :, None], self.result.nuisances], axis=2))
        prior = np.ones(self.result.nuisances.shape[2])
        weights = products.fit(prior, np.ones(len(errors), bool))
        return products.chi2(weights) / products.values, float(products.loss(weights).sum())

    def motions(self, other: OtherSimulation) -> list[Motion]:
        """The motion of each log as the other simulation has it, without noise."""
        gap = self.heldout_gap.by_short_steps if other.by_short_steps else self.heldout_gap
        judged = gap.judged
        return list(gap.replayer.motions(judged.trials([other.effects] * len(judged.logs))))

    def measured(self, own: Pieces, motion: Motion, short: ShortRollouts) -> Pieces:
        """The pieces of one log with a motion in place of the logged one, and new noise in all channels."""
        robot, entries = short.state.robot, short.state.state_entries
        by = np.zeros((len(motion), 2 * robot.model.nv))
        by[:, entries] = own.noise[: len(entries)] * self.rng.standard_normal((len(motion), len(entries)))
        noisy = displaced(motion, by, robot)
        if noisy.sensors is not None:
            of_sensors = own.noise[len(entries) :]
            sensors = noisy.sensors + of_sensors * self.rng.standard_normal(noisy.sensors.shape)
            noisy = replace(noisy, sensors=sensors)
        starts, kept = smooth_starts(noisy, own.starts.rows, own.log, robot)
        return replace(own, logged=noisy, starts=starts, start_noise=kept)
