"""The force that a simulation lacks over time, on logs of plain MuJoCo with a torque that the model does not know."""

from pathlib import Path

import numpy as np
import pytest

from leapgap import effects
from leapgap.logs.log import read_logs
from leapgap.reports.diagnosis_figures import INTERVAL_S, residual_figure, residual_force, state_figure
from leapgap.robot.model import Robot
from tests import plain_arm

TORQUE = 0.8


def test_a_constant_torque_lacks_at_its_joint_and_nothing_once_it_is_known(tmp_path: Path) -> None:
    """A spring of 1e-6 N·m/rad, stretched by 8e5 rad, gives the torque."""
    spring = f'damping="0.05" stiffness="1e-6" springref="{TORQUE / 1e-6}"'
    xml = plain_arm.arm(spring).replace("<worldbody>", '<compiler angle="radian"/><worldbody>')
    plain_arm.write_parquet(tmp_path / "logs", 1, xml)
    (log,) = read_logs(tmp_path / "logs")
    robot = Robot.load(plain_arm.write_model(tmp_path))
    known = (effects.effect("torque_offset", "elbow", torque_nm=TORQUE),)
    found = residual_force(log, robot, [(), known])
    assert found is not None
    assert np.diff(found.time) == pytest.approx(INTERVAL_S)
    nominal, corrected = found.force[..., robot.joints.index("elbow")]
    assert nominal.mean() == pytest.approx(TORQUE, rel=0.05)
    assert np.abs(corrected).max() < 0.3 * TORQUE
    assert np.abs(found.force[:, :, robot.joints.index("shoulder")].mean(axis=1)).max() < 0.05 * TORQUE
    figure = residual_figure(found, robot.joints, ["N·m", "N·m"])
    elbow, shoulder = (one.text for one in figure.layout.annotations)
    before, after = (float(size) for size in elbow.removeprefix("elbow: ").removesuffix(" N·m").split(" → "))
    assert (before, after) == (pytest.approx(TORQUE, rel=0.05), pytest.approx(0, abs=0.05 * TORQUE))
    assert shoulder.startswith("shoulder: ")
    by_velocity, by_position, by_acceleration = state_figure(found, robot.joints, ["N·m", "N·m"]).data[:3]
    ends = [found.time - INTERVAL_S / 2, found.time + INTERVAL_S / 2]
    (first, last), (slow, fast) = (
        [np.interp(at, log.time, log[f"{q}/elbow"]) for at in ends] for q in ("joint_pos", "joint_vel")
    )
    np.testing.assert_allclose(by_position.x, (first + last) / 2, atol=0.02)
    np.testing.assert_allclose(by_velocity.x, (slow + fast) / 2, atol=0.05)
    np.testing.assert_allclose(by_acceleration.x, (fast - slow) / INTERVAL_S, atol=1.0)
    assert by_velocity.y == by_position.y == by_acceleration.y


def test_a_log_shorter_than_two_replays_has_no_course(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = {name: values[:60] for name, values in plain_arm.swing(0).items()}
    monkeypatch.setattr(plain_arm, "swing", lambda *_, **__: columns)
    (log,) = read_logs(plain_arm.write_parquet(tmp_path / "logs", 1))
    assert residual_force(log, Robot.load(plain_arm.write_model(tmp_path)), [()]) is None
