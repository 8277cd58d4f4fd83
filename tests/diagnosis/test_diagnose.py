import dataclasses
import json
from functools import cache

import numpy as np
import pytest
from omegaconf import OmegaConf

from leapgap import effects
from leapgap.diagnosis.checks import clocks as local
from leapgap.diagnosis.diagnose import Diagnosis, diagnose
from leapgap.diagnosis.experiment_plans import Given
from leapgap.diagnosis.next_experiment import by_experience
from leapgap.diagnosis.report import Provenance
from leapgap.diagnosis.settings import Settings
from leapgap.effects.measurements import SamplePeriod
from leapgap.errors import InputError
from leapgap.jumping.task import ContactSchedule, Target, jump_info, target_of
from leapgap.logs.log import Log
from leapgap.reports.report import html
from leapgap.robot.model import Robot
from leapgap.simulation.replay import Replayer
from leapgap.simulation.rollout import Rollout
from leapgap.simulation.sensors import SensorNoise
from tests.conftest import standing
from tests.diagnosis.judging import judge
from tests.diagnosis.test_gap import hardware
from tests.diagnosis.two_link_arm import TORQUE_MOTOR, two_link_arm

FEW = Settings(
    effects=["joint_damping", "sample_period", "torque_gain"],
    folds=2,
    pieces_per_log=5,
    tolerances={"joint_friction.torque_nm": 0.05},
    bootstrap_draws=200,
)
JUMPS = 2
DAMPED = effects.effect("joint_damping", damping=0.4)


@pytest.fixture(scope="module")
def jumps_with(robot: Robot, reference: Log):
    """Noisy jumps of a robot with some effects, simulated once."""

    @cache
    def run(*found: effects.Effect) -> list[Log]:
        return hardware(robot, reference, *found, noise=SensorNoise(), jumps=JUMPS)

    return run


@pytest.fixture(scope="module")
def diagnose_effects(robot: Robot, jumps_with):
    """The diagnosis of such jumps, made once for each set of effects; damping and none with their proposals."""

    @cache
    def run(*found: effects.Effect) -> Diagnosis:
        return (diagnose if found in ((), (DAMPED,)) else judge)(jumps_with(*found), robot, FEW)

    return run


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joint_damping", {"damping": 0.4}),
        ("torque_gain", {"scale": 0.85}),
        ("sample_period", {"scale": 1.07}),
    ],
)
def test_diagnosis_names_the_effect_we_injected(diagnose_effects, name: str, values: dict[str, float]) -> None:
    report = diagnose_effects(effects.effect(name, **values)).report
    assert report.verdict == "named"
    assert report.answer[0] == (name,)
    assert report.causes[0].effect == name
    ((parameter, estimate),) = report.causes[0].parameters.items()
    nominal = effects.effect(name).values[parameter]
    assert estimate.value - nominal == pytest.approx(values[parameter] - nominal, rel=0.15)
    assert report.closure_of_answer.value > 0.8
    assert name in report.sentence


@pytest.mark.long
def test_diagnosis_of_the_nominal_robot_is_none(diagnose_effects) -> None:
    report = diagnose_effects().report
    assert report.next_experiment is None
    assert report.verdict == "none"
    assert report.answer == ()
    assert report.closure_of_answer is None


@pytest.mark.long
def test_an_effect_struck_from_the_hypotheses_is_not_claimed_in_full(robot: Robot, jumps_with) -> None:
    jumps = jumps_with(effects.effect("torque_gain", scale=0.7))
    settings = dataclasses.replace(FEW, effects=["sample_period"])
    report = judge(jumps, robot, settings).report
    assert report.closure_of_answer is None or report.closure_of_answer.value < 0.6


@pytest.mark.long
def test_report_holds_the_contract_and_repeats(diagnose_effects, robot: Robot, reference: Log) -> None:
    found = diagnose_effects(DAMPED)
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
    for off in report["landing_misplaced_m"].values():
        assert abs(off["corrected"]) < 0.4 * abs(off["nominal"])
    anew = hardware(robot, reference, DAMPED, noise=SensorNoise(), jumps=JUMPS)
    again = diagnose(anew, robot, FEW)
    assert json.dumps(again.report.to_json(), allow_nan=False) == text


def test_page_is_self_contained_and_says_the_sentence(diagnose_effects, robot: Robot, jumps_with) -> None:
    found = diagnose_effects(DAMPED)
    jumps = jumps_with(DAMPED)
    ghosts = {jump.name: jump for jump in jumps}
    page = html(found.report, jumps, robot, ghosts, ghosts)
    own = page.split("<body>")[1]
    assert found.report.sentence[1:].replace("joint_damping: ", "") in own
    assert "src=" not in own and "<link" not in page
    assert page == html(found.report, jumps, robot, ghosts, ghosts)


def test_a_library_call_knows_what_it_was_made_of(diagnose_effects, robot: Robot, jumps_with) -> None:
    """Nobody says where the logs came from: their content stands for their files, and all else is known."""
    report = diagnose_effects(DAMPED).report.to_json()
    jumps = jumps_with(DAMPED)
    provenance = report["provenance"]
    assert set(provenance) == {"logs", "robot", "config", "versions"}
    assert list(provenance["logs"]) == [jump.name for jump in jumps]
    assert all(len(digest) == 64 for digest in provenance["logs"].values())
    assert len(set(provenance["logs"].values())) == len(jumps)
    assert provenance["robot"] == robot.sha256
    assert provenance["config"]["most_pieces"] == FEW.most_pieces
    assert set(provenance["versions"]) == {"leapgap", "mujoco", "numpy"}


def test_provenance_tells_logs_apart_by_a_single_bit(robot: Robot) -> None:
    jump = standing(robot, 50)
    columns = {name: values.copy() for name, values in jump.columns.items()}
    columns["base_pos_x"][30] += 1e-12
    other = dataclasses.replace(jump, columns=columns)
    same, again, changed = (Provenance.of([one], robot, {}).logs["standing"] for one in (jump, jump, other))
    assert same == again != changed
    assert Provenance.of([jump], robot, {}, files={"standing": "abc"}).logs == {"standing": "abc"}


def test_one_jump_says_what_cannot_be_judged(robot: Robot, reference: Log) -> None:
    with pytest.raises(InputError, match="a cause is judged on logs it was not fitted on"):
        diagnose(hardware(robot, reference), robot, FEW)


def test_a_missing_channel_is_listed_and_not_filled_in(robot: Robot, reference: Log) -> None:
    jumps = hardware(robot, reference, noise=SensorNoise(), jumps=JUMPS)
    blind = [
        Log(jump.name, {k: v for k, v in jump.columns.items() if k != "base_angvel_y"}, jump.info) for jump in jumps
    ]
    settings = dataclasses.replace(FEW, effects=["joint_damping"])
    report = judge(blind, robot, settings).report
    assert "base_angvel_y" in report.not_judged
    assert not any(place.channel == "base_angvel_y" for place in report.where)


@pytest.mark.long
@pytest.mark.parametrize(
    ("found", "rivals", "parameter"),
    [
        (effects.effect("com_offset", z_m=0.03), ["payload"], "z_m"),
        (effects.effect("torque_speed_limit", voltage_v=16.0), ["torque_gain"], "voltage_v"),
        (effects.effect("command_delay", delay_s=0.005), ["state_latency"], "delay_s"),
        (effects.effect("encoder_bias", bias_rad=0.03), ["leg_mass"], "bias_rad"),
        (effects.effect("foot_friction", mu=0.4), ["foot_compliance"], "mu"),
    ],
)
def test_effects_of_motors_masses_feet_and_sensors_are_named_among_rivals(
    robot: Robot, reference: Log, found: effects.Effect, rivals: list[str], parameter: str
) -> None:
    jumps = hardware(robot, reference, found, noise=SensorNoise(), jumps=JUMPS)
    settings = dataclasses.replace(FEW, effects=[found.name, *rivals])
    first = judge(jumps, robot, settings).report.causes[0]
    assert first.effect == found.name
    # In this jump the front feet never come near their cone: where they slip, only the rear can tell.
    assert first.location in (("all", "rear") if found.name == "foot_friction" else ("all",))
    (nominal,) = (p.nominal for p in found.parameters(robot) if p.name == parameter)
    departure = found.values[parameter] - nominal
    assert first.parameters[parameter].value == pytest.approx(found.values[parameter], abs=0.15 * abs(departure))


@pytest.mark.long
def test_more_logs_than_pieces_are_no_obstacle(robot: Robot, jumps_with) -> None:
    jumps = jumps_with(DAMPED)
    settings = dataclasses.replace(FEW, effects=["joint_damping"], most_pieces=1)
    assert judge(jumps, robot, settings).report.gap_corrected < 0.5


@pytest.mark.long
def test_a_single_weak_joint_is_found(robot: Robot, reference: Log) -> None:
    weak = effects.effect("torque_gain", location="RR_calf", scale=0.7)
    report = diagnosed_of(hardware(robot, reference, weak, noise=SensorNoise(), jumps=JUMPS), robot)
    assert (report.causes[0].effect, report.causes[0].location) == ("torque_gain", "RR_calf")
    assert report.causes[0].parameters["scale"].value == pytest.approx(0.7, abs=0.04)
    assert "torque_gain at RR_calf" in report.sentence


def diagnosed_of(jumps: list[Log], robot: Robot):
    return judge(jumps, robot, FEW).report


def test_a_robot_with_a_fixed_base_is_diagnosed_by_its_joints(tmp_path, robot: Robot) -> None:
    """An arm that swings with joint PD: what it lacks is damping of its elbow."""
    (tmp_path / "arm.xml").write_text(two_link_arm(TORQUE_MOTOR), encoding="utf-8")
    arm = Robot.load(tmp_path / "arm.xml")
    rng = np.random.default_rng(0)
    damped, replayer = (effects.effect("joint_damping", location="L_elbow", damping=0.5),), Replayer(arm)
    logs = []
    for i in range(3):
        time = np.arange(1000) / 1000
        columns = {"time": time}
        for k, joint in enumerate(arm.joints):
            swing = 0.5 * np.sin(2 * np.pi * (1 + 0.3 * i + 0.4 * k) * time)
            columns |= {f"cmd_pos/{joint}": swing, f"cmd_vel/{joint}": np.gradient(swing, time)}
            columns |= {f"joint_pos/{joint}": 0 * time, f"joint_vel/{joint}": 0 * time, f"cmd_tau/{joint}": 0 * time}
            columns |= {f"cmd_kp/{joint}": 0 * time + 60.0, f"cmd_kd/{joint}": 0 * time + 1.0}
        planned = Log(f"swing_{i}", columns, jump_info("arm", 0.001, ContactSchedule(), Target(0.0), "a test"))
        (motion,) = replayer.motions([Rollout(planned, damped)])
        log = replayer.as_log(motion, planned)
        noisy = {
            name: values + (5e-4 if "pos" in name else 5e-2) * rng.standard_normal(len(values))
            for name, values in log.columns.items()
            if name.startswith("joint_")
        }
        logs.append(dataclasses.replace(log, columns=dict(log.columns) | noisy))
    settings = dataclasses.replace(FEW, effects=["joint_damping", "torque_gain", "payload", "foot_friction"], folds=3)
    report = judge(logs, arm, settings).report
    assert report.verdict == "named"
    assert report.causes[0].effect == "joint_damping" and report.causes[0].location in ("elbow", "L_elbow")
    assert report.causes[0].parameters["damping"].value == pytest.approx(0.5, abs=0.05)


def test_logs_shorter_than_a_piece_are_refused(robot: Robot) -> None:
    with pytest.raises(InputError, match=r"more than 0\.1 s"):
        diagnose([standing(robot, 80), standing(robot, 80)], robot, FEW)


@pytest.mark.long
def test_an_uneven_loop_is_known_from_the_joints_and_put_into_the_replay(robot: Robot, reference: Log) -> None:
    """A loop that loses a tenth of its pace in the middle of a jump, as an effect and as a check finds it."""
    profile = (1.0, 1.0, 1.25, 1.0, 1.0)
    slow = SamplePeriod(scale=1.05, profile=profile)
    jumps = hardware(robot, reference, slow, noise=SensorNoise(), jumps=JUMPS)
    clocks = local.local_clocks(jumps, robot)
    rows = len(jumps[0])
    every = jumps[0].info.rows(local.LOCAL_EVERY_S)
    moving = slice(rows // 3 // every, 2 * rows // 3 // every)
    found = clocks["made_0"].values[moving]
    at = np.linspace(0, rows - 1, len(clocks["made_0"].values))[moving]
    assert found == pytest.approx(1.05 * np.interp(at, np.linspace(0, rows - 1, 5), profile), abs=0.03)
    report = diagnosed_of([jump.first_rows(900) for jump in jumps], robot)
    assert report.answer[0] == ("sample_period",)
    assert any(check.name == "even_clock" and not check.passed for check in report.checks)


def test_the_next_experiment_is_one_that_can_be_run(robot: Robot, reference: Log) -> None:
    """More jumps to the logged distance, whose plan is known to be one that can be jumped, as settings of `collect`."""
    given = Given((reference,) * 4, robot)
    asked = by_experience(("torque_gain", "leg_mass"), given)
    assert asked["settings"] == {"kind": "jumps"}
    assert asked["separates"] == ["torque_gain", "leg_mass"]
    section = OmegaConf.from_dotlist(asked["collect"]).collect
    assert section.jumps == 8
    assert [target[0] for target in section.targets] == [target_of(reference).x_m]
    assert list(section.block_height_m) == [0.02, 0.08]
