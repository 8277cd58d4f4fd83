"""Owners' robots against plain MuJoCo and by hand: drives, errors, draws, and the rule of right or honest."""

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.logs.log import read_logs
from leapgap.robot.model import Robot
from leapgap.validation.outcome import CaseOutcome, outcome
from leapgap.validation.owners.cases import OwnersCase, OwnersHalf, Plan, draw_owners, write_owners_case
from leapgap.validation.owners.errors import OF_ROBOT, TOLD_LIMIT, TOLD_SET_POINTS, TOLD_VELOCITY
from leapgap.validation.owners.plant import OwnersDrive, build
from leapgap.validation.owners.robots import ROBOTS
from tests.code import ROOT
from tests.validation.test_scoring import report, truth

MODELS = ROOT / "conf" / "withhold" / "models"
BENCH, LIMIT = ROBOTS["bench"], np.array([9.0, 5.0])


def drive(**changed: object) -> OwnersDrive:
    return OwnersDrive(**{"kp": np.array(BENCH.kp), "kd": np.array(BENCH.kd), "limit": LIMIT} | changed)  # type: ignore[arg-type]


def still(of: OwnersDrive, rows: int = 400) -> np.ndarray:
    """What the joints of the test bench show at last, under set points that do not move."""
    plant = build(MODELS / "bench.xml", of)
    at = np.tile(plant.model.key_qpos[0], (rows, 1))
    return plant.run(at, np.zeros_like(at), BENCH.period_s, 0.0005, 0).shown[-1]


def test_a_drive_that_does_what_the_log_says_is_mujocos_own_position_servo() -> None:
    so101, rows = ROBOTS["so101"], 60
    plant = build(MODELS / "so101.xml", OwnersDrive(np.array(so101.kp), np.array(so101.kd), np.full(6, 2.94)))
    time = np.arange(rows) * so101.period_s
    sent = so101.set_points(time, plant.model.key_qpos[0], np.random.default_rng(1))
    run = plant.run(sent, np.zeros_like(sent), so101.period_s, 0.0005, 0)
    model = mujoco.MjModel.from_xml_path(str(MODELS / "so101.xml"))
    model.opt.timestep = so101.period_s / np.ceil(so101.period_s / 0.0005)
    data = mujoco.MjData(model)
    data.qpos[:] = model.key_qpos[0]
    shown = []
    for row in range(rows):
        shown.append(data.qpos.copy())
        data.ctrl[:] = sent[row]
        mujoco.mj_step(model, data, nstep=round(so101.period_s / model.opt.timestep))
    assert np.abs(run.shown - shown).max() < 1e-6
    assert np.abs(run.torque).max() > 0.1


def test_a_drive_that_carries_all_the_weight_stands_at_its_set_point() -> None:
    pose = np.array([0.9, 0.5])
    assert np.abs(still(drive()) - pose).max() > 0.05
    assert np.abs(still(drive(gravity=1.0)) - pose).max() < 1e-3


def test_a_stiffer_drive_sags_less_and_a_zero_that_is_off_moves_the_true_joint() -> None:
    pose = np.array([0.9, 0.5])
    sag, stiff = np.abs(still(drive()) - pose), np.abs(still(drive(position_gain=np.full(2, 8.0))) - pose)
    assert (stiff < sag / 4).all()
    shown = still(drive(zero=np.array([0.0, 0.3]), gravity=1.0))
    assert np.abs(shown - pose).max() < 1e-3  # what is shown follows the set point, and the link stands 0.3 rad away


def test_set_points_come_late_and_no_faster_than_they_may() -> None:
    sent = np.tile(np.array([0.9, 0.5]), (200, 1))
    sent[100:, 1] += 0.2
    prompt, late = (
        build(MODELS / "bench.xml", own).run(sent, np.zeros_like(sent), 0.01, 0.0005, 0).shown
        for own in (drive(), drive(delay_s=0.05))
    )
    assert np.abs(late[105:] - prompt[100:-5]).max() < 2e-3
    slow = build(MODELS / "bench.xml", drive(slew_rad_s=0.1)).run(sent, np.zeros_like(sent), 0.01, 0.0005, 0).shown
    assert np.abs(np.diff(slow[120:, 1])).max() < 0.1 * 0.01 * 1.5


def test_torque_is_bounded_by_its_limit_and_by_speed() -> None:
    sent = np.tile(np.array([0.9, 0.5]), (80, 1))
    sent[5:] += 1.0
    run = build(MODELS / "bench.xml", drive(limit=np.array([1.0, 0.5]))).run(sent, 0 * sent, 0.01, 0.0005, 0)
    assert np.abs(run.torque).max(0) == pytest.approx([1.0, 0.5])
    droop = build(MODELS / "bench.xml", drive(droop=np.full(2, 0.2))).run(sent, 0 * sent, 0.01, 0.0005, 0)
    assert (droop.torque <= np.maximum(LIMIT * (1 - 0.2 * droop.speed), 0) + 1e-9).all()


def test_halves_share_no_case_and_a_seed_gives_the_same_ones() -> None:
    tuning = draw_owners("tuning", OwnersHalf(11, 20))
    assert tuning == draw_owners("tuning", OwnersHalf(11, 20))
    assert not {case.seed for case in tuning} & {case.seed for case in draw_owners("reported", OwnersHalf(12, 60))}
    assert {case.robot for case in tuning} == set(ROBOTS)
    assert sorted(len(case.errors) for case in tuning) == [0] * 2 + [1] * 10 + [2] * 6 + [3] * 2


def test_every_error_can_be_drawn_and_a_case_is_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, errors in OF_ROBOT.items():
        assert len({error.__name__ for error in errors}) >= 10, name
    monkeypatch.setitem(ROBOTS, "bench", replace(BENCH, length_s=1.5))  # logs as short as these hold all it takes
    case = OwnersCase("tuning", "bench", ("velocity", "torque_limit", "link_payload"), 5)
    written = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        written.append(write_owners_case(case, MODELS, folder / "logs", folder / "proof"))
    assert written[0] == written[1]
    own = written[0]
    assert [e["name"] for e in own["effects"]] == ["torque_limit", "link_payload"]
    assert len(own["facts"]) == 1
    robot = Robot.load(tmp_path / "a" / "logs" / "robot.xml")
    logs = read_logs(tmp_path / "a" / "logs")
    assert len(logs) == 4
    assert robot.joints == logs[0].joints


def said(verdict: str, answer: list[list[str]], *says: str, **changed: object) -> CaseOutcome:
    own = truth("single", "position_gain") | changed
    checks = [{"name": "x", "passed": False, "says": one} for one in says]
    return outcome("owners_000", own, report(verdict, answer, checks=checks, notes=[]), None)


def test_what_is_right_or_honest() -> None:
    assert said("named", [["position_gain"]]).right
    assert said("ambiguous", [["leg_mass", "position_gain"]]).honest
    assert not said("ambiguous", [["leg_mass", "motor_lag"]]).honest
    assert said("unknown", []).honest
    assert not said("partly", [["motor_lag"]]).honest
    assert said("partly", [["motor_lag", "command_delay"]]).honest  # told with a rival: no fact
    assert not said("none", []).honest
    assert not said("named", [["position_gain"], ["motor_lag"]]).honest


def test_a_cause_that_does_just_the_same_is_right_and_a_check_may_tell_a_fact() -> None:
    effects = [{"name": "position_gain", "location": "all", "parameters": {"scale": 3.0}, "same": ["torque_gain"]}]
    assert said("named", [["torque_gain"]], effects=effects).right
    late = {
        "effects": [],
        "kind": "none",
        "facts": {"velocity_late": {"told": TOLD_VELOCITY}},
        "changes": [],
        "change": 0.0,
    }
    assert not said("none", [], **late).right
    assert said("none", [], "the velocities of the joints are late by 50 ms", **late).right
    assert not said("named", [["motor_lag"]], "the velocities are late by 50 ms", **late).honest


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (TOLD_VELOCITY, "joint velocities are in steps of 0.024 rad/s"),
        (TOLD_SET_POINTS, "set points are held for 4 rows while the robot moved on"),
        (TOLD_LIMIT, "12 % of rows ask for more than the model's torque limit at elbow"),
    ],
)
def test_checks_are_recognised_by_their_words(words: str, says: str) -> None:
    assert re.search(words, says, re.IGNORECASE)
    assert not re.search(words, "positions of the joints agree with their velocities at the claimed sample period")


def test_a_plan_holds_set_points_from_the_first_logged_row_on() -> None:
    go2 = ROBOTS["go2"]
    plan = Plan(np.arange(40.0)[:, None] * np.ones(12), rest_rows=20)
    sent, _ = plan.commands(go2, 10)
    assert sent[20:40, 0].tolist() == [20.0] * 10 + [30.0] * 10
