"""Causes many times the tolerance of the model's own number, on logs of little noise by plain MuJoCo."""

from pathlib import Path

import mujoco
import pytest

from leapgap.diagnosis.diagnose import diagnose
from leapgap.diagnosis.settings import Settings
from leapgap.robot.model import Robot
from tests.diagnosis.joint_fits import noisy_logs
from tests.diagnosis.two_link_arm import TORQUE_MOTOR, two_link_arm


@pytest.mark.parametrize("noise", [0.0, 2e-4])
def test_damping_of_forty_tolerances_is_a_cause_and_no_tolerance(tmp_path: Path, noise: float) -> None:
    """The elbow has 0.5 N·m·s/rad where the model has 0.1 with a tolerance of 0.01."""
    path = tmp_path / "arm.xml"
    path.write_text(two_link_arm(TORQUE_MOTOR))

    def damp(model: mujoco.MjModel) -> None:
        model.dof_damping[1] += 0.4

    logs = noisy_logs(path, damp, rows=1500, noise=noise)
    report = diagnose(logs, Robot.load(path), Settings(best=False)).report
    assert (report.verdict, report.answer) == ("named", (("joint_damping",),))
    assert report.causes[0].location == "L_elbow"
    assert report.causes[0].parameters["damping"].value == pytest.approx(0.4, rel=0.02)


def test_what_each_joint_is_off_by_is_no_further_cause(tmp_path: Path) -> None:
    """Both joints have 0.05 kg·m² more than the model's 0.1, the elbow 0.093 in place of 0.1 besides: within tolerance.

    One number for both joints leaves the elbow 1.4 tolerances off, which looks like a motor of more torque there.
    """
    path = tmp_path / "arm.xml"
    path.write_text(two_link_arm(TORQUE_MOTOR).replace('damping="0.1"', 'damping="0.1" armature="0.1"'))

    def more_armature(model: mujoco.MjModel) -> None:
        model.dof_armature[:] = [0.15, 0.143]

    logs = noisy_logs(path, more_armature, rows=1500, noise=1e-4)
    report = diagnose(logs, Robot.load(path), Settings(best=False)).report
    assert (report.verdict, report.answer) == ("named", (("armature",),))
    assert report.causes[0].parameters["inertia"].value == pytest.approx(0.047, rel=0.1)


@pytest.mark.parametrize("share", [0.8, 1.0])
def test_numbers_of_a_held_robot_are_those_of_its_whole_logs(tmp_path: Path, share: float) -> None:
    """The elbow's damping of 0.5 N·m·s/rad is 80 or 100 % too small, eight or ten of its tolerances.

    Pieces of a tenth of a second begin at noisy rows. By them alone the number is 3 % too large, and the corrected
    robot leaves 1.6 times what noise does.
    """
    path = tmp_path / "arm.xml"
    before, elbow, after = two_link_arm(TORQUE_MOTOR).partition("L_elbow")
    path.write_text(before + elbow + after.replace('damping="0.1"', 'damping="0.5"', 1))

    def damp(model: mujoco.MjModel) -> None:
        model.dof_damping[1] *= 1 + share

    logs = noisy_logs(path, damp, rows=1000, noise=1e-3)
    report = diagnose(logs, Robot.load(path), Settings(best=False)).report
    assert (report.verdict, report.answer) == ("named", (("joint_damping",),))
    found = report.causes[0].parameters["damping"]
    assert found.value == pytest.approx(0.5 * share, rel=0.005)
    assert found.ci95[0] < 0.5 * share < found.ci95[1]
    assert report.gap_corrected < 1.1 * report.noise_floor
