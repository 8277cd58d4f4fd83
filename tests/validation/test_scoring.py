"""The arithmetic of the scores, on verdicts made by hand."""

from typing import Any

import numpy as np
import pytest

from leapgap.robot.model import Robot
from leapgap.validation import scoring
from leapgap.validation.outcome import CaseOutcome, comparable_maps, merge_sides, outcome, overlap


def report(verdict: str, answer: list[list[str]], probability: float = 0.9, **changed: Any) -> dict[str, Any]:
    names = [n for names in answer for n in names] or ["payload"]
    causes = [
        {
            "effect": name,
            "location": "all",
            "probability": probability,
            "parameters": {"damping": {"value": 0.44, "ci95": [0.41, 0.47], "nominal": 0.0}}
            if name == "joint_damping"
            else {},
        }
        for name in names
    ]
    return {
        "verdict": verdict,
        "answer": answer,
        "causes": causes,
        "closure_of_answer": {"heldout": 0.8, "ci95": [0.7, 0.9]} if answer else None,
        "where": [{"phase": "flight", "channel": "base_pos_x", "share": 0.3}],
        "sentence": "",
    } | changed


def truth(kind: str, *names: str, change: float = 0.4, where: str = "flight") -> dict[str, Any]:
    parameters = {"joint_damping": {"damping": 0.4}, "torque_gain": {"scale": 0.8}}
    effects = [{"name": n, "location": "all", "parameters": parameters.get(n, {"x": 1.0})} for n in names]
    return {
        "half": "reported",
        "kind": kind,
        "effects": effects,
        "per_log": {
            "jump_0": [e["parameters"] for e in effects],
            "proof_0": [{"damping": 9.0, "scale": 9.0}] * len(names),
        },
        "logs": {"jump_0.parquet": ""},
        "noise_floor": 0.1,
        "change": change,
        "changes": [change] * len(names),
        "detectable": change >= 0.2,
        "where": [{"phase": where, "channel": "base_pos_x", "share": 0.5}] if names else [],
    }


@pytest.fixture
def outcomes() -> list[CaseOutcome]:
    made = [
        (truth("single", "joint_damping"), report("named", [["joint_damping"]]), 0.75),
        (truth("single", "joint_damping"), report("ambiguous", [["torque_gain", "joint_damping"]], 0.5), 0.5),
        (truth("single", "torque_gain", where="lift_off"), report("named", [["payload"]], 0.7), 0.2),
        (truth("single", "torque_gain", change=0.05), report("none", []), None),
        (truth("pair", "joint_damping", "torque_gain"), report("named", [["torque_gain"], ["joint_damping"]]), 0.8),
        (truth("nameless", "wind"), report("unknown", []), None),
        (truth("nameless", "tether"), report("named", [["payload"]], 0.6), 0.1),
        (truth("none", change=0.0), report("none", []), None),
    ]
    return [outcome(f"case_{i}", t, r, c) for i, (t, r, c) in enumerate(made)]


def test_scores_count_what_the_contract_says(outcomes: list[CaseOutcome]) -> None:
    found = scoring.scores(outcomes, draws=50, bins=10, rng=np.random.default_rng(1))
    assert found["cases"] == 8
    assert found["detectable"] == 6
    assert found["named_first"] == pytest.approx(1 / 3)
    assert found["named_in_set"] == pytest.approx(2 / 3)
    assert found["set_size_mean"] == pytest.approx(4 / 3)
    assert found["wrongly_named"] == pytest.approx(2 / 8)
    assert found["unknown_recall"] == pytest.approx(1 / 2)
    assert found["none_correct"] == 1
    assert found["where_right"] == pytest.approx(5 / 6)
    assert found["pairs_both_named"] == 1
    assert found["parameter_error_median"] == pytest.approx(0.1)
    assert found["coverage"] == 0  # 0.44 within 0.41 to 0.47, the truth being 0.4
    assert found["closure_promise_error"] == pytest.approx(np.mean([0.05, 0.3, 0.6, 0.0, 0.7]))


def test_brier_and_calibration_by_hand(outcomes: list[CaseOutcome]) -> None:
    # claims: (0.9, right), (0.5, first is torque_gain: wrong), (0.7, wrong), (0.9, right), (0.6, wrong)
    assert scoring.brier(outcomes) == pytest.approx((0.01 + 0.25 + 0.49 + 0.01 + 0.36) / 5)
    assert scoring.calibration_error(outcomes, 10) == pytest.approx((2 * 0.1 + 0.5 + 0.7 + 0.6) / 5)
    found = scoring.scores(outcomes, draws=200, bins=10, rng=np.random.default_rng(1))["brier"]
    assert found["ci95"][0] < found["value"] < found["ci95"][1]


def test_an_undetectable_effect_named_wrongly_counts_against_all_cases() -> None:
    small = outcome("c", truth("single", "torque_gain", change=0.01), report("named", [["payload"]]), None)
    assert small.wrongly_named
    found = scoring.scores([small], 5, 10, np.random.default_rng(1))
    assert found["wrongly_named"] == 1
    assert found["named_first"] is None


def test_one_of_a_pair_named_is_no_wrong_name() -> None:
    half = outcome("c", truth("pair", "joint_damping", "torque_gain"), report("named", [["torque_gain"]]), None)
    assert not half.wrongly_named
    assert not half.right


def test_a_rival_in_the_answer_need_not_be_among_the_causes() -> None:
    said = report("ambiguous", [["payload", "torque_gain"]])
    said["causes"] = said["causes"][:1]
    judged = outcome("case", truth("single", "torque_gain"), said, 0.5)
    assert judged.answered == {"payload", "torque_gain"}
    assert judged.locations == () and judged.compared == ()


def test_members_of_triples_count_where_they_show() -> None:
    """Of two triples with three and two members that show, the answers have three and one of them."""
    names = ("joint_damping", "torque_gain", "payload")
    whole = outcome("a", truth("triple", *names), report("named", [[name] for name in names]), None)
    part = truth("triple", *names) | {"changes": [0.4, 0.3, 0.1]}
    one = outcome("b", part, report("partly", [["torque_gain"]]), None)
    found = scoring.scores([whole, one], 5, 10, np.random.default_rng(1))
    assert found["triples_members_named"] == pytest.approx(4 / 5)
    assert found["triples_all_named"] == pytest.approx(1 / 2)
    assert found["cases"] == 2
    assert whole.right
    assert not one.right


def test_true_parameter_is_that_of_the_logs_and_not_of_the_proof(outcomes: list[CaseOutcome]) -> None:
    assert outcomes[0].compared[0].true == 0.4
    assert outcomes[0].compared[0].error == pytest.approx(0.1)


def test_detection_limit_lies_between_missed_and_found() -> None:
    missed, found = (3.0, False), (12.0, True)
    assert scoring.limit_of([missed, found])["limit_floors"] == pytest.approx(6.0)
    assert scoring.limit_of([(3.0, False)])["limit_floors"] is None
    assert scoring.limit_of([(3.0, True)])["limit_floors"] == 3.0
    mixed = scoring.limit_of([(1.0, False), (2.0, True), (3.0, False), (4.0, True), (5.0, True)])
    assert mixed["limit_floors"] == pytest.approx(np.sqrt(12))


def test_left_and_right_legs_are_one_place_when_mirrored(robot: Robot) -> None:
    sides = robot.topology.sides
    assert merge_sides(("flight", "joint_vel/FL_calf"), sides) == ("flight", "joint_vel/FR_calf")
    assert merge_sides(("flight", "joint_vel/RR_calf"), sides) == ("flight", "joint_vel/RR_calf")


def test_confusion_puts_what_was_said_first_beside_the_truth(outcomes: list[CaseOutcome]) -> None:
    table = scoring.confusion(outcomes)
    assert table["torque_gain"] == {"payload": 1}
    assert table["too small to detect"] == {"none": 1}
    assert table["nameless: wind"] == {"unknown": 1}


def test_nothing_to_count_is_null() -> None:
    assert scoring.share([]) is None
    assert scoring.scores([], 5, 10, np.random.default_rng(1))["brier"] == {"value": None, "ci95": [None, None]}


def test_each_case_counts_against_the_scores_that_it_makes_worse(outcomes: list[CaseOutcome]) -> None:
    assert [scoring.counted_against(o) for o in outcomes] == [
        ["parameter_error_median"],  # 0.44 for a true 0.4
        ["named_first", "named_alone", "parameter_error_median"],  # the second name of an ambiguous answer
        ["named_first", "named_in_set", "named_alone", "wrongly_named", "where_right", "where_right_mirrored"],
        [],  # too small to detect, and nothing named
        ["parameter_error_median"],
        [],
        ["wrongly_named", "unknown_recall"],
        [],
    ]


def test_missed_effects_are_singles_not_named_first_and_pairs_not_wholly_named(outcomes: list[CaseOutcome]) -> None:
    half = outcome("c", truth("pair", "joint_damping", "torque_gain"), report("named", [["torque_gain"]]), None)
    small = outcome(
        "c", truth("pair", "joint_damping", "torque_gain", change=0.1), report("named", [["torque_gain"]]), None
    )
    assert [scoring.is_missed(o) for o in outcomes] == [False, True, True, False, False, False, False, False]
    assert scoring.is_missed(half)
    assert scoring.counted_against(half) == ["pairs_both_named"]
    assert not scoring.is_missed(small)


def uneven(family: str, *names: str, changes: tuple[float, ...] = (1.0, 0.4)) -> dict[str, Any]:
    """The truth of a case of uneven rows, with effects beside them."""
    every = truth("uneven", "sample_period", *names)
    return every | {"clock": {"family": family, "sizes": {}}, "changes": list(changes[: 1 + len(names)])}


def third(physics: str, *names: str, accepted: tuple[str, ...] = ()) -> dict[str, Any]:
    """The truth of a case of a third physics."""
    return truth("third", *names, change=0.4 if names else 0.0) | {"physics": physics, "accepted": list(accepted)}


@pytest.fixture
def further() -> list[CaseOutcome]:
    clock = ["sample_period"]
    made = [
        (uneven("stalls"), report("named", [clock])),
        (uneven("stalls", "joint_damping"), report("partly", [clock])),  # the clock, and not the damping
        (uneven("drift", "joint_damping"), report("named", [["joint_damping"], clock])),  # not first
        (uneven("drift", "joint_damping", changes=(1.0, 0.05)), report("ambiguous", [clock, ["payload", "wind"]])),
        (third("stiff", accepted=("foot_compliance",)), report("named", [["foot_compliance"]])),
        (third("pyramidal"), report("named", [["payload"]])),
        (third("stiff", "torque_gain"), report("named", [["torque_gain"]])),
        (truth("too_high", "joint_friction"), report("named", [["joint_friction"]])),
        (truth("too_high", "armature", change=0.05), report("named", [["payload"]])),
    ]
    return [outcome(f"case_{i}", t, r, None) for i, (t, r) in enumerate(made)]


def test_further_kinds_have_scores_of_their_own(outcomes: list[CaseOutcome], further: list[CaseOutcome]) -> None:
    alone, both = (scoring.scores(of, 50, 10, np.random.default_rng(1)) for of in (outcomes, [*outcomes, *further]))
    of_kinds = ("uneven_", "third_", "too_high_")
    assert {k: v for k, v in both.items() if not k.startswith(of_kinds)} == {
        k: v for k, v in alone.items() if not k.startswith(of_kinds)
    }
    assert alone["uneven_cases"] == 0 and alone["uneven_clock_first"] is None
    assert both["uneven_cases"] == 4 and both["uneven_clock_first"] == pytest.approx(3 / 4)
    assert both["uneven_clock_first_by_family"] == {"drift": 0.5, "stalls": 1.0}
    assert both["uneven_effect_named"] == pytest.approx(1 / 2)  # of the two that are detectable
    assert both["uneven_wrongly_named"] == pytest.approx(1 / 4)
    assert both["third_cases"] == 3 and both["third_detectable"] == 1
    assert both["third_none_correct"] == pytest.approx(1 / 2) and both["third_named_first"] == 1
    assert both["third_wrongly_named"] == pytest.approx(1 / 3)
    assert both["third_right_by_physics"] == {"pyramidal": 0.0, "stiff": 1.0}
    assert both["too_high_named_first"] == 1 and both["too_high_wrongly_named"] == pytest.approx(1 / 2)


def test_what_is_right_for_further_kinds(further: list[CaseOutcome]) -> None:
    assert [o.right for o in further] == [True, False, False, False, True, False, True, True, False]
    assert [scoring.counted_against(o) for o in further[:4]] == [
        [],
        ["uneven_effect_named"],
        ["uneven_clock_first"],
        ["uneven_wrongly_named"],
    ]
    table = scoring.confusion(further)
    assert table["uneven: sample_period + joint_damping"] == {"sample_period": 2, "joint_damping": 1}
    assert table["third: none"] == {"foot_compliance": 1, "payload": 1}


def entry(phase: str, channel: str, share: float, as_one_with: str | None = None) -> dict[str, Any]:
    return {"phase": phase, "channel": channel, "share": share, "as_one_with": as_one_with}


def test_overlap_of_maps_is_the_sum_of_minima() -> None:
    true = [entry("flight", "base_pos_x", 0.6), entry("flight", "base_pos_z", 0.3), entry("stance", "base_pos_x", 0.1)]
    said = [entry("stance", "base_pos_x", 0.5), entry("flight", "base_pos_x", 0.3), entry("flight", "base_pos_z", 0.2)]
    maps = comparable_maps(true, said)
    assert overlap(*maps) == pytest.approx(0.3 + 0.2 + 0.1)
    assert overlap(maps[0], maps[0]) == pytest.approx(1)


def test_sides_that_a_report_does_not_tell_apart_are_one_in_both_maps() -> None:
    true = [entry("flight", "joint_vel/FL_calf", 0.9), entry("flight", "joint_vel/FR_calf", 0.1)]
    halves = ("joint_vel/FL_calf", "joint_vel/FR_calf")
    as_one = [entry("flight", a, 0.5, b) for a, b in (halves, halves[::-1])]
    apart = [entry("flight", name, 0.5) for name in halves]
    assert overlap(*comparable_maps(true, as_one)) == pytest.approx(1)
    assert overlap(*comparable_maps(true, apart)) == pytest.approx(0.6)


def test_overlap_is_scored_above_five_noise_floors_and_the_top_three_of_all() -> None:
    def case(change: float, said: list[dict[str, Any]]) -> CaseOutcome:
        of = truth("single", "payload", change=change) | {"where": [entry("flight", "base_pos_x", 1.0)]}
        return outcome("c", of, report("named", [["payload"]], where=said), None)

    others = [entry("stance", f"base_pos_{axis}", 0.2) for axis in "xyz"]
    clear = case(0.6, [*others, entry("flight", "base_pos_x", 0.1)])
    small = case(0.4, [entry("flight", "base_pos_x", 0.7), *others])
    found = scoring.scores([clear, small], 5, 10, np.random.default_rng(1))
    assert found["where_overlap"] == pytest.approx(0.1)
    assert found["where_overlap_detectable"] == pytest.approx(0.4)
    assert found["where_top_three"] == pytest.approx(0.5)


def test_cases_of_another_robot_have_scores_of_their_own_and_count_in_no_other() -> None:
    def case(robot: str | None, said: str) -> CaseOutcome:
        of = truth("single", "joint_damping") | ({} if robot is None else {"robot": robot})
        return outcome("c", of, report("named", [[said]]), 0.75)

    own = [case(None, "joint_damping")]
    others = [case("arm", "payload"), case("arm", "joint_damping"), case("dog", "payload")]
    alone, both = (scoring.scores(these, 5, 10, np.random.default_rng(1)) for these in (own, [*own, *others]))
    assert both == alone
    found = scoring.scores_by_robot([*own, *others], "hopper", 10)
    assert list(found) == ["hopper", "arm", "dog"]
    assert [found[name]["cases"] for name in found] == [1, 2, 1]
    assert [found[name]["named_first"] for name in found] == [1, 0.5, 0]
    assert [found[name]["wrongly_named"] for name in found] == [0, 0.5, 1]
    assert found["arm"]["parameter_error_median"] == pytest.approx(0.1)
    assert found["arm"]["brier"] == pytest.approx((0.9**2 + 0.1**2) / 2)
    assert found["dog"]["pairs_both_named"] is None
