"""Predictions of the MPC at its updates: they follow the plan that they start on, fall in flight, and move along."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from leapgap.jumping.models.rigid_body import RigidBodyModel
from leapgap.jumping.reports.method_comparison import MpcHorizons, mpc_horizons, planned_for, record_comparison
from leapgap.logs.log import Log, write_log
from leapgap.robot.model import Robot
from leapgap.runtime.atomic_io import write_json
from tests.conftest import A1_BODY
from tests.reports.read_back import Recorded

TAKE_OFF_S, LANDING_S, GRAVITY = 0.8, 1.2, 9.81


@pytest.fixture(scope="module")
def horizons(reference: Log, robot: Robot) -> MpcHorizons:
    found = mpc_horizons(reference, reference, robot, RigidBodyModel(A1_BODY))
    assert found is not None
    return found


def test_there_is_an_update_every_25_ms_until_take_off(horizons: MpcHorizons) -> None:
    times = [one.time_s[0] for one in horizons.updates]
    np.testing.assert_allclose(times, np.arange(0, TAKE_OFF_S - 1e-9, 0.025))
    assert horizons.updates[-1].time_s[-1] == pytest.approx(LANDING_S)


def test_from_states_of_the_plan_the_plan_is_predicted(horizons: MpcHorizons, reference: Log) -> None:
    """A step ahead within millimetres, until take-off within centimetres: the legs of the plan have mass.

    After it, Euler's steps of 0.1 s rise above the parabola by g Δt² / 2 each.
    """
    for one in horizons.updates:
        x = np.interp(one.time_s, reference.time, reference["base_pos_x"]) - reference["base_pos_x"][0]
        z = np.interp(one.time_s, reference.time, reference["base_pos_z"])
        steps_in_flight = np.sum(one.time_s > TAKE_OFF_S + 1e-9)
        standing = one.time_s <= TAKE_OFF_S + 1e-9
        assert np.abs(one.state[:, 0] - x).max() < 0.06
        assert np.abs(one.state[:, 1] - z)[standing].max() < 0.08
        assert np.abs(one.state[:, 1] - z)[1] < 0.008 or one.time_s[1] > TAKE_OFF_S
        assert np.abs(one.state[:, 1] - z).max() < 0.08 + steps_in_flight * GRAVITY * 0.1**2 / 2


def test_the_predicted_flight_falls_freely(horizons: MpcHorizons) -> None:
    last = horizons.updates[-1]
    flying = last.time_s >= TAKE_OFF_S - 1e-9
    speed = last.state[flying, 4]
    np.testing.assert_allclose(np.diff(speed), -GRAVITY * np.diff(last.time_s[flying]), rtol=1e-6)
    np.testing.assert_allclose(np.diff(last.state[flying, 3]), 0, atol=1e-9)


def test_a_jump_elsewhere_has_the_same_predictions_there(horizons: MpcHorizons, reference: Log, robot: Robot) -> None:
    columns = dict(reference.columns) | {"base_pos_x": reference["base_pos_x"] + 2.0}
    moved = mpc_horizons(replace(reference, columns=columns), reference, robot, RigidBodyModel(A1_BODY))
    assert moved is not None
    here, there = (of.in_world(of.updates[5].state) for of in (horizons, moved))
    np.testing.assert_allclose(there - here, np.tile([2.0, 0.0, 0.0], (len(here), 1)), atol=1e-6)


def test_a_log_without_the_state_has_no_predictions(reference: Log, robot: Robot) -> None:
    columns = {name: values for name, values in reference.columns.items() if not name.startswith("base_linvel")}
    assert mpc_horizons(replace(reference, columns=columns), reference, robot, RigidBodyModel(A1_BODY)) is None


def test_the_recording_of_a_landing_has_the_predictions_of_its_nominal_mpc(
    tmp_path: Path, reference: Log, robot: Robot
) -> None:
    write_log(reference, tmp_path / "references/h00_d50.parquet")
    assert planned_for(reference, tmp_path / "references") is not None
    kept = {"landings": [{"error_cm": 1.0, "success": True}], "fallbacks": {}, "substituted": []}
    paths = []
    for method in ("ours", "nominal_variable"):
        paths.append(tmp_path / method / "jump_50_0.parquet")
        write_log(replace(reference, name="jump_50_0"), paths[-1])
        write_json(paths[-1].with_suffix(".json"), kept)
    record_comparison(tmp_path / "landing.rrd", "jump_50", paths, robot, tmp_path / "references")
    found = Recorded(tmp_path / "landing.rrd")
    predicted = found.at("/world/nominal_variable/mpc/predicted", "LineStrips3D:strips", 0.5)
    assert np.array(predicted[0]).shape[1] == 3
    assert "/world/ours/mpc/predicted" not in found.moving
    assert "/mpc/x" in found.moving
    assert "predicts at each of its 32 updates" in str(found.static["/notes"])
    record_comparison(tmp_path / "without.rrd", "jump_50", paths, robot, tmp_path / "nothing")
    assert "/mpc/x" not in Recorded(tmp_path / "without.rrd").moving
