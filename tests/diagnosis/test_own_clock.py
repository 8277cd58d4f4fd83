"""Logs whose rows are not as long as they claim, of an arm with a hidden cause, by plain MuJoCo and a PD by hand."""

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.engine.verdict import Judgement
from leapgap.diagnosis.hypotheses import list_hypotheses
from leapgap.diagnosis.own_clock import AT_END, OwnClock
from leapgap.diagnosis.settings import Settings
from leapgap.logs.log import Log, LogInfo
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import joint_fit
from tests.diagnosis.two_link_arm import torque_driven_arm
from tests.plain_arm import BELIEVED, EXAMPLE, JOINTS, KD, KP, TRUE, write_model

STEP_S = 0.001


def of_a_late_writer(name: str, seed: int) -> Log:
    """A log of the true arm, written by a process that sees 0 to 3 steps of 1 ms pass from row to row, and claims 1 ms.

    A set point holds from the row in which it is written to the next.
    """
    rng = np.random.default_rng(seed)
    passed = rng.choice(4, 1600, p=(0.25, 0.35, 0.25, 0.15))
    at = np.concatenate([[0], np.cumsum(passed)])
    model = mujoco.MjModel.from_xml_string(EXAMPLE.MODEL.format(elbow=EXAMPLE.TRUE))
    model.opt.timestep = STEP_S
    data = mujoco.MjData(model)
    size, rate, phase = rng.uniform(0.3, 0.6, (2, 3)), rng.uniform(0.5, 2.0, (2, 3)), rng.uniform(0, 6, (2, 3))
    angle = 2 * np.pi * rate[:, :, None] * at * STEP_S + phase[:, :, None]
    wanted = (size[:, :, None] * np.sin(angle)).sum(axis=1).T
    speed = (size[:, :, None] * 2 * np.pi * rate[:, :, None] * np.cos(angle)).sum(axis=1).T
    data.qpos[:], data.qvel[:] = wanted[0], speed[0]
    position, velocity = np.empty((len(at), 2)), np.empty((len(at), 2))
    for row in range(len(at)):
        position[row], velocity[row] = data.qpos, data.qvel
        for _ in range(passed[row] if row < len(passed) else 0):
            data.qfrc_applied[:] = KP * (wanted[row] - data.qpos) + KD * (speed[row] - data.qvel)
            mujoco.mj_step(model, data)
    columns = {"time": STEP_S * np.arange(len(at))}
    for i, joint in enumerate(JOINTS):
        columns |= {
            f"joint_pos/{joint}": position[:, i] + 2e-5 * rng.standard_normal(len(at)),
            f"joint_vel/{joint}": velocity[:, i] + 1e-3 * rng.standard_normal(len(at)),
            f"cmd_tau/{joint}": np.zeros(len(at)),
            f"cmd_pos/{joint}": wanted[:, i],
            f"cmd_vel/{joint}": speed[:, i],
            f"cmd_kp/{joint}": np.full(len(at), KP),
            f"cmd_kd/{joint}": np.full(len(at), KD),
        }
    return Log(name, columns, LogInfo("arm", STEP_S, "plain MuJoCo"))


@pytest.mark.long
def test_the_clock_is_named_first_and_the_hidden_cause_with_its_value(tmp_path) -> None:
    logs = [of_a_late_writer(f"late_{seed}", seed) for seed in range(4)]
    kinds = ["joint_damping", "joint_friction", "torque_gain", "command_delay", "sample_period"]
    found = diagnose(logs, Robot.load(write_model(tmp_path)), Settings(effects=kinds, bootstrap_draws=200))
    report = found.report
    assert report.verdict == "named"
    assert report.answer[0] == ("sample_period",) and ("joint_damping",) in report.answer
    assert report.closure_of_answer is not None and report.closure_of_answer.value > 0.9
    clock, damping = report.causes[0], next(cause for cause in report.causes if cause.effect == "joint_damping")
    lasted = [log.time[-1] for log in found.logs]
    assert clock.parameters["scale"].value == pytest.approx(np.median(lasted) / logs[0].time[-1], rel=0.01)
    assert damping.parameters["damping"].value == pytest.approx(TRUE - BELIEVED, rel=0.1)
    (check,) = [check for check in report.checks if check.name == "row_clock"]
    assert not check.passed and "not evenly spaced" in check.says


def judged_armature(robot: Robot, inertia: float) -> Judgement:
    """The judgement `armature` on logs of an arm with so much more of it, kg·m², at both joints."""

    def change(model: mujoco.MjModel) -> None:
        model.dof_armature[:] += inertia

    joint = joint_fit(robot, change)
    (armature,) = (h for h in list_hypotheses(["armature"], robot, None) if h.location == "all")
    begin = np.minimum(inertia, 0.9 * armature.bounds[1])
    found, gap = joint.fit((armature,), np.ravel(begin), 8), joint.heldout_gap
    return OwnClock(gap.judged, dict.fromkeys(gap.names, (1.1,)), robot).conclude(joint, (found,), (1.0,))


def test_what_ends_at_its_range_and_leaves_much_is_told_as_a_part(tmp_path) -> None:
    judgement = judged_armature(torque_driven_arm(tmp_path), 0.3)
    assert judgement.selected.at_bound
    assert judgement.conclusion.verdict == "partly"
    assert judgement.conclusion.answer == (("sample_period",), ("armature",))
    assert judgement.notes == (AT_END,)


def test_what_fits_within_its_range_is_named_after_the_clock(tmp_path) -> None:
    judgement = judged_armature(torque_driven_arm(tmp_path), 0.02)
    assert judgement.conclusion.verdict == "named" and not judgement.notes
    assert [step.names for step in judgement.conclusion.steps] == [("sample_period",), ("sample_period", "armature")]
    assert judgement.selected.typical_effects(["motion_0"])[0].values["scale"] == pytest.approx(1.1)
    assert judgement.undecided.fits[0].fit.names == ("armature",)
