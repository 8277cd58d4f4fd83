"""Effects that are looked for when they are named: found with their numbers in logs of plain MuJoCo, beside others."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import Settings, diagnose
from leapgap.diagnosis.report import ReportContent
from tests.effects import moving_arm as arm

BESIDE = ["joint_damping", "joint_friction", "torque_gain"]


def judge(folder: Path, name: str, acting: Callable[[arm.Sent], arm.Step] | None = None, **plain: Any) -> ReportContent:
    """The report on four logs of a changed arm, with noise of 0.2 mrad and 5 mrad/s.

    ``acting`` gives what acts before every step from the commands of a log.
    """
    rng, logs = np.random.default_rng(5), []
    for seed in range(4):
        sent = arm.commands(10 + seed, 1500)
        before = {} if acting is None else {"before": acting(sent)}
        qpos, qvel = arm.simulate(sent, **before, **plain)
        qpos += 2e-4 * rng.standard_normal(qpos.shape)
        qvel += 5e-3 * rng.standard_normal(qvel.shape)
        logs.append(arm.as_log(f"swing_{seed}", sent, qpos, qvel))
    return diagnose(logs, arm.load(folder), Settings(effects=[name, *BESIDE], bootstrap_draws=100)).report


def push(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
    data.qfrc_applied[1] = -1.5


def load(model: mujoco.MjModel) -> None:
    model.body("lower").mass += 0.4
    mujoco.mj_setConst(model, mujoco.MjData(model))


def slow_down(model: mujoco.MjModel) -> None:
    model.dof_dampingpoly[1, 0] += 0.2


CASES: list[tuple[str, str, dict[str, Callable], str, float]] = [
    ("torque_offset", "shoulder", {"before": push}, "torque_nm", -1.5),
    ("link_payload", "elbow", {"change": load}, "mass_kg", 0.4),
    ("quadratic_damping", "shoulder", {"change": slow_down}, "coefficient", 0.2),
]


@pytest.mark.parametrize(("name", "location", "plain", "parameter", "true"), CASES)
def test_a_named_effect_is_found_with_its_number(
    tmp_path: Path, name: str, location: str, plain: dict, parameter: str, true: float
) -> None:
    report = judge(tmp_path, name, **plain)
    cause = report.causes[0]
    assert (report.verdict, report.answer) == ("named", ((name,),))
    assert (cause.effect, cause.location) == (name, location)
    assert cause.parameters[parameter].value == pytest.approx(true, rel=0.03)
    assert report.gap_corrected < 2 * report.noise_floor


def unpowered(model: mujoco.MjModel) -> None:
    """The shoulder's motor is simulated by the test instead."""
    model.actuator_biasprm[1], model.actuator_gainprm[1] = 0, 0


def heat_up(sent: arm.Sent, loss: float) -> arm.Step:
    """A shoulder of 40 N·m that gives a share 1 / (1 + r): ṙ = loss (τ / 40)² / (1 + r) − r / 60 s of the asked τ."""
    rise = 0.0

    def act(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        nonlocal rise
        given = (sent.asked[row, 1] - arm.KP * data.qpos[1] - arm.KD * data.qvel[1]) / (1 + rise)
        data.qfrc_applied[1] = given
        rise += model.opt.timestep * (loss * given**2 * (1 + rise) / 40**2 - rise / 60)

    return act


def rub(sent: arm.Sent, share: float) -> arm.Step:
    """An elbow with friction that is a share of its motor's torque."""

    def act(model: mujoco.MjModel, data: mujoco.MjData, row: int) -> None:
        carried = sent.asked[row, 2] - arm.KP * data.qpos[2] - arm.KD * data.qvel[2]
        data.qfrc_applied[2] = -share * abs(np.clip(carried, -40, 40)) * np.tanh(data.qvel[2] / 0.05)

    return act


def test_a_motor_that_fades_is_no_weak_motor(tmp_path: Path) -> None:
    """A loss that grows from nothing to a seventh of the torque within each log."""
    report = judge(tmp_path, "thermal_fade", acting=lambda sent: heat_up(sent, 15.0), change=unpowered)
    cause = report.causes[0]
    assert (report.verdict, report.answer) == ("named", (("thermal_fade",),))
    assert cause.location == "shoulder"
    assert cause.parameters["loss_per_s"].value == pytest.approx(15.0, rel=0.05)
    assert report.gap_corrected < 2 * report.noise_floor


def test_friction_of_a_loaded_gear_is_no_friction_of_the_bearings(tmp_path: Path) -> None:
    report = judge(tmp_path, "load_friction", acting=lambda sent: rub(sent, 0.15))
    cause = report.causes[0]
    assert (report.verdict, report.answer) == ("named", (("load_friction",),))
    assert cause.location == "elbow"
    assert cause.parameters["share"].value == pytest.approx(0.15, rel=0.05)
    assert report.gap_corrected < 2 * report.noise_floor


def test_friction_at_rest_is_found_in_a_moving_arm(tmp_path: Path) -> None:
    """2 N·m of LuGre friction at the elbow, in the model file; the joint stands still only where it turns round."""
    grip = 'lugre="400 0.8 0.002 2 0.1" motorconst="0 0" resistance="1" input="none"'
    sticky = arm.MJCF.replace("</actuator>", f'<dcmotor name="grip" joint="elbow" {grip}/></actuator>')
    report = judge(tmp_path, "static_friction", mjcf=sticky)
    assert report.answer == (("static_friction",),) and report.causes[0].location == "elbow"
    assert report.causes[0].parameters["torque_nm"].value == pytest.approx(2.0, rel=0.1)


def test_a_finer_step_that_closes_the_gap_is_the_answer(tmp_path: Path) -> None:
    """Steps of 0.1 ms where the replay's are 1 ms: no other cause, although a weak motor would explain half of it."""
    report = judge(tmp_path, "numerics", steps=10)
    assert (report.verdict, report.answer) == ("named", (("numerics",),))
    ratio = report.causes[0].parameters["step_ratio"]
    assert ratio.value == pytest.approx(0.1, abs=0.05) and not ratio.at_bound
    assert report.gap_corrected < 1.5 * report.noise_floor < 0.5 * report.gap_nominal
