"""The diagnosis from end to end: logs and a robot in, a report out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType

import numpy as np

from leapgap import effects
from leapgap.diagnosis.best_simulator import BestFit, BestSimulator, FitOfAll, by_columns, by_joint_fit
from leapgap.diagnosis.candidates import Candidate
from leapgap.diagnosis.checks import CheckResult, as_read, clock_of, run_checks
from leapgap.diagnosis.descriptions import judge_descriptions
from leapgap.diagnosis.engine.points import Bench
from leapgap.diagnosis.engine.search import Search, candidate_of
from leapgap.diagnosis.engine.verdict import Judgement, conclude, is_explained, without_pushes
from leapgap.diagnosis.evidence import gather
from leapgap.diagnosis.evidence.base import Evidence
from leapgap.diagnosis.gap import HeldOutGap, Interval
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.joint_fit import JointFit
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.localisation import localise
from leapgap.diagnosis.next_experiment import propose
from leapgap.diagnosis.outside_forces.search import OutsideForces, find_outside_forces, unexplained, without_moments
from leapgap.diagnosis.outside_forces.verdict import with_outside_forces
from leapgap.diagnosis.own_clock import OwnClock, closures_by_source, own_clock
from leapgap.diagnosis.report import Headline, Provenance, ReportContent
from leapgap.diagnosis.settings import Settings
from leapgap.diagnosis.short_rollouts import FINE, ShortRollouts, check_length
from leapgap.diagnosis.summary import causes_of, not_judged, sentence
from leapgap.effects.base import Effect, overrides
from leapgap.effects.model_field import effect_class
from leapgap.errors import InputError, did_you_mean
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.robot.motion import Motion
from leapgap.simulation.replay import Replayer

RECURRING = 3  # Number of forces from outside from which on all may not be alike


@dataclass(frozen=True)
class Diagnosis:
    """A report with the replays made for it."""

    report: ReportContent
    logs: tuple[Log, ...]  # The logs, by their own clock where that is another than they claim
    nominal: Mapping[str, Motion]  # Replay of each log by the nominal robot, all rows
    corrected: Mapping[str, Motion]  # Replay of each log with the answer as fitted without it
    correction: tuple[Effect, ...]  # The answer fitted on all logs; the median where values differ by log
    sensors: tuple[str, ...] = ()  # Columns of sensors beside the state that the replays hold
    fit: Candidate | None = None  # The answer's fit, whose covariance says how its numbers hang together


def diagnose(
    logs: Sequence[Log],
    robot: Robot,
    settings: Settings,
    provenance: Provenance | None = None,
    progress: Callable[[str], None] = lambda _: None,
    threads: int | None = None,
    own: Sequence[type[Effect]] = (),
    descriptions: Sequence[Robot] = (),
    set_aside: Mapping[str, str] = MappingProxyType({}),
) -> Diagnosis:
    """Find where the gap lies, which effects cause it, and how far it shrinks on logs not fitted on.

    ``provenance`` says which files the logs were read from; where it is None their content stands for them.
    ``own`` are a user's effect classes, looked for beside the known ones (or those of them that the settings name).
    ``descriptions`` are other models of the same robot, each judged as it is. ``threads`` (all cores, where it is None)
    change the time it takes and nothing else.
    ``set_aside`` are names and reasons of logs that were left out before, for the report.
    """
    own = (*own, *map(effect_class, settings.model_fields))
    kinds = chosen_kinds(settings, own)
    settings = replace(settings, tolerances=tolerances_on(robot, settings, own))
    rng = np.random.default_rng(settings.seed)
    ready = prepare(logs, robot, settings, threads, rng, progress)
    answer = find_answer(ready, kinds, settings, progress)
    if ready.clock is None:
        outside = pushes_beside(answer, ready, settings)
        if outside.logs:
            for force in outside.forces:
                progress(f"external force: {force.says}")
            ready = ready_logs(ready.given, ready.replayer, ready.checks, outside, settings, rng)
            answer = find_answer(ready, kinds, settings, progress)
        ready = replace(ready, outside=outside)
    progress("step 3 of 4, fit of all effects and map of the error")
    best = best_simulator(answer, settings, progress) if settings.best else None
    heldout_gap, judgement, clock = answer.heldout_gap, answer.judgement, ready.clock
    conclusion, selected, names = judgement.conclusion, judgement.selected, heldout_gap.names
    forces = unexplained(ready.outside.forces, ready.given, ready.replayer, selected.typical_effects(names))
    outside = replace(ready.outside, forces=forces)
    (replays,), (corrected,) = heldout_gap.replays([selected]), heldout_gap.figures([selected])
    judged_fits = heldout_gap.figures([*conclusion.steps, *(fit for fit, _ in judgement.others)])
    shared = heldout_gap.shared_closure(selected) if conclusion.answer and clock is None else None
    # Short steps: what the nominal simulation's own step does is no part of the gap.
    fine = ready.replayer.with_steps(FINE * ready.replayer.largest_step_s)
    # The map is of all rows: a force from outside is part of the gap, though nothing is fitted to its rows.
    mapped = ready.given if ready.outside.logs else ready.judged
    draws = settings.noise_draws_of(sum(mapped.rows))
    places = localise(mapped, fine, settings.where_horizon_s, draws, rng)
    judged, gap = ready.judged, heldout_gap.gap(heldout_gap.before)
    floor = heldout_gap.gap(heldout_gap.floor)
    report = ReportContent(
        verdict=conclusion.verdict,
        sentence=sentence(conclusion, selected, gap, floor, corrected, names),
        gap_nominal=gap,
        gap_corrected=corrected.gap,
        noise_floor=floor,
        headline=Headline(
            judged.preset, {channel.name: channel.scale for channel in judged.channels}, heldout_gap.horizon_s
        ),
        horizons=heldout_gap.errors_at_horizons(selected),
        answer=conclusion.answer,
        closure_of_answer=corrected.closure if conclusion.answer else None,
        closure_shared=shared,
        closures_by_source=answer.by_source,
        where=tuple(places),
        causes=tuple(causes_of(judgement, judged_fits, names, settings.model_error)),
        checks=tuple(ready.checks),
        evidence=tuple(answer.evidence),
        descriptions=tuple(judge_descriptions(descriptions, heldout_gap)),
        next_experiment=propose(judgement.undecided, judged, ready.replayer, settings, progress),
        not_judged=(*not_judged(judged), *(f.explained for f in ready.outside.forces if f not in forces)),
        evidence_numbers=judgement.numbers,
        residual_force=judgement.residual,
        gap_per_log=heldout_gap.gap_by_log(corrected.squares),
        landing_misplaced_m=heldout_gap.misplaced_by_log(replays),
        provenance=provenance or Provenance.of(logs, robot, asdict(settings)),
        set_aside=dict(set_aside),
        notes=judgement.notes,
        best_simulator=best,
    )
    return Diagnosis(
        with_outside_forces(report, outside, ready.given, heldout_gap, corrected),
        tuple(states.log for states in judged.whole),
        nominal=dict(zip(names, heldout_gap.nominal_motions, strict=True)),
        corrected=dict(zip(names, replays, strict=True)),
        correction=selected.typical_effects(names),
        sensors=judged.sensors.columns,
        fit=selected,
    )


@dataclass(frozen=True)
class ReadyLogs:
    """Logs that are ready for the search: checked, by their own clock, without what acts from outside."""

    given: JudgedLogs  # All rows, as the logs claim
    judged: JudgedLogs
    replayer: Replayer
    heldout_gap: HeldOutGap
    checks: Sequence[CheckResult]
    outside: OutsideForces
    clock: OwnClock | None = None


def prepare(
    logs: Sequence[Log],
    robot: Robot,
    settings: Settings,
    threads: int | None,
    rng: np.random.Generator,
    progress: Callable[[str], None],
) -> ReadyLogs:
    """Check the logs, and measure the gap of the nominal robot.

    By a clock of their own, rows are not known well enough to tell accelerations of a push; else pushes are told beside
    the answer.
    """
    slots = max((len(log.info.terrain) for log in logs), default=0)
    given = JudgedLogs.of(logs, robot, settings.sizes)
    check_length(given.logs, max(settings.horizon_s, settings.where_horizon_s))
    progress(f"step 1 of 4, checks and nominal replays: {len(logs)} logs, {sum(given.rows)} samples")
    checks = run_checks(given.logs, robot, settings.check_thresholds, logs)
    if any(check.reads is not None for check in checks):
        given = JudgedLogs.of(as_read(logs, checks), robot, settings.sizes)
    replayer = Replayer(robot, max(1, slots), threads, sensors=given.sensors.columns)
    clock = own_clock(given, checks, settings.sizes)
    ready = ready_logs(given, replayer, checks, OutsideForces(), settings, rng)
    if clock is not None:
        draws = settings.noise_draws_of(sum(given.rows))
        gap = ready.heldout_gap.by_own_clock(clock.judged, draws, rng)
        ready = replace(ready, judged=clock.judged, heldout_gap=gap, clock=clock)
        progress(f"with corrected time stamps: gap {gap.gap(gap.nominal):.3f}")
    return ready


def ready_logs(
    given: JudgedLogs,
    replayer: Replayer,
    checks: Sequence[CheckResult],
    outside: OutsideForces,
    settings: Settings,
    rng: np.random.Generator,
) -> ReadyLogs:
    """The logs, without the moments in which something acts from outside, with the gap of the nominal robot."""
    judged = given
    if outside.logs:
        judged = JudgedLogs.of(outside.logs, given.robot, settings.sizes)
        again = {
            one.name: one for one in run_checks(judged.logs, judged.robot, settings.check_thresholds, outside.logs)
        }
        checks = [one if one.reads is not None else again.get(one.name, one) for one in checks]
    draws = settings.noise_draws_of(sum(judged.rows))
    gap = HeldOutGap.of(judged, replayer, settings.folds, draws, settings.bootstrap_draws, rng)
    return ReadyLogs(given, judged, replayer, gap, checks, outside)


def pushes_beside(answer: "FoundAnswer", ready: ReadyLogs, settings: Settings) -> OutsideForces:
    """What acts from outside in single logs on the robot with its answer as well.

    A push is told where nothing without a name acts but in the moments of pushes. Several that are all at one joint in
    one direction are of the robot, which lacks something there, and not of its surroundings.
    """
    found = find_outside_forces(ready.judged, ready.replayer, settings.outside)
    effects = answer.judgement.selected.typical_effects(answer.heldout_gap.names)
    forces = unexplained(found, ready.given, ready.replayer, effects)
    alike = {(one.at, one.axis, one.impulse > 0) for one in forces}
    of_the_robot = len(forces) >= RECURRING and len(alike) == 1
    if not forces or of_the_robot or not is_explained(without_pushes(answer.judgement.moments, forces)):
        return OutsideForces()
    return without_moments(forces, ready.judged, settings.outside)


@dataclass(frozen=True)
class FoundAnswer:
    """The search for causes with its conclusion."""

    judgement: Judgement
    heldout_gap: HeldOutGap  # At the horizon at which the answer is judged
    evidence: Sequence[Evidence]  # What the logs say without a simulation
    of_all: Callable[[], Sequence[FitOfAll]]  # Makes fits of all effects beside the answer
    by_source: Mapping[str, Interval] = field(default_factory=dict)  # As in ``ReportContent``


def find_answer(
    ready: ReadyLogs, kinds: Sequence[type[Effect]], settings: Settings, progress: Callable[[str], None]
) -> FoundAnswer:
    """The answer by evidence; of logs by their own clock, by a fit of all effects together."""
    find = answer_by_evidence if ready.clock is None else answer_by_own_clock
    return find(ready, kinds, settings, progress)


def answer_by_own_clock(
    ready: ReadyLogs, kinds: Sequence[type[Effect]], settings: Settings, progress: Callable[[str], None]
) -> FoundAnswer:
    """The answer of a joint fit of all effects, with the clock of the logs before it.

    Where the clock is the only effect that is looked for, there is nothing to fit.
    """
    judged, clock = ready.judged, ready.clock
    assert clock is not None
    # The clock is no hypothesis then, and some effects show beside it alone.
    further = [] if settings.effects else [kind for kind in effects.known().values() if kind.beside_clock]
    looked = [one for one in (*kinds, *further) if not one.differs_per_log and one.name not in settings.without]
    hypotheses = list_hypotheses(looked, judged.robot, None)
    evidence = gather([states.log for states in judged.whole], judged.robot)
    progress(f"step 2 of 4, search: {len(hypotheses)} hypotheses (an effect at a location)")
    joint = JointFit(ready.heldout_gap, pieces_of(ready, settings), evidence, settings.joint, progress)
    steps: tuple[Candidate, ...] = ()
    sure: tuple[float, ...] = ()
    if hypotheses:
        near = joint.by_pieces(hypotheses)
        joint = replace(joint, heldout_gap=at_stable_horizon(ready, near, settings))
        steps, sure = joint.search(near)
    by_source = closures_by_source(joint, steps[-1]) if steps else {}
    judgement = clock.conclude(joint, steps, sure)
    return FoundAnswer(judgement, joint.heldout_gap, evidence, lambda: by_joint_fit(joint), by_source)


def answer_by_evidence(
    ready: ReadyLogs, kinds: Sequence[type[Effect]], settings: Settings, progress: Callable[[str], None]
) -> FoundAnswer:
    """The answer of the engine: one evidence of all sets of effects, and of a force without a name beside them."""
    judged = ready.judged
    hypotheses = list_hypotheses(kinds_by_evidence(kinds, settings), judged.robot, clock_of(ready.checks))
    bench = Bench(hypotheses, settings.tolerances, judged.states, ready.replayer)
    whole_logs = None if judged.robot.stands else ready.heldout_gap
    search = Search(bench, ready.heldout_gap.folds, progress, gap=whole_logs)
    progress(f"step 2 of 4, search: {len(hypotheses)} hypotheses (an effect at a location)")
    start, found = search.explore()
    gap = at_stable_horizon(ready, candidate_of(found), settings)
    judgement = conclude(search, start, found, gap)
    contacts = [
        f"contacts by {one.in_words} fit these logs better than the model's own; causes were looked for beside them"
        for one in found.simulation
    ]
    judgement = replace(judgement, notes=(*judgement.notes, *contacts))
    evidence = gather([states.log for states in judged.whole], judged.robot)
    usual = {kind.called(judged.robot) for kind in kinds}
    return FoundAnswer(judgement, gap, evidence, lambda: by_columns(search, found, usual))


def at_stable_horizon(ready: ReadyLogs, found: Candidate, settings: Settings) -> HeldOutGap:
    """The gap at the longest horizon at which a right answer would show to be right."""
    draws, rng = settings.noise_draws_of(sum(ready.judged.rows)), np.random.default_rng(settings.seed)
    return ready.heldout_gap.at_stable_horizon(found, draws, rng)


def pieces_of(ready: ReadyLogs, settings: Settings) -> ShortRollouts:
    """Short pieces of the logs, whose errors are whitened for the nominal robot."""
    most = settings.pieces(len(ready.given.logs))
    pieces = ShortRollouts.of(ready.judged.states, ready.replayer, settings.horizon_s, settings.every_s, most)
    return pieces.whiten_for(pieces.on_every_log(()))


def best_simulator(answer: FoundAnswer, settings: Settings, progress: Callable[[str], None]) -> BestSimulator:
    """The best of an answer and of fits of all effects; none is made of a simulation that agrees with the logs."""
    judgement = answer.judgement
    fit = BestFit(answer.heldout_gap, judgement.selected, settings.model_error, progress)
    return fit.best(answer.of_all if judgement.conclusion.verdict != "none" else list)


def kinds_by_evidence(kinds: Sequence[type[Effect]], settings: Settings) -> list[type[Effect]]:
    """The chosen effects, and all that a robot can have, where the settings name none."""
    if settings.effects:
        return list(kinds)
    known = (kind for kind in effects.known().values() if kind.name not in settings.without)
    return list(dict.fromkeys([*kinds, *(kind for kind in known if not overrides(kind, "change_step"))]))


def chosen_kinds(settings: Settings, own: Sequence[type[Effect]] = ()) -> list[type[Effect]]:
    """The effects to look for, a user's own classes among them; a name that is none is an ``InputError``."""
    kinds = effects.registry(own)
    for key, named in (("effects", settings.effects), ("without", settings.without)):
        unknown = [name for name in named if name not in kinds]
        if unknown:
            nearest = (did_you_mean(name, kinds) for name in unknown)
            do = " ".join(filter(None, nearest)) or "list the names: leapgap effects"
            raise InputError(key, ", ".join(unknown), "names that 'leapgap effects' lists", do)
    names = [*(settings.effects or effects.by_default()), *(kind.name for kind in own)]
    without = {kinds[name] for name in settings.without}
    found = [kind for kind in dict.fromkeys(kinds[name] for name in names) if kind not in without]
    if not found:
        raise InputError("without", "every effect", "some that are searched", "leave out fewer")
    return found


def tolerances_on(robot: Robot, settings: Settings, own: Sequence[type[Effect]] = ()) -> dict[str, float]:
    """Tolerances by the names that effects have on a robot; ``InputError`` for one that names no parameter of one."""
    kinds, found = effects.registry(own), {}
    for name, share in settings.tolerances.items():
        effect, _, parameter = name.partition(".")
        if effect not in kinds or parameter not in kinds[effect].declarations():
            expected = "<effect>.<parameter>, such as armature.inertia"
            raise InputError("settings.tolerances", name, expected, "correct the name")
        found[f"{kinds[effect].called(robot)}.{parameter}"] = share
    return found
