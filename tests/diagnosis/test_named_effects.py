"""Effects that are looked for when they are named: found with their numbers in logs of plain MuJoCo, beside others."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.report import ReportContent
from leapgap.diagnosis.settings import Settings
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
    return diagnose(logs, arm.load(folder), Settings(effects=[name, *BESIDE], bootstrap_draws=100, best=False)).report


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


@pytest.mark.long
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


@pytest.mark.parametrize(
    ("name", "location", "plain", "parameter", "true"),
    [
        # A loss that grows from nothing to a seventh of the torque within each log is no weak motor.
        (
            "thermal_fade",
            "shoulder",
            {"acting": lambda sent: arm.heat_up(sent, 15.0), "change": arm.unpowered},
            "loss_per_s",
            15.0,
        ),
        # Friction of a loaded gear is none of the bearings.
        ("load_friction", "elbow", {"acting": lambda sent: arm.rub(sent, 0.15)}, "share", 0.15),
    ],
)
def test_an_effect_that_depends_on_the_load_is_found_with_its_number(
    tmp_path: Path, name: str, location: str, plain: dict, parameter: str, true: float
) -> None:
    report = judge(tmp_path, name, **plain)
    cause = report.causes[0]
    assert (report.verdict, report.answer) == ("named", ((name,),))
    assert cause.location == location
    assert cause.parameters[parameter].value == pytest.approx(true, rel=0.05)
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
