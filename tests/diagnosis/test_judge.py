"""The referee of corrections, on logs that plain MuJoCo made of the arm that each case says."""

import json
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

import leapgap as lg
from leapgap import effects
from leapgap.cli import main
from leapgap.diagnosis.engine.search import Found
from leapgap.diagnosis.hypotheses import Hypothesis
from leapgap.effects.model_change import changes_between
from leapgap.errors import InputError
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import sha256
from leapgap.simulation.corrected import write_corrected
from tests import plain_arm

STICKY = 'damping="0.05" frictionloss="0.6"'


def robot_of(folder: Path, name: str, xml: str) -> Robot:
    path = folder / f"{name}.xml"
    path.write_text(xml)
    return Robot.load(path)


def test_whole_changes_make_the_nominal_model_the_corrected_one(tmp_path: Path) -> None:
    """Also a mass that moves, an inertia with axes of its own, and gravity: forces are those of the other file."""
    inertial = '<inertial pos="0.02 0.01 -0.2" mass="1.3" fullinertia="0.02 0.018 0.004 0.001 0.002 -0.001"/>'
    other = plain_arm.arm(STICKY).replace(
        '<geom type="capsule" fromto="0 0 0 0 0 -0.3"', f'{inertial}<geom type="capsule" fromto="0 0 0 0 0 -0.3"'
    )
    other = other.replace('timestep="0.0005"', 'timestep="0.0005" gravity="0.3 0 -9.7"')
    nominal, stated = robot_of(tmp_path, "nominal", plain_arm.arm()), robot_of(tmp_path, "stated", other)
    changes = changes_between(nominal, stated)
    assert [one.title for one in changes] == [
        "mass and centre of mass of lower",
        "inertia of lower",
        "dry friction of elbow",
        "gravity",
    ]
    model = nominal.spec().compile()
    for one in changes:
        one.effect.change_model(model, nominal)
    plain = mujoco.MjModel.from_xml_string(other)
    forces = []
    for of in (model, plain):
        data = mujoco.MjData(of)
        data.qpos[:], data.qvel[:], data.qacc[:] = [0.4, -0.7], [1.1, -2.0], [3.0, 5.0]
        mujoco.mj_inverse(of, data)
        forces.append(data.qfrc_inverse.copy())
    assert forces[0] == pytest.approx(forces[1], abs=1e-9)
    assert changes_between(nominal, robot_of(tmp_path, "same", plain_arm.arm())) == []


def test_another_robot_is_refused(tmp_path: Path) -> None:
    nominal = robot_of(tmp_path, "nominal", plain_arm.arm())
    with pytest.raises(InputError, match=r"other joints than .*: elbow, knee"):
        changes_between(nominal, robot_of(tmp_path, "other", plain_arm.arm().replace('"elbow"', '"knee"')))


def test_gains_and_limits_of_the_makers_are_changes(tmp_path: Path) -> None:
    servo = '<position joint="elbow" kp="{kp}" kv="2" forcerange="-{limit} {limit}"/>'
    general = '<general joint="elbow" gainprm="1" biastype="affine" forcerange="-60 60"/>'
    before, after = (
        robot_of(tmp_path, f"servo_{kp}", plain_arm.arm().replace(general, servo.format(kp=kp, limit=limit)))
        for kp, limit in ((40, 60), (50, 30))
    )
    found = {one.title: one.effect.values["scale"] for one in changes_between(before, after)}
    assert found == {"position gain of elbow": pytest.approx(1.25), "torque limit of elbow": pytest.approx(0.5)}


def test_a_limit_that_limits_nothing_is_no_cause(tmp_path: Path) -> None:
    """Evidence may ask for a number beyond the end at which an effect does nothing: that is none."""
    robot = robot_of(tmp_path, "nominal", plain_arm.arm())
    slew = Hypothesis(effects.known()["set_point_slew"], robot)
    for rate, is_acting in ((101.7, False), (100.0, False), (40.0, True)):
        found = SimpleNamespace(acting=((slew, slew.near(np.array([rate]), None)),))
        assert Found.departs(found, -1) is is_acting, rate  # type: ignore[arg-type]


@pytest.mark.long
def test_right_changes_are_supported_and_damping_made_up_for_friction_is_told(tmp_path: Path) -> None:
    nominal = robot_of(tmp_path, "nominal", plain_arm.arm())
    logs = plain_arm.write_parquet(tmp_path / "logs", 2, plain_arm.arm(STICKY))
    right = robot_of(tmp_path, "right", plain_arm.arm(STICKY))
    (friction,) = lg.judge(right.path, logs, nominal, threads=1).changes
    assert (friction.title, friction.verdict) == ("dry friction of elbow", "supported")
    assert friction.share == pytest.approx(1, abs=0.05)
    wrong = robot_of(tmp_path, "wrong", plain_arm.arm('damping="0.4"', mass=0.9))
    judgement = lg.judge(wrong.path, logs, nominal, threads=1)
    told = {one.title: one for one in judgement.changes}
    assert {title: one.verdict for title, one in told.items()} == dict.fromkeys(
        ("mass and centre of mass of lower", "inertia of lower", "damping of elbow"), "not supported"
    )
    instead = told["damping of elbow"].instead
    assert instead is not None
    assert instead.startswith("joint Coulomb friction at elbow (torque 0.6")
    assert judgement.further == (instead,)
    whole = judgement.horizons[0]
    assert whole.nominal < whole.corrected < whole.frozen


@pytest.mark.long
def test_the_command_says_it_and_writes_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nominal = robot_of(tmp_path, "nominal", plain_arm.arm())
    half = robot_of(tmp_path, "half", plain_arm.arm('damping="0.25"'))
    logs = plain_arm.write_parquet(tmp_path / "logs", 2)
    file = tmp_path / "judged.json"
    arguments = ["judge", str(half.path), str(logs), "--nominal", str(nominal.path), "--json", str(file), "--quiet"]
    assert main(arguments) == 0
    assert "damping of elbow  0.05 → 0.25: another number; the logs support 1.9" in capsys.readouterr().out
    (change,) = json.loads(file.read_text())["changes"]
    assert change["share"] == pytest.approx(2, rel=0.05)


@pytest.mark.long
def test_a_report_is_judged_on_the_logs_that_it_was_not_made_from(tmp_path: Path) -> None:
    """Its damping is right; its load at the elbow is not, and the log that it was made from is left out."""
    nominal = robot_of(tmp_path, "nominal", plain_arm.arm())
    logs = plain_arm.write_parquet(tmp_path / "logs", 3)
    report = tmp_path / "report"
    causes = effects.effect("joint_damping", "elbow", damping=0.4), effects.effect("leg_mass", "elbow", scale=1.2)
    write_corrected(report / "corrected", nominal, causes)
    used = next(iter(sorted(logs.iterdir())))
    (report / "report.json").write_text(json.dumps({"provenance": {"logs": {used.stem: sha256(used)}}}))
    judgement = lg.judge(report, logs, threads=1)
    assert judgement.logs == ("swing_1", "swing_2")
    assert used.stem in judgement.notes[0]
    verdicts = {one.title: one.verdict for one in judgement.changes}
    assert verdicts == {"joint_damping at elbow": "supported", "link_mass at elbow": "not supported"}


def test_logs_that_a_report_was_made_from_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nominal = robot_of(tmp_path, "nominal", plain_arm.arm())
    logs = plain_arm.write_parquet(tmp_path / "logs", 2)
    report = tmp_path / "report"
    write_corrected(report / "corrected", nominal, (effects.effect("joint_damping", "elbow", damping=0.4),))
    hashes = {path.stem: sha256(path) for path in logs.iterdir()}
    (report / "report.json").write_text(json.dumps({"provenance": {"logs": hashes}}))
    assert main(["judge", str(report), str(logs)]) == 2
    assert "the same logs that this report was made from" in capsys.readouterr().err


def test_a_file_without_its_nominal_model_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nominal = robot_of(tmp_path, "nominal", plain_arm.arm())
    logs = plain_arm.write_parquet(tmp_path / "logs", 2)
    assert main(["judge", str(nominal.path), str(logs)]) == 2
    assert "name it: --nominal robot.xml" in capsys.readouterr().err
