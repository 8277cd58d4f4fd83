"""The signature's zeros: what physics forbids an effect to touch."""

import numpy as np
import pytest

from docs.effect_signatures import CHANNELS, MARK, Signature, main, moderate_effects, signature
from leapgap import effects
from leapgap.errors import InputError
from leapgap.logs import log as jump_log
from leapgap.logs.log import Log
from leapgap.robot.model import Robot
from tests.code import ROOT

AT_MOTORS = (
    *("torque_gain", "joint_damping", "joint_friction", "armature"),
    *("motor_lag", "torque_speed_limit", "command_delay", "encoder_bias"),
)
AT_GROUND = ("foot_compliance", "foot_friction", "ground_height", "ground_slope")


@pytest.fixture(scope="module")
def matrix(robot: Robot, reference: Log) -> Signature:
    return signature(reference, robot, moderate_effects(robot))


@pytest.mark.parametrize("name", AT_MOTORS)
def test_nothing_at_the_motors_changes_how_the_centre_of_mass_flies(matrix: Signature, name: str) -> None:
    """Joint torques are internal: no force on the whole, no moment about its centre, up to integration."""
    trace = matrix.of(name, "flight")
    assert trace["com_acceleration_x"] < 0.005  # m/s², of 9.81
    assert trace["com_acceleration_z"] < 0.005
    assert trace["angular_momentum_rate_y"] < 0.02  # N·m


@pytest.mark.parametrize("name", AT_GROUND)
def test_the_ground_does_nothing_in_flight(matrix: Signature, name: str) -> None:
    assert max(matrix.of(name, "flight").values()) == 0
    assert max(matrix.of(name, "rear_contact").values()) > 0.005


def test_air_brakes_the_flight_by_its_law(matrix: Signature, robot: Robot) -> None:
    """At a few m/s: c |v|²/m ≈ 1 · 2²/12 m/s²."""
    trace = matrix.of("aerodynamic_drag", "flight")
    assert 0.05 < np.hypot(trace["com_acceleration_x"], trace["com_acceleration_z"]) < 0.4


def test_a_slow_loop_makes_the_fall_look_steeper_by_its_scale(matrix: Signature) -> None:
    """Velocities are in true time, rows 7 % longer than claimed: dv/dt by the log is 1.07 g."""
    assert matrix.of("sample_period", "flight")["com_acceleration_z"] == pytest.approx(0.07 * 9.81, rel=0.02)


def test_latency_touches_no_joint_in_flight_and_no_true_momentum(matrix: Signature) -> None:
    trace = matrix.of("state_latency", "flight")
    assert trace["com_acceleration_z"] < 0.005
    assert trace["joint_pos"] < 1e-3
    assert trace["base_linvel_z"] > 0.1  # g · delay


def test_a_slow_motor_has_voltage_to_spare_while_all_feet_stand(matrix: Signature) -> None:
    assert matrix.of("torque_speed_limit", "double_contact")["joint_vel"] < 0.01
    assert matrix.of("torque_speed_limit", "lift_off")["joint_vel"] > 0.1


def test_without_effects_there_is_no_trace(robot: Robot, reference: Log) -> None:
    nominal = {name: effects.effect(name) for name in ("torque_gain", "ground_height")}
    assert np.abs(signature(reference, robot, nominal).values).max() == 0


def test_page_names_every_effect_and_the_command_renews_its_tables(tmp_path, reference: Log) -> None:
    kept = (ROOT / "docs" / "research" / "effects.md").read_text(encoding="utf-8")
    assert all(kept.count(f"| `{name}` |") == 1 for name in effects.known())
    jump_log.write_log(reference, tmp_path / "reference.parquet")
    page = tmp_path / "page.md"
    page.write_text(f"Words.\n\n{MARK}\nold tables\n", encoding="utf-8")
    main([str(tmp_path / "reference.parquet"), str(page)])
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"Words.\n\n{MARK}\n") and "old tables" not in text
    assert all(channel in text for channel in CHANNELS)
    page.write_text("Words.", encoding="utf-8")
    with pytest.raises(InputError, match="no mark"):
        main([str(tmp_path / "reference.parquet"), str(page)])
