"""The next experiment: the one that would tell apart what these logs cannot, by forecasts of what each would show."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby
from operator import attrgetter
from statistics import NormalDist
from typing import Any

import numpy as np

from leapgap.diagnosis.candidates import Undecided
from leapgap.diagnosis.experiment_forecast import Forecast, Forecaster, Separation
from leapgap.diagnosis.experiment_plans import Given
from leapgap.diagnosis.experiments import REPEATS, Experiment, candidates_for, other_jumps, repetition
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.settings import Settings
from leapgap.simulation.replay import Replayer

ENOUGH = 60.0  # Loss of log likelihood of the best rival that tells it apart: what a diagnosis asks of a further cause
MOST_REPEATS, LEAST_TIMES = 6, 1.5
"""How many times an experiment is made at most, so that its losses add up to enough; and by what factor its loss must
exceed today's, to which it is added."""
RIVAL_SHARE = 0.05  # A rival that is best in this share of the resamples cannot be separated
UNSURE, SHRINKS = 0.25, 2.0
"""A number is unsure where its standard deviation is this share of its departure from nominal.

An experiment for it must shrink that deviation by this factor."""
MOST_CANDIDATES = 18  # Number of experiments that are simulated at most
CHECKED, CHECKED_FLOATING = 5, 2
"""Number of experiments that are foretold for the robots of the rivals too, of a held and of a floating robot."""
LEAST_NOISES = 0.01  # Smallest difference, in units of noise, that is told as a number


Entry = dict[str, Any]  # A proposal in the form of ``report.json``


def entry_of(
    sentence: str,
    separates: Sequence[str],
    experiment: Experiment | None = None,
    repeats: int = 1,
    expected: Sequence[Entry] = (),
    tried: Sequence[Entry] = (),
) -> Entry:
    """A proposal, with the figures that speak for it.

    The experiment is None where none tells the causes apart, or none could be foretold. ``expected`` says what it would
    show for each rival, beside today's logs; ``tried`` every experiment that was foretold, with its smallest loss over
    the rivals.
    """
    entry: Entry = {"sentence": sentence, "separates": list(separates)}
    if experiment is not None:
        entry["settings"] = experiment.settings | ({REPEATS: repeats} if repeats > 1 else {})
        entry |= {"collect": list(experiment.collect)} if experiment.collect else {}
    return entry | {"expected": list(expected), "tried": list(tried)}


def propose(
    undecided: Undecided,
    judged: JudgedLogs,
    replayer: Replayer,
    settings: Settings,
    progress: Callable[[str], None] = lambda _: None,
) -> Entry | None:
    """The next experiment of a diagnosis; None where nothing is open."""
    names, fits = undecided.names, undecided.fits
    if not fits or not fits[0].fit.hypotheses:
        return by_experience(names, Given(judged.logs, judged.robot)) if names else None
    rivals_of = {truth.name: tuple(rival for rival in fits if rival.name != truth.name) for truth in fits}
    by_truth = [Forecaster(judged, replayer, settings, one.name, one.fit, rivals_of[one.name]) for one in fits]
    if not names:
        return sharpen(by_truth[0], progress)
    if not by_truth[0].rivals:
        return by_experience(names, by_truth[0].given)
    return separate(names, by_truth, undecided.share, progress)


def by_experience(names: Sequence[str], given: Given) -> Entry:
    """A proposal without figures, where no rival has a fit that could be simulated."""
    trace = same_trace(names)
    if not given.is_jumps:
        return entry_of(f"{trace}log faster and slower motions, and diagnose all logs together.", names)
    jump = other_jumps(given)
    sentence = f"{trace}{jump.words}, and diagnose all logs together."
    return entry_of(sentence, names, jump)


def forecasts_of(
    forecaster: Forecaster, experiments: Sequence[Experiment], progress: Callable[[str], None]
) -> list[Forecast]:
    """What each of some experiments would show, if the robot can make it."""
    found = []
    for experiment in experiments:
        forecast = forecaster.forecast_possible(experiment)
        if forecast is not None:
            found.append(forecast)
            progress(f"next experiment {experiment.short}: least loss {forecast.least:.0f}")
    return found


def separate(
    names: Sequence[str], by_truth: Sequence[Forecaster], rival_share: float, progress: Callable[[str], None]
) -> Entry:
    """The experiment that tells the open causes apart, whichever is true, or the statement that none does.

    Experiments are foretold for the answer's robot, those of least effort first, until one of these tells enough; the
    most promising ones are foretold for the robots of the rivals too. ``rival_share`` is the share of the resamples in
    which the likeliest rival is best today.
    """
    answer, *others = by_truth
    today = answer.forecast(repetition(answer.given))
    least = today.least if today else 0.0
    enough, best = max(ENOUGH, LEAST_TIMES * least), None
    found: list[Forecast] = []
    for _, alike in groupby(candidates_for(answer.given)[:MOST_CANDIDATES], key=attrgetter("cost")):
        found += forecasts_of(answer, list(alike), progress)
        telling = [one for one in found if tells_apart(one, least, rival_share)]
        best = best_for_all_truths(telling, enough, others)
        if best is not None and best.least >= enough:
            break
    tried = [{"experiment": one.experiment.short, "least_loss": one.least} for one in found]
    if best is None or not tells_apart(best, least, rival_share):
        sentence = (
            f"{same_trace(names)}none of {len(found)} simulated experiments separates them beyond noise and the "
            "tolerances of the model."
        )
        return entry_of(sentence, names, tried=tried)
    return proposal_of(names, best, today, tried)


def best_for_all_truths(telling: Sequence[Forecast], enough: float, others: Sequence[Forecaster]) -> Forecast | None:
    """The most promising forecast with the separations that it has where another cause is true; None without any.

    Of those that tell ``enough`` the least effort comes first, and of equal effort what tells most.
    """

    def order(one: Forecast) -> tuple[bool, int, float]:
        tells = one.least >= enough
        return not tells, one.experiment.cost * tells, -one.least

    floating = any(other.robot.has_free_base for other in others)
    best: Forecast | None = None
    for one in sorted(telling, key=order)[: CHECKED_FLOATING if floating else CHECKED]:
        of_all = with_other_truths(one, others)
        best = of_all if best is None or of_all.least > best.least else best
        if best.least >= enough:
            break
    return best


def proposal_of(names: Sequence[str], best: Forecast, today: Forecast | None, tried: Sequence[Entry]) -> Entry:
    """The proposal of an experiment, with what it would show beside today's logs."""
    expected = expected_of(best, today)
    worst = min(expected, key=lambda one: float(one["loss"]))
    was = "" if worst["noises_today"] is None else f"; today by {in_noises(worst['noises_today'])}"
    differ = f"There {names[0]} and {worst['rival']} differ by {in_noises(worst['noises'])} times the noise"
    repeats = 1 if best.experiment.collect else max(1, math.ceil(ENOUGH / best.least))
    times = f", each {repeats} times" if repeats > 1 else ""
    sentence = (
        f"{same_trace(names)}{best.experiment.words}{times}, and diagnose all logs together. {differ} in "
        f"{worst['channel']}{was}."
    )
    return entry_of(sentence, names, best.experiment, repeats, expected, tried)


def same_trace(names: Sequence[str]) -> str:
    """The beginning of a sentence on causes, two or more, that logs leave open."""
    return f"These logs do not separate {', '.join(names[:-1])} and {names[-1]}: "


def tells_apart(forecast: Forecast, today: float, rival_share: float) -> bool:
    """Whether an experiment, made a few times, tells the answer apart from its rivals.

    ``today`` is the loss that the logged motions are foretold to give. Where these leave a rival best in
    ``rival_share`` of the resamples nevertheless, further motions alike leave it so, too, unless there are many:
    the mean difference of the losses, in its standard deviations, grows by the root of their number.
    """
    if forecast.least < max(ENOUGH / MOST_REPEATS, LEAST_TIMES * today):
        return False
    if not forecast.experiment.is_alike or not 0 < rival_share < 1:
        return True
    sigmas = -NormalDist().inv_cdf(rival_share)  # however small the share is
    wanted = NormalDist().inv_cdf(1 - RIVAL_SHARE)
    return sigmas * math.sqrt(1 + forecast.least / max(today, 1e-9)) >= wanted


def in_noises(size: float) -> str:
    """A difference in units of noise to two digits: ``6.3``, ``less than 0.01``."""
    return f"{size:.2g}" if size >= LEAST_NOISES else f"less than {LEAST_NOISES:g}"


def with_other_truths(forecast: Forecast, others: Sequence[Forecaster]) -> Forecast:
    """The forecast with the separations that it has where another cause is true."""
    found = [other.forecast(forecast.experiment) for other in others]
    if any(one is None for one in found):
        return replace(forecast, separations=tuple(replace(one, loss=0.0) for one in forecast.separations))
    more = [one for of in found if of is not None for one in of.separations]
    return replace(forecast, separations=(*forecast.separations, *more))


def expected_of(best: Forecast, today: Forecast | None) -> list[Entry]:
    """Each rival's smallest separation in an experiment beside today's."""

    def smallest(of: Forecast | None) -> dict[str, Separation]:
        by_size = sorted(of.separations if of else (), key=lambda one: -one.loss)
        first = best.separations[0].truth
        return {one.rival if one.rival != first else one.truth: one for one in by_size}

    before = smallest(today)
    return [
        {
            "rival": name,
            "channel": one.channel,
            "noises": one.noises,
            "loss": one.loss,
            "noises_today": before[name].noises if name in before else None,
            "loss_today": before[name].loss if name in before else None,
        }
        for name, one in sorted(smallest(best).items())
    ]


def sharpen(forecaster: Forecaster, progress: Callable[[str], None]) -> Entry | None:
    """The experiment that shrinks the interval of the least sure number of the answer most; None where all are sure."""
    answer = forecaster.answer
    spread = answer.spread()
    unsure = spread / np.maximum(np.abs(answer.departs), 1e-12)
    which = int(unsure.argmax())
    if unsure[which] < UNSURE:
        return None
    found = forecasts_of(forecaster, candidates_for(forecaster.given)[:MOST_CANDIDATES], progress)
    enough = [one for one in found if spread[which] >= SHRINKS * one.spread[which]]
    enough.sort(key=lambda one: (one.experiment.cost, one.spread[which]))
    if not enough:
        return None
    best = enough[0]
    labels = [(h.name, p) for h in answer.hypotheses for p in h.parameters]
    name, parameter = labels[which]
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    value = f"{answer.numbers[which]:.3g} ± {spread[which]:.2g}{unit}"
    sentence = (
        f"The least sure number is {parameter.name} of {name}, {value}: "
        f"{best.experiment.words}. That should leave ± {best.spread[which]:.2g}{unit}."
    )
    tried = [{"experiment": one.experiment.short, "spread": float(one.spread[which])} for one in found]
    now, then = float(spread[which]), float(best.spread[which])
    expected = [{"number": f"{name}.{parameter.name}", "spread": then, "spread_today": now}]
    return entry_of(sentence, (), best.experiment, 1, expected, tried)
