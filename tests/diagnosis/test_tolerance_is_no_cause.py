"""Causes many times the tolerance of the model's own number, on logs of little noise by plain MuJoCo."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.robot.model import Robot
from tests.diagnosis.two_link_arm import TORQUE_MOTOR, two_link_arm
from tests.plain_simulation import Pd, by_motors, simulate

MOTIONS = [Pd(20, 0.5, 0.3), Pd(30, 0.8, 0.5), Pd(12, 0.3, 0.8, 2.0), Pd(25, 0.6, 0.4, 3.0)]


@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_damping_of_forty_tolerances_is_a_cause_and_no_tolerance(tmp_path: Path, noise: float) -> None:
    """The elbow has 0.5 N·m·s/rad where the model has 0.1 with a tolerance of 0.01."""
    path, rng, logs = tmp_path / "arm.xml", np.random.default_rng(0), []
    path.write_text(two_link_arm(TORQUE_MOTOR))

    def damp(model: mujoco.MjModel) -> None:
        model.dof_damping[1] += 0.4

    for number, pd in enumerate(MOTIONS):
        log = simulate(path, by_motors, pd, rows=1500, change=damp).log
        size = {"joint_pos": noise, "joint_vel": 25 * noise}
        columns = {
            name: values + size.get(name.split("/")[0], 0.0) * rng.standard_normal(len(values))
            for name, values in log.columns.items()
        }
        logs.append(replace(log, name=f"motion_{number}", columns=columns))
    report = diagnose(logs, Robot.load(path), Settings()).report
    assert (report.verdict, report.answer) == ("named", (("joint_damping",),))
    assert report.causes[0].location == "L_elbow"
    assert report.causes[0].parameters["damping"].value == pytest.approx(0.4, rel=0.02)


def test_what_each_joint_is_off_by_is_no_further_cause(tmp_path: Path) -> None:
    """Both joints have 0.05 kg·m² more than the model's 0.1, the elbow 0.093 in place of 0.1 besides: within tolerance.

    One number for both joints leaves the elbow 1.4 tolerances off, which looks like a motor of more torque there.
    """
    path, rng, logs = tmp_path / "arm.xml", np.random.default_rng(0), []
    path.write_text(two_link_arm(TORQUE_MOTOR).replace('damping="0.1"', 'damping="0.1" armature="0.1"'))

    def more_armature(model: mujoco.MjModel) -> None:
        model.dof_armature[:] = [0.15, 0.143]

    for number, pd in enumerate(MOTIONS):
        log = simulate(path, by_motors, pd, rows=1500, change=more_armature).log
        size = {"joint_pos": 1e-4, "joint_vel": 2.5e-3}
        columns = {
            name: values + size.get(name.split("/")[0], 0.0) * rng.standard_normal(len(values))
            for name, values in log.columns.items()
        }
        logs.append(replace(log, name=f"motion_{number}", columns=columns))
    report = diagnose(logs, Robot.load(path), Settings()).report
    assert (report.verdict, report.answer) == ("named", (("armature",),))
    assert report.causes[0].parameters["inertia"].value == pytest.approx(0.047, rel=0.1)
