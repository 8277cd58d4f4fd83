from collections.abc import Sequence

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.candidates import Fit, SearchResult
from leapgap.diagnosis.closure import Interval
from leapgap.diagnosis.decision import (
    Conclusion,
    answer_of,
    best_set_shares,
    decide_partly,
    probability,
    shares_of_sets,
    verdict_of,
    without_what_widens,
)
from leapgap.diagnosis.decision_thresholds import DecisionThresholds
from leapgap.diagnosis.gauss_newton import broyden, covariance
from leapgap.diagnosis.hypotheses import Hypothesis, list_hypotheses
from leapgap.diagnosis.judged_logs import JudgedLogs
from leapgap.diagnosis.selection import MOST_SURPRISE, LinearGuess, Search, SearchSettings
from leapgap.diagnosis.sensitivities import Sensitivities, concatenate_logs, on_logs
from leapgap.diagnosis.short_rollouts import ShortRollouts
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.sensors import SensorNoise
from tests.diagnosis.test_gap import hardware

A1 = Robot.load()
TRUNK_KG = 4.713


def hypothesis(name: str, location: str = "all") -> Hypothesis:
    return Hypothesis(effects.known()[name], A1, location)


def fit(names: tuple[str, ...], heldout: list[float], chi2: float = 1.0) -> Fit:
    number = np.zeros(len(names))
    hypotheses = tuple(hypothesis(name) for name in names)
    losses = np.array(heldout)
    return Fit(hypotheses, number, np.eye(1), number[None], number, np.zeros((1, 1, 1)), 0.0, np.full(4, chi2), losses)


def search_result(*rivals: Fit, nominal: float = 100.0, chi2: float = 5.0) -> SearchResult:
    alone = fit((), [nominal] * 4, chi2)
    return SearchResult(alone, rivals[0] if rivals else alone, rivals, np.arange(4), 360, ())


DRAWS = np.random.default_rng(0).integers(0, 4, size=(400, 4))


def test_a_cause_that_is_best_on_every_log_is_named() -> None:
    search = search_result(fit(("payload",), [1.0, 2, 1, 2]), fit(("leg_mass",), [9.0, 9, 9, 9]))
    shares = best_set_shares(search, DRAWS)
    answer = answer_of(search, shares, DecisionThresholds())
    assert answer == (("payload",),)
    assert probability("payload", search, shares) == 1
    assert verdict_of(search, answer, 5.0, 0.9, DecisionThresholds()) == "named"


def test_a_log_without_a_piece_can_be_drawn_again() -> None:
    search = search_result(fit(("payload",), [1.0, 2, 1, 2]), fit(("leg_mass",), [9.0, 9, 9, 9]))
    draws = np.array([[4, 0, 1, 2, 3], [4, 4, 4, 4, 0]])
    assert best_set_shares(search, draws).tolist() == [1.0, 0.0]


def test_a_rival_that_is_better_on_some_logs_is_told() -> None:
    search = search_result(fit(("payload",), [1.0, 9, 1, 8]), fit(("leg_mass",), [9.0, 1, 9, 1]))
    answer = answer_of(search, best_set_shares(search, DRAWS), DecisionThresholds())
    assert answer == (("payload", "leg_mass"),)
    assert verdict_of(search, answer, 5.0, 0.9, DecisionThresholds()) == "ambiguous"


class KnownGap:
    """The gap of whole logs where what each candidate leaves is known, (logs,); 16 of the nominal robot's."""

    draws, has_gap = DRAWS, True

    def __init__(self, held: bool, left: dict[tuple[str, ...], list[float]]) -> None:
        self.is_of_held_robot, self.left = held, left

    def squares(self, fits: Sequence[Fit]) -> list[np.ndarray]:
        return [np.array(self.left[one.names]) for one in fits]

    def closure_value(self, squares: np.ndarray) -> float:
        return float(1 - np.sqrt(squares.sum() / 64))

    def closure(self, squares: np.ndarray) -> Interval:
        value = self.closure_value(squares)
        return Interval(value, value - 0.01, value + 0.01)

    def share_better(self, squares: np.ndarray, others: np.ndarray) -> float:
        return float((others[self.draws].sum(axis=1) > squares[self.draws].sum(axis=1)).mean())


@pytest.mark.parametrize(
    ("held", "left_by_gain", "rivals"),
    [(True, [1.0, 1, 1, 1], ("torque_gain",)), (False, [1.0, 1, 1, 1], ()), (True, [5.0, 1, 5, 1], ())],
)
def test_whole_logs_of_a_held_robot_tell_a_rival(
    held: bool, left_by_gain: list[float], rivals: tuple[str, ...]
) -> None:
    """Heavier links are likelier in short pieces; a gain leaves less in whole logs, for certain or not."""
    search = search_result(fit(("leg_mass",), [1.0] * 4), fit(("torque_gain",), [9.0] * 4))
    gap = KnownGap(held, {("leg_mass",): [4.0] * 4, ("torque_gain",): left_by_gain})
    shares = shares_of_sets(search, gap, DecisionThresholds())
    assert shares.sum() == pytest.approx(1)
    assert answer_of(search, shares, DecisionThresholds()) == (("leg_mass", *rivals),)


@pytest.mark.parametrize(
    ("held", "left", "verdict"), [(True, 25.0, "unknown"), (False, 25.0, "named"), (True, 9.0, "named")]
)
def test_an_answer_that_widens_the_gap_of_a_held_robot_is_not_told(held: bool, left: float, verdict: str) -> None:
    told = fit(("payload",), [1.0] * 4)
    gap = KnownGap(held, {("payload",): [left] * 4, (): [16.0] * 4})
    named = Conclusion("named", (("payload",),), (told,), (1.0,))
    assert without_what_widens(named, gap, DecisionThresholds()).verdict == verdict


def test_a_robot_with_nothing_wrong_stays_so_whatever_was_fitted() -> None:
    """Nothing is told of it, so nothing that is told can widen its gap."""
    gap = KnownGap(True, {("payload",): [25.0] * 4})
    assert without_what_widens(Conclusion("none", ()), gap, DecisionThresholds()).verdict == "none"


def test_causes_that_surely_close_some_of_the_gap_are_told_with_the_rest() -> None:
    search = search_result(fit(("payload",), [1.0, 9, 1, 8]), fit(("leg_mass",), [9.0, 1, 9, 1]))
    shares = best_set_shares(search, DRAWS)
    partly = decide_partly(search, shares, Interval(0.66, 0.5, 0.8), DecisionThresholds())
    assert (partly.verdict, partly.answer) == ("partly", (("payload", "leg_mass"),))
    assert partly.steps == search.steps
    for closes in (Interval(0.1, 0.05, 0.2), Interval(0.4, -0.1, 0.8)):
        assert decide_partly(search, shares, closes, DecisionThresholds()).verdict == "unknown"


def test_little_explained_is_unknown_and_nothing_to_explain_is_none() -> None:
    answer, doubts = (("payload",),), DecisionThresholds()
    weak = search_result(fit(("payload",), [80.0] * 4, chi2=3.0))
    assert verdict_of(weak, answer, 5.0, 0.5, doubts) == "unknown"
    assert verdict_of(weak, answer, 5.0, 0.9, doubts) == "named"
    strong = search_result(fit(("payload",), [1.0] * 4, chi2=3.0))
    assert verdict_of(strong, answer, 5.0, 0.5, doubts) == "named"
    assert verdict_of(strong, answer, 5.0, 0.1, doubts) == "unknown"
    # Whole jumps without a gap to close, or with a little one, leave it to short replays; not if they contradict.
    complete = search_result(fit(("payload",), [1.0] * 4, chi2=1.02))
    assert verdict_of(complete, answer, 5.0, None, doubts) == "named"
    assert verdict_of(complete, answer, 5.0, 0.1, doubts) == "named"
    assert verdict_of(complete, answer, 5.0, -0.5, doubts) == "unknown"
    assert verdict_of(complete, answer, 11.0, 0.03, doubts) == "unknown"  # they do not see what acts for a moment
    assert verdict_of(complete, answer, 11.0, 0.3, doubts) == "named"
    assert verdict_of(strong, answer, 5.0, None, doubts) == "unknown"
    assert verdict_of(search_result(chi2=1.02), (), 2.0, None, doubts) == "none"
    assert verdict_of(search_result(chi2=1.02), (), 5.0, None, doubts) == "unknown"  # slow to act: whole jumps show it
    assert verdict_of(search_result(chi2=3.0), (), 2.0, None, doubts) == "unknown"


@pytest.mark.parametrize(
    ("gain", "closes", "verdict"),
    [
        (30.0, 0.1, "none"),  # gains little, and nothing of whole jumps
        (30.0, 0.5, "named"),  # whole jumps need it
        (200.0, -0.2, "named"),  # short replays tell it; what whole jumps say of a gap within noise means nothing
    ],
)
def test_within_noise_a_cause_must_gain_in_short_replays_or_close_something(
    gain: float, closes: float, verdict: str
) -> None:
    heldout = [100.0 - gain / 4] * 4
    search = search_result(fit(("payload",), heldout, chi2=1.0), nominal=100.0, chi2=1.05)
    assert verdict_of(search, (("payload",),), 2.0, closes, DecisionThresholds()) == verdict


def test_broyden_learns_the_slope_along_a_move() -> None:
    rng = np.random.default_rng(0)
    slopes, errors, move = rng.standard_normal((3, 5, 2)), rng.standard_normal((3, 5)), np.array([0.3, -0.2])
    wrong = np.concatenate([errors[:, :, None], slopes + 0.5], axis=2)
    learned = broyden(wrong, move, errors + slopes @ move)
    assert learned @ move == pytest.approx(slopes @ move)
    across = np.array([0.2, 0.3])
    assert learned @ across == pytest.approx((slopes + 0.5) @ across)  # across it nothing was learned


def test_covariance_is_the_curvature_unless_errors_scatter_more() -> None:
    normal = np.array([[4.0, 1.0], [1.0, 3.0]])
    inverse = np.linalg.inv(normal)
    assert covariance(normal, normal, 1) == pytest.approx(inverse[:1, :1])
    assert covariance(normal, 0.1 * normal, 1) == pytest.approx(inverse[:1, :1])
    assert covariance(normal, 9 * normal, 1) == pytest.approx(9 * inverse[:1, :1])


@pytest.fixture(scope="module")
def search(robot: Robot, reference: Log) -> Search:
    """Two jumps of a robot with a heavier trunk."""
    jumps = hardware(robot, reference, effects.effect("payload", mass_kg=0.8), noise=SensorNoise(), jumps=2)
    evidence = ShortRollouts.of(JudgedLogs.of(jumps, robot).states, Replayer(robot, terrain_slots=1), 0.1, 0.01, 8)
    hypotheses = list_hypotheses(["payload", "torque_gain"], robot, None)
    return Search(
        Sensitivities.of(evidence, hypotheses, {"payload.mass_kg": 0.02 / TRUNK_KG}),
        np.array([0, 1]),
        SearchSettings(steps=4),
    )


def test_joints_together_do_what_the_sum_of_them_does(search: Search) -> None:
    """The linear model of a place is the sum of its joints: near nominal the robot agrees."""
    responses, h = search.sensitivities, hypothesis("torque_gain", "front")
    small = -0.01
    (errors,) = responses.evidence.residuals([on_logs(responses.evidence, (h, np.array([1 + small])))])
    true = (concatenate_logs(errors) - responses.nominal) / small
    linear = responses.columns[:, :, responses.at(h, 0)].sum(axis=2)
    assert (true * linear).sum() / np.linalg.norm(true) / np.linalg.norm(linear) > 0.95


def test_gauss_newton_finds_the_mass_and_held_out_logs_agree(search: Search) -> None:
    hypotheses = list_hypotheses(["payload", "torque_gain"], search.evidence.state.robot, None)
    best = search.singles(hypotheses)[0]
    assert best.names == ("payload",)
    assert best.numbers[0] == pytest.approx(0.8, abs=0.1)
    assert best.fold_numbers == pytest.approx(0.8, abs=0.15)
    assert abs(best.numbers[0] - 0.8) < 4 * np.sqrt(best.covariance[0, 0])
    assert best.heldout.sum() < search.nominal.heldout.sum() - 100
    profile = search.profile(best)
    assert profile.values[np.argmin(profile.loss)] == pytest.approx(best.numbers[0], rel=0.1)
    assert profile.loss.min() == 0 and profile.loss.max() > 2


def test_an_effect_at_many_places_leaves_room_for_another(search: Search) -> None:
    """Places of one effect look alike in the linear model."""
    places = ("all", "front", "rear", "hip", "thigh")
    guesses = [LinearGuess((hypothesis("leg_mass", at),), np.zeros(1), float(loss)) for loss, at in enumerate(places)]
    guesses.append(LinearGuess((hypothesis("torque_gain"),), np.zeros(1), 10.0))
    names = [guess.hypotheses[0].name for guess in search.shortlist(guesses, 5)]
    assert names == ["leg_mass"] * 3 + ["torque_gain"]


def test_one_piece_that_derivatives_mislead_does_not_decide(search: Search) -> None:
    """A piece whose errors jump with the number, as where a foot just touches, as held out against the others."""
    rng = np.random.default_rng(0)
    pieces, values, _ = search.sensitivities.nuisances.shape
    slope = rng.standard_normal((pieces, values, 1))
    errors = rng.standard_normal((pieces, values, 1)) - 0.05 * slope
    slope[0] *= 300.0
    errors[0] += 0.02 * slope[0]  # wants another number than all others
    columns = np.concatenate([errors, slope], axis=2)
    fit = search.cross_validate((hypothesis("payload"),), np.array([0.8]), columns)
    products = search.sensitivities.with_nuisances(columns)
    fitted = products.loss(products.fit(search.prior(1), search.all_pieces))
    assert fit.heldout[0] == pytest.approx(fitted[0] + MOST_SURPRISE)
    assert (fit.heldout[1:] < fitted[1:] + MOST_SURPRISE).all()
