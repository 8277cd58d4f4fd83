import dataclasses
import json

import numpy as np
import pytest

from leapgap import effects
from leapgap.diagnosis.attribution import Fit, Hypothesis, lowest
from leapgap.diagnosis.diagnose import Diagnosis, Settings, diagnose, hypotheses_of
from leapgap.errors import InputError
from leapgap.recording.jump import Jump
from leapgap.robot.model import Robot
from leapgap.simulation.hardware import SensorNoise
from leapgap.view.report import html
from tests.diagnosis.test_gap import hardware

FEW = Settings(
    effects=["joint_damping", "sample_period", "torque_gain"], grid_points=4, most_causes=1, bootstrap_draws=200
)


@pytest.fixture(scope="module")
def diagnosed(robot: Robot, reference: Jump):
    def of(*found: effects.Effect) -> Diagnosis:
        jumps = hardware(robot, reference, *found, noise=SensorNoise(), jumps=4)
        return diagnose(jumps, robot, FEW, {"logs": {}, "versions": {}})

    return of


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joint_damping", {"damping": 0.4}),
        ("torque_gain", {"scale": 0.85}),
        ("sample_period", {"scale": 1.07}),
    ],
)
def test_diagnosis_names_the_effect_we_injected(diagnosed, name: str, values: dict[str, float]) -> None:
    report = diagnosed(effects.effect(name, **values)).report
    assert report.verdict == "named"
    assert report.answer[0] == (name,)
    assert report.causes[0].effect == name
    ((parameter, estimate),) = report.causes[0].parameters.items()
    nominal = effects.effect(name).values[parameter]
    assert estimate.value - nominal == pytest.approx(values[parameter] - nominal, rel=0.15)
    assert report.closure_of_answer.value > 0.8
    assert name in report.sentence


def test_diagnosis_of_the_nominal_robot_is_none(diagnosed) -> None:
    report = diagnosed().report
    assert report.verdict == "none"
    assert report.answer == ()
    assert report.closure_of_answer is None


def test_an_effect_struck_from_the_hypotheses_is_not_claimed_in_full(robot: Robot, reference: Jump) -> None:
    jumps = hardware(robot, reference, effects.effect("torque_gain", scale=0.7), noise=SensorNoise(), jumps=4)
    settings = dataclasses.replace(FEW, effects=["sample_period"])
    report = diagnose(jumps, robot, settings, {"logs": {}, "versions": {}}).report
    assert report.closure_of_answer is None or report.closure_of_answer.value < 0.6


def test_report_holds_the_contract_and_repeats(diagnosed) -> None:
    found = diagnosed(effects.effect("joint_damping", damping=0.4))
    text = json.dumps(found.report.to_json(), allow_nan=False)
    report = json.loads(text)
    assert set(report) >= {
        "format_version",
        "verdict",
        "sentence",
        "gap",
        "answer",
        "closure_of_answer",
        "where",
        "causes",
        "checks",
        "next_experiment",
        "provenance",
    }
    assert set(report["gap"]) == {"nominal", "corrected", "noise_floor", "unit"}
    assert set(report["causes"][0]) >= {
        "effect",
        "location",
        "probability",
        "parameters",
        "per_log",
        "closure",
        "confusable_with",
    }
    assert set(report["causes"][0]["parameters"]["damping"]) >= {"value", "ci95", "nominal", "unit"}
    assert found.correction[0].name == "joint_damping"
    again = diagnosed(effects.effect("joint_damping", damping=0.4))
    assert json.dumps(again.report.to_json(), allow_nan=False) == text


def test_page_is_self_contained_and_says_the_sentence(diagnosed, robot: Robot, reference: Jump) -> None:
    found = diagnosed(effects.effect("joint_damping", damping=0.4))
    jumps = hardware(robot, reference, effects.effect("joint_damping", damping=0.4), noise=SensorNoise(), jumps=4)
    ghosts = {jump.name: jump for jump in jumps}
    page = html(found.report, jumps, ghosts, ghosts)
    own = page.split("<body>")[1]
    assert found.report.sentence[1:] in own
    assert "src=" not in own and "<link" not in page
    assert page == html(found.report, jumps, ghosts, ghosts)


def test_one_jump_says_what_cannot_be_judged(robot: Robot, reference: Jump) -> None:
    with pytest.raises(InputError, match="a cause is judged on jumps it was not fitted on"):
        diagnose(hardware(robot, reference), robot, FEW, {"logs": {}, "versions": {}})


def test_a_missing_channel_is_listed_and_not_filled_in(robot: Robot, reference: Jump) -> None:
    jumps = hardware(robot, reference, noise=SensorNoise(), jumps=2)
    blind = [
        Jump(jump.name, {k: v for k, v in jump.columns.items() if k != "base_angvel_y"}, jump.info) for jump in jumps
    ]
    settings = dataclasses.replace(FEW, effects=["joint_damping"], folds=2)
    report = diagnose(blind, robot, settings, {"logs": {}, "versions": {}}).report
    assert "base_angvel_y" in report.not_judged
    assert not any(place.channel == "base_angvel_y" for place in report.where)


@pytest.mark.parametrize(
    ("found", "rivals", "parameter"),
    [
        (effects.effect("com_offset", z_m=0.03), ["payload"], "z_m"),
        (effects.effect("torque_speed_limit", voltage_v=16.0), ["torque_gain"], "voltage_v"),
        (effects.effect("command_delay", delay_s=0.005), ["joint_friction"], "delay_s"),
        (effects.effect("encoder_bias", bias_rad=0.03), ["leg_mass"], "bias_rad"),
    ],
)
def test_effects_of_motors_masses_and_sensors_are_found_among_rivals(
    robot: Robot, reference: Jump, found: effects.Effect, rivals: list[str], parameter: str
) -> None:
    jumps = hardware(robot, reference, found, noise=SensorNoise(), jumps=4)
    settings = dataclasses.replace(FEW, effects=[found.name, *rivals], grid_points=8)
    first = diagnose(jumps, robot, settings, {"logs": {}, "versions": {}}).report.causes[0]
    assert first.effect == found.name
    # Valleys of delay and voltage are narrower than the grid: the parabola through three points is as good as this.
    assert first.parameters[parameter].value == pytest.approx(found.values[parameter], rel=0.3)


def test_an_effect_with_two_parameters_is_a_hypothesis_for_each() -> None:
    hypotheses = hypotheses_of(["com_offset", "payload"], [])
    assert [h.key for h in hypotheses] == [("com_offset", "x_m"), ("com_offset", "z_m"), ("payload", "mass_kg")]
    assert hypotheses[1].on("log", 0.02) == effects.effect("com_offset", z_m=0.02)


def test_minimum_of_a_parabola_is_found_between_grid_points() -> None:
    numbers = np.array([0.0, 0.1, 0.4, 0.9, 1.6])
    assert lowest(numbers, (numbers - 0.33) ** 2) == pytest.approx(0.33)
    assert lowest(numbers, numbers) == 0.0


def test_a_fit_at_its_bound_is_known_as_such() -> None:
    hypothesis = Hypothesis("torque_gain")
    grid = hypothesis.grid(4)
    assert (grid[0], grid[-1]) == pytest.approx((0.3, 1.5))
    assert 1.0 in grid

    def fit(at: float) -> Fit:
        return Fit(hypothesis, grid, (grid[:, None] - at) ** 2, np.zeros(4), np.zeros(4))

    assert fit(1.6).at_bound
    assert not fit(0.9).at_bound
    damping = Hypothesis("joint_damping")
    assert not Fit(damping, damping.grid(4), damping.grid(4)[:, None] ** 2, np.zeros(4), np.zeros(4)).at_bound
